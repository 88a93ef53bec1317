"""The stem map as SVG: every tree a button, drawn to scale or a little larger, with the places of the photos."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import FsinferError
from fsinfer.report.contents import Contents, number, tree_number
from fsinfer.report.plot_border import border_of, is_in
from fsinfer.report.stems.row import STATUS_WORDS, status_of
from fsinfer.scene import read_scene

#: Width of the map and of its margin, units of the drawing. Source: layout.
WIDTH, MARGIN = 640.0, 34.0
#: Least radius of a stem and of the halo round it, which belongs to its button. Source: layout; what a finger hits.
LEAST_RADIUS, HALO = 6.0, 16.0
#: The side of the square that a stem and its number need. Source: layout; where there is less for each on average, all
#: that is not to scale is drawn smaller by as much, and can be read when the page is enlarged.
ROOM = 32.0
#: The side of the map in metres is at least this. Source: layout; a single tree must not fill it.
LEAST_SPAN_M = 4.0
#: Cameras farther outside the trees than this share of the map, or this distance, are not drawn. Source: layout; one
#: stray pose must not shrink it.
STRAY_SHARE, NEAR_M = 0.6, 8.0


@dataclass(frozen=True, kw_only=True)
class Mark:
    """A tree on the map: its circle in pixels of the drawing, its status, what is said of it, whether the plot's border
    leaves it out.
    """

    tree_id: int
    u: float
    v: float
    radius: float
    halo: float
    status: str
    said: str
    outside: bool


@dataclass(frozen=True, kw_only=True)
class GridLine:
    """A line of the grid at pixel ``at``, and the coordinate that it stands for."""

    at: float
    label: str


@dataclass(frozen=True, kw_only=True)
class MapView:
    """The drawing, in its own pixels.

    Attributes
    ----------
    crowd: by what marks and their numbers are drawn smaller, 1 where there is room.
    columns, rows: lines of the grid at constant x and at constant y.
    cameras: (u, v) of the photos.
    border: (u, v) of the corners of the plot's border; empty without one.
    legend: (CSS class, words) of each kind of mark that is there.
    """

    width: float
    height: float
    margin: float
    unit: str
    crowd: float
    columns: tuple[GridLine, ...]
    rows: tuple[GridLine, ...]
    cameras: tuple[tuple[float, float], ...]
    border: tuple[tuple[float, float], ...]
    marks: tuple[Mark, ...]
    legend: tuple[tuple[str, str], ...]


def stem_map(contents: Contents) -> MapView | None:
    """The map with its legend; None where no tree has a position."""
    trees = [
        (tree_id, x, y, tree)
        for tree in contents.trees or ()
        if (tree_id := tree_number(tree)) is not None
        and (x := number(tree.get("x_m"))) is not None
        and (y := number(tree.get("y_m"))) is not None
    ]
    if not trees:
        return None
    # Stems listed apart lie far outside: the map is that of the others.
    near = [[x, y] for _, x, y, tree in trees if status_of(tree) != "outside"]
    stems = np.array(near or [[x, y] for _, x, y, _ in trees])
    low, high = stems.min(axis=0), stems.max(axis=0)
    cameras = camera_places(contents)
    span = max(float((high - low).max()), LEAST_SPAN_M * contents.metre)
    reach = max(STRAY_SHARE * span, NEAR_M * contents.metre)
    walked = cameras[((cameras >= low - reach) & (cameras <= high + reach)).all(axis=1)]
    if len(walked):
        low, high = np.minimum(low, walked.min(axis=0)), np.maximum(high, walked.max(axis=0))
    plot = border_of(contents)
    outline = np.zeros((0, 2)) if plot is None else plot.border.outline
    if len(outline):
        low, high = np.minimum(low, outline.min(axis=0)), np.maximum(high, outline.max(axis=0))
    short = np.maximum(0.35 * span - (high - low), 0) / 2
    low, high = low - short - 0.03 * span, high + short + 0.03 * span
    per_unit = (WIDTH - 2 * MARGIN) / float(high[0] - low[0])
    height = per_unit * float(high[1] - low[1]) + 2 * MARGIN

    shown = [tree for tree in trees if low[0] <= tree[1] <= high[0] and low[1] <= tree[2] <= high[1]]

    room = (WIDTH - 2 * MARGIN) * (height - 2 * MARGIN) / max(len(shown), 1)
    crowd = min(math.sqrt(room) / ROOM, 1.0)

    def place(x: float, y: float) -> tuple[float, float]:
        return MARGIN + per_unit * (x - low[0]), height - MARGIN - per_unit * (y - low[1])

    step = round_step(float(max(high - low)) / 6)
    present = {tree.get("status") for _, _, _, tree in shown}
    legend = [(status, words) for status, words in STATUS_WORDS.items() if status in present]
    if len(walked):
        legend.append(("camera", "photo taken here"))
    if len(outline):
        legend.append(("border", "border of the plot (pale: outside)"))
    if len(shown) < len(trees):
        legend.append(("beyond", f"{len(trees) - len(shown)} outside of the walk, beyond the map"))
    return MapView(
        width=WIDTH,
        height=height,
        margin=MARGIN,
        unit="m" if contents.metric else "units",
        crowd=crowd,
        columns=tuple(GridLine(at=place(x, low[1])[0], label=_digits(x)) for x in _multiples(step, low[0], high[0])),
        rows=tuple(GridLine(at=place(low[0], y)[1], label=_digits(y)) for y in _multiples(step, low[1], high[1])),
        cameras=tuple(place(x, y) for x, y in walked),
        border=tuple(place(x, y) for x, y in outline),
        marks=tuple(_mark(tree_id, *place(x, y), tree, per_unit, crowd) for tree_id, x, y, tree in shown),
        legend=tuple(legend),
    )


def camera_places(contents: Contents) -> NDArray[np.float64]:
    """(C, 2) positions of the photos in the frame of ``trees.csv``; none where they are not known."""
    similarity = contents.cloud_from_scene
    if similarity is None:
        return np.zeros((0, 2))
    try:
        scene = read_scene(contents.out / "scene")
    except FsinferError:
        return np.zeros((0, 2))
    centers = np.array([view.camera.center for view in scene.views])
    placed = centers @ similarity[:3, :3].T + similarity[:3, 3]
    return np.asarray(contents.trees_per_cloud * placed[:, :2])


def _mark(tree_id: int, u: float, v: float, tree: Mapping[str, str], per_unit: float, crowd: float) -> Mark:
    dbh_cm, status = number(tree.get("dbh_cm")), status_of(tree)
    radius = max(0.0 if dbh_cm is None else per_unit * dbh_cm / 200, crowd * LEAST_RADIUS)
    said = f"Tree {tree_id}: " + ("no diameter" if dbh_cm is None else f"DBH {dbh_cm:.1f} cm")
    if status == "doubtful":
        said += ", doubtful"
    outside = is_in(tree) is False
    if outside:
        said += ", outside the plot"
    halo = max(radius + 5 * crowd, crowd * HALO)
    return Mark(tree_id=tree_id, u=u, v=v, radius=radius, halo=halo, status=status, said=said, outside=outside)


def _multiples(step: float, low: float, high: float) -> list[float]:
    """The multiples of ``step`` between ``low`` and ``high``."""
    return [k * step for k in range(math.ceil(low / step), math.floor(high / step) + 1)]


def _digits(value: float) -> str:
    """All of its digits: a northing of 5,812,350 would be 5.81235e+06, and the next line the same."""
    return f"{value:.10g}"


def round_step(least: float) -> float:
    """The smallest of 1, 2, 5, 10, 20 ... (and 0.5, 0.2 ...) that is at least ``least``."""
    power = 10.0 ** math.floor(math.log10(max(least, 1e-9)))
    return next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= least * (1 - 1e-9))
