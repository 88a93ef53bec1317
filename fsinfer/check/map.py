"""The map of the check: where the photos were taken, the stems, and from where each was seen or not."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fsinfer.check.coverage import StemCoverage
from fsinfer.io.files import atomic_path

if TYPE_CHECKING:
    from fsinfer.check.result import CheckResult

Floats = NDArray[np.float64]

# Told apart by people who see no red and green (Okabe and Ito 2008), and by their form.
_SEEN, _MISSING, _WEAK, _OUTSIDE, _PATH = "#0072B2", "#D55E00", "#E69F00", "#999999", "#56B4E9"
#: A photo shows the bark on this side and that side of its direction. Source: layout.
_HALF_FAN_DEG = 15.0
#: Width and height in inches, and pixels an inch. Source: layout.
_WIDTH_INCH, _HEIGHT_INCH, _PX_PER_INCH = 8.5, 9.5, 130
#: Free room round what is drawn, metres. Source: layout.
_MARGIN_M = 1.5
#: Stems that are not judged, and the least of those that are: radius, metres. Source: layout.
_OUTSIDE_M, _LEAST_STEM_M = 0.1, 0.06
#: Rings round a stem, metres: the whole circle, the arcs that were seen, the side that was not; each with its width.
#: Source: layout.
_RING_M, _SEEN_RING_M, _MISSING_RING_M = (0.38, 0.06), (0.42, 0.14), (0.62, 0.34)
#: Where the arrow from the missing side begins, and the circle round a stem hardly seen, metres. Source: layout.
_ARROW_M, _WEAK_RING_M = 1.25, 0.6
#: Sizes of letters, points: title, named stem, other stem, legend, photo. Source: layout.
_TITLE_PT, _NAMED_PT, _STEM_PT, _LEGEND_PT, _PHOTO_PT = 11, 11, 8, 8, 6.5
#: Photos that are named at most, and letters of a name. Source: layout.
_NAMED_PHOTOS, _NAME_LETTERS = 13, 12


def draw_map(result: CheckResult, path: Path) -> None:
    """Write the map as PNG; up is north where it is known, else the first photo is at the bottom."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    turn = np.radians(result.compass.turn_deg)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    cameras = result.cameras @ rotation.T
    inside = [entry for entry in result.stems if entry.inside]
    figure = Figure(figsize=(_WIDTH_INCH, _HEIGHT_INCH), dpi=_PX_PER_INCH, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.plot(*cameras.T, "-", color=_PATH, linewidth=1, zorder=1)
    axes.plot(*cameras.T, ".", color=_PATH, markersize=4, zorder=1, label="photos, in order")
    for side in result.sides:
        axes.plot(*cameras[list(side.photos)].T, ":", color=_MISSING, linewidth=2, zorder=1)
    _name_photos(axes, cameras, result.names)
    for entry in result.stems:
        _draw_stem(axes, entry, rotation @ entry.stem.center, result.compass.turn_deg)
    shown = [entry for entry in result.stems if entry.inside or entry.verdict == "beyond"]
    corners = np.concatenate([cameras, *[(rotation @ entry.stem.center)[None] for entry in shown]])
    low, high = corners.min(axis=0) - _MARGIN_M, corners.max(axis=0) + _MARGIN_M
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal")
    axes.set_xlabel("metres" if result.metric else "metres, guessed: no scale is known")
    _legend(axes)
    stems = "stem" if len(inside) == 1 else "stems"
    up = "north is up" if result.compass.known else "the first photo is at the bottom, north is not known"
    again = sum(entry.verdict in ("one side", "hardly seen") for entry in inside)
    figure.suptitle(
        f"{result.registered} of {result.photos} photos placed, {len(inside)} {stems} within the walk, "
        f"{again} to photograph again\n{up}",
        fontsize=_TITLE_PT,
    )
    with atomic_path(path) as temporary:
        figure.savefig(temporary)


def _draw_stem(axes: Any, entry: StemCoverage, place: Floats, turn_deg: float) -> None:
    from matplotlib.patches import Circle, Wedge

    at = (float(place[0]), float(place[1]))
    if not entry.inside:
        named = entry.verdict == "beyond"
        axes.add_patch(Circle(at, _OUTSIDE_M, color=_MISSING if named else _OUTSIDE, zorder=2, linewidth=0))
        if named:
            axes.annotate(str(entry.number), place, (5, 5), textcoords="offset points", fontsize=_STEM_PT, zorder=5)
        return
    axes.add_patch(Wedge(at, _RING_M[0], 0, 360, width=_RING_M[1], color="0.88", zorder=2, linewidth=0))
    for first, last in seen_arcs(entry.azimuths_deg + turn_deg):
        axes.add_patch(
            Wedge(at, _SEEN_RING_M[0], first, last, width=_SEEN_RING_M[1], color=_SEEN, zorder=3, linewidth=0)
        )
    if entry.verdict == "one side":
        middle, half = entry.gap_center_deg + turn_deg, entry.gap_deg / 2 - _HALF_FAN_DEG
        radius, width = _MISSING_RING_M
        axes.add_patch(Wedge(at, radius, middle - half, middle + half, width=width, color=_MISSING, zorder=3))
        tip = place + _ARROW_M * np.array([np.cos(np.radians(middle)), np.sin(np.radians(middle))])
        axes.annotate(
            "", place, tip, arrowprops={"arrowstyle": "-|>", "color": _MISSING, "linewidth": 2, "shrinkB": 14}, zorder=4
        )
    elif entry.verdict == "hardly seen":
        axes.add_patch(Circle(at, _WEAK_RING_M, fill=False, color=_WEAK, linewidth=2.5, linestyle="--", zorder=3))
    axes.add_patch(Circle(at, max(entry.stem.radius, _LEAST_STEM_M), color="0.25", zorder=4, linewidth=0))
    bold = entry.verdict in ("one side", "hardly seen")
    axes.annotate(
        str(entry.number),
        place,
        (7, 7),
        textcoords="offset points",
        fontsize=_NAMED_PT if bold else _STEM_PT,
        fontweight="bold" if bold else "normal",
        zorder=5,
    )


def seen_arcs(azimuths_deg: Floats) -> list[tuple[float, float]]:
    """Arcs (first, last), degrees with ``first < last``, that fans round the directions cover together."""
    if len(azimuths_deg) == 0:
        return []
    ordered = np.sort(np.asarray(azimuths_deg) % 360)
    breaks = np.flatnonzero(np.diff(np.append(ordered, ordered[0] + 360)) > 2 * _HALF_FAN_DEG)
    if len(breaks) == 0:
        return [(0.0, 360.0)]
    firsts = [float(ordered[(index + 1) % len(ordered)]) for index in breaks]
    lasts = [float(ordered[index]) for index in np.roll(breaks, -1)]
    return [
        (first - _HALF_FAN_DEG, (last if last >= first else last + 360) + _HALF_FAN_DEG)
        for first, last in zip(firsts, lasts, strict=True)
    ]


def _name_photos(axes: Any, cameras: Floats, names: tuple[str, ...]) -> None:
    """The first photo, the last, and about a dozen between."""
    axes.plot(*cameras[0], ">", color="black", markersize=8, zorder=4)
    shown = np.unique(np.linspace(0, len(names) - 1, min(len(names), _NAMED_PHOTOS)).astype(int))
    for rank in shown:
        label = names[rank] if len(names[rank]) <= _NAME_LETTERS else "…" + names[rank][1 - _NAME_LETTERS :]
        # A name with two "$" is no formula.
        style = {"fontsize": _PHOTO_PT, "color": "0.35", "ha": "center", "zorder": 2, "parse_math": False}
        axes.annotate(label, cameras[rank], (0, -9), textcoords="offset points", **style)


def _legend(axes: Any) -> None:
    from matplotlib.lines import Line2D

    def spot(marker: str, color: str, label: str) -> Line2D:
        return Line2D([], [], linestyle="none", marker=marker, color=color, markersize=8, label=label)

    # Outside the axes as the layout counts them: where the plot is high, the title would be cut off otherwise.
    axes.figure.legend(
        handles=[
            Line2D([], [], color=_PATH, marker=".", label="photos, in order of walking"),
            spot(">", "black", "first photo"),
            spot("o", _SEEN, "seen from there"),
            spot("s", _MISSING, "not seen: stand here next time"),
            Line2D([], [], color=_WEAK, linestyle="--", label="hardly seen"),
            Line2D([], [], color=_MISSING, linestyle=":", linewidth=2, label="side left open"),
            spot("o", _MISSING, "beyond it"),
            spot("o", _OUTSIDE, "outside the walk, not judged"),
        ],
        loc="outside lower center",
        ncols=4,
        fontsize=_LEGEND_PT,
        frameon=False,
    )
