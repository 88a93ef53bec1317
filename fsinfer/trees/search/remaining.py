"""Another search among the points that belong to no stem yet, for stems that the first one does not look for."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fsinfer.notices.stems import StemCode
from fsinfer.trees.cylinder.axis import AxisSettings, axis_coordinates
from fsinfer.trees.points.cells import PlanIndex, rows
from fsinfer.trees.points.sums import lengths
from fsinfer.trees.search.hough import hough_seeds
from fsinfer.trees.search.stem import Stem, StemSettings
from fsinfer.trees.search.verify import Gradient, candidates_at, verify

Floats = NDArray[np.float64]
#: Points this near to the wall of a stem that was found are its own, metres. Source: judgement; bark, moss, twigs.
OWN_M = 0.1


def search_again(
    points: Floats,
    stems: Sequence[Stem],
    cell_m: float,
    s: StemSettings,
    *,
    index_cell_m: float,
    gradient_at: Gradient = np.zeros_like,
    most: int | None = None,
    apart_m: float = 0.0,
    axis: AxisSettings | None = None,
) -> tuple[Stem, ...]:
    """Stems by the settings ``s`` among points (N, 3) of x, y, height above ground, metres: those that none of
    ``stems`` owns.

    None has its axis within ``apart_m`` of the wall of another or one of ``stems``. Of the candidates the ``most``
    strongest are looked at; ``axis`` are the constants of their fits, ``gradient_at`` gives the slope of the ground.
    """
    left = _without(points, stems)
    if len(left) < s.min_points:
        return ()
    index = PlanIndex(left, index_cell_m)
    candidates = candidates_at(hough_seeds(left, cell_m, s)[:most], index, s, gradient_at)
    found = [stem for stem in verify(candidates, cell_m, s, axis=axis) if not isinstance(stem, StemCode)]
    kept: list[Stem] = []
    for stem in sorted(found, key=lambda item: -item.quality):
        if all(apart(stem, other, apart_m) for other in (*stems, *kept)):
            kept.append(stem)
    return tuple(kept)


def _without(points: Floats, stems: Sequence[Stem]) -> Floats:
    """Points (N, 3) that are not on or in one of the stems."""
    free = np.ones(len(points), dtype=bool)
    # By x in order: each stem is asked for a strip of the plot, not for all of it.
    order = np.argsort(points[:, 0])
    x = points[order, 0]
    highest = float(points[:, 2].max(initial=0.0))
    for stem in stems:
        reach = stem.axis.radius_m + OWN_M
        low, high = (stem.axis.center_at(height) for height in (0.0, highest))
        box_low, box_high = np.minimum(low, high) - reach, np.maximum(low, high) + reach
        strip = order[np.searchsorted(x, box_low[0]) : np.searchsorted(x, box_high[0], side="right")]
        near = strip[(points[strip, 1] >= box_low[1]) & (points[strip, 1] <= box_high[1])]
        offset, _ = axis_coordinates(points[near], stem.axis.parameters, stem.axis.height_m)
        free[near[lengths(offset) <= reach]] = False
    return rows(points, free)


def apart(stem: Stem, other: Stem, apart_m: float) -> bool:
    """Whether the axis of neither stands within the other or so near to it, at the first one's middle height."""
    height = stem.axis.height_m
    gap = float(np.linalg.norm(stem.axis.center_at(height) - other.axis.center_at(height)))
    return gap > max(stem.axis.radius_m, other.axis.radius_m) + apart_m
