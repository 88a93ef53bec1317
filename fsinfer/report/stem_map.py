"""The stem map as SVG: every tree a button, drawn to scale or a little larger, with the places of the photos."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import FsinferError
from fsinfer.report.contents import Contents, number, tree_number
from fsinfer.report.html import escape
from fsinfer.scene import read_scene

WIDTH = 640.0
MARGIN = 34.0
# Stems thinner than this on the map are hard to hit with a finger; the halo around them belongs to the button too.
LEAST_RADIUS = 6.0
HALO = 16.0
# The side of the map in metres is at least this, so that a single tree does not fill it.
LEAST_SPAN_M = 4.0
# Cameras farther outside the trees than this share of the map, or this distance, are not drawn: one stray pose must not
# shrink it.
STRAY_SHARE = 0.6
NEAR_M = 8.0


def stem_map(contents: Contents) -> str:
    """Return the map with its legend; empty where no tree has a position."""
    trees = [
        (tree_id, x, y, tree)
        for tree in contents.trees or ()
        if (tree_id := tree_number(tree)) is not None
        and (x := number(tree.get("x_m"))) is not None
        and (y := number(tree.get("y_m"))) is not None
    ]
    if not trees:
        return ""
    stems = np.array([[x, y] for _, x, y, _ in trees])
    low, high = stems.min(axis=0), stems.max(axis=0)
    cameras = camera_places(contents)
    span = max(float((high - low).max()), LEAST_SPAN_M * contents.metre)
    reach = max(STRAY_SHARE * span, NEAR_M * contents.metre)
    near = cameras[((cameras >= low - reach) & (cameras <= high + reach)).all(axis=1)]
    if len(near):
        low, high = np.minimum(low, near.min(axis=0)), np.maximum(high, near.max(axis=0))
    short = np.maximum(0.35 * span - (high - low), 0) / 2
    low, high = low - short - 0.03 * span, high + short + 0.03 * span
    per_unit = (WIDTH - 2 * MARGIN) / float(high[0] - low[0])
    height = per_unit * float(high[1] - low[1]) + 2 * MARGIN

    def place(x: float, y: float) -> tuple[float, float]:
        return MARGIN + per_unit * (x - low[0]), height - MARGIN - per_unit * (y - low[1])

    dots = "".join(f'<circle cx="{u:.1f}" cy="{v:.1f}" r="2.4"/>' for x, y in near for u, v in [place(x, y)])
    marks = "".join(_tree(tree_id, *place(x, y), tree, per_unit) for tree_id, x, y, tree in trees)
    unit = "m" if contents.metric else "units"
    kinds = ("ok", "doubtful", "unmeasured")
    names = {"ok": "measured", "doubtful": "doubtful", "unmeasured": "no diameter"}
    present = [kind for kind in kinds if any(tree.get("status") == kind for _, _, _, tree in trees)]
    legend = "".join(f'<span><i class="{kind}"></i>{names[kind]}</span>' for kind in present)
    if len(near):
        legend += '<span><i class="camera"></i>photo taken here</span>'
    return (
        f'<div class="map"><svg viewBox="0 0 {WIDTH:.0f} {height:.0f}" role="group" '
        f'aria-label="Stem map with {len(trees)} trees; choose one to see its card">'
        f"{_frame(low, high, per_unit, height, unit)}"
        f'<g fill="#7a8dbd" aria-hidden="true">{dots}</g>{marks}</svg><div class="legend">{legend}</div></div>'
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


def _tree(tree_id: int, u: float, v: float, tree: dict[str, str], per_unit: float) -> str:
    dbh_cm = number(tree.get("dbh_cm"))
    radius = max(0.0 if dbh_cm is None else per_unit * dbh_cm / 200, LEAST_RADIUS)
    status = tree.get("status", "")
    kind = status if status in ("ok", "doubtful", "unmeasured") else "ok"
    said = f"Tree {tree_id}: " + ("no diameter" if dbh_cm is None else f"DBH {dbh_cm:.1f} cm")
    if kind == "doubtful":
        said += ", doubtful"
    return (
        f'<g class="tree {kind}" data-tree="{tree_id}" tabindex="0" role="button" aria-pressed="false" '
        f'aria-label="{escape(said)}"><title>{escape(said)}</title>'
        f'<circle class="halo" cx="{u:.1f}" cy="{v:.1f}" r="{max(radius + 5, HALO):.1f}"/>'
        f'<circle class="stem" cx="{u:.1f}" cy="{v:.1f}" r="{radius:.1f}"/>'
        f'<text x="{u:.1f}" y="{v - radius - 4:.1f}">{tree_id}</text></g>'
    )


def _frame(low: NDArray[np.float64], high: NDArray[np.float64], per_unit: float, height: float, unit: str) -> str:
    """A grid with round numbers on both axes."""
    step = round_step(float(max(high - low)) / 6)
    lines, texts = [], []
    for k in range(math.ceil(low[0] / step), math.floor(high[0] / step) + 1):
        u = MARGIN + per_unit * (k * step - low[0])
        lines.append(f"M{u:.1f} {MARGIN:.1f}V{height - MARGIN:.1f}")
        texts.append(
            f'<text class="axis" x="{u:.1f}" y="{height - MARGIN + 16:.1f}" text-anchor="middle">{k * step:g}</text>'
        )
    for k in range(math.ceil(low[1] / step), math.floor(high[1] / step) + 1):
        v = height - MARGIN - per_unit * (k * step - low[1])
        lines.append(f"M{MARGIN:.1f} {v:.1f}H{WIDTH - MARGIN:.1f}")
        texts.append(f'<text class="axis" x="{MARGIN - 5:.1f}" y="{v + 4:.1f}" text-anchor="end">{k * step:g}</text>')
    texts.append(f'<text class="axis" x="{WIDTH - 4:.0f}" y="{height - 4:.1f}" text-anchor="end">x ({unit})</text>')
    texts.append(f'<text class="axis" x="4" y="14">y ({unit})</text>')
    return f'<path d="{"".join(lines)}" stroke="#e2e7e3" fill="none"/><g aria-hidden="true">{"".join(texts)}</g>'


def round_step(least: float) -> float:
    """The smallest of 1, 2, 5, 10, 20 ... (and 0.5, 0.2 ...) that is at least ``least``."""
    power = 10.0 ** math.floor(math.log10(max(least, 1e-9)))
    return next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= least * (1 - 1e-9))
