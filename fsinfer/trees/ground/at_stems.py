"""How well the ground at the foot of each stem is known: whether the cells round it agree with the surface, or any is.

A share of the whole plot cannot tell that a stem stands on a mound or in a ditch that the surface does not follow. What
stands in the cells of the stems themselves is no ground: stems that are seen from 1 m up would be their own.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fsinfer.trees.ground.ground import Ground

Floats = NDArray[np.float64]
#: What lies this near to a stem's surface is its own foot, metres. Source: judgement; bark, roots, and noise.
OWN_M = 0.15
#: The ground this far round a stem is the one that it stands on, metres, and so many of its cells, the nearest, tell.
#: Source: judgement; two rings of cells.
ROUND_M, NEAREST, LEAST = 1.0, 10, 3
#: Cells this near to the surface show ground. Source: as ``GroundSettings.agree_m``.
AGREE_M = 0.15
#: What the ground may rise or fall by, beyond the surface, on the way from where it was seen; and at most, metres.
#: Source: judgement; a bank or a ditch in ten.
UNSEEN_SLOPE, MOST_M = 0.1, 1.0
#: Ground is a layer: within so many metres of the surface there are more than so many times the points that are in as
#: thick a layer above it; a cloud of which the ground was cut off goes on upwards, with branches. Source: eight cuts of
#: four simulated scans and a real one without ground have 0.7 to 1.3; the four whole, a real one of pines and four
#: photographed plots 6 and more.
LAYER_M, LAYER_TIMES = 0.1, 2.0
#: From how far above the surface that other layer begins, metres: right above it, and above herbs, either of which
#: may hide the ground. Source: judgement; bilberries, grass and small ferns are lower.
ABOVE_M = (0.1, 0.6)
#: Of so many points it is asked. Source: numerics.
LAYER_POINTS = 200_000
#: Stems that may stand about one low place. Source: geometry, with room.
STEMS_AT_ONCE = 4


def level_std(ground: Ground, feet: Floats, radii: Floats) -> Floats:
    """Standard deviation (T,) of the ground's height at the feet (T, 2) of stems with radii (T,), metres.

    Beyond the ground's own noise; 0 where the cells of the ground are not known.
    """
    if ground.cells is None:
        return np.zeros(len(feet))
    if len(feet) == 0 or len(ground.cells) == 0:
        return np.full(len(feet), MOST_M)
    free = np.ones(len(ground.cells), dtype=bool)
    reach = radii + OWN_M + 0.5 * ground.cell_m
    for own in cKDTree(ground.cells[:, :2]).query_ball_point(feet, reach):
        free[own] = False
    cells = ground.cells[free]
    off = np.abs(cells[:, 2])
    agree = off <= AGREE_M
    distance = np.full(len(feet), np.inf)
    if agree.any():
        distance = np.maximum(cKDTree(cells[agree, :2]).query(feet)[0] - radii, 0.0)
    result = np.minimum(UNSEEN_SLOPE * np.maximum(distance - ROUND_M, 0.0), MOST_M)
    if len(cells) == 0:
        return np.asarray(result)
    gaps, nearest = cKDTree(cells[:, :2]).query(feet, k=min(NEAREST, len(cells)))
    for number, (gap, rows) in enumerate(zip(gaps.reshape(len(feet), -1), nearest.reshape(len(feet), -1), strict=True)):
        round_it = rows[gap <= radii[number] + OWN_M + ROUND_M]
        if len(round_it) >= LEAST:
            result[number] = max(result[number], float(np.median(off[round_it])))
    return np.minimum(result, MOST_M)


def is_layer(points: Floats, feet: Floats, radii: Floats) -> bool:
    """Whether the points (N, 3) of x, y, height above it show a ground, beside the feet (T, 2) of stems; metres."""
    low = np.flatnonzero((points[:, 2] >= -LAYER_M) & (points[:, 2] <= ABOVE_M[-1] + 2.0 * LAYER_M))
    low = low[:: max(len(low) // LAYER_POINTS, 1)]
    near = points[low]
    height = near[shows_ground(near[:, :2], feet, radii), 2]
    on_it = np.count_nonzero(height <= LAYER_M)
    above = min(np.count_nonzero((height > low_m) & (height <= low_m + 2.0 * LAYER_M)) for low_m in ABOVE_M)
    return bool(on_it > LAYER_TIMES * above)


def shows_ground(places: Floats, feet: Floats, radii: Floats) -> NDArray[np.bool_]:
    """Which of low places (N, 2) are not the foot of one of the stems at ``feet`` (T, 2) with ``radii`` (T,)."""
    if len(feet) == 0:
        return np.ones(len(places), dtype=bool)
    # Of thick stems beside thin ones the nearest foot is not always the one that a place belongs to.
    few = min(STEMS_AT_ONCE, len(feet))
    gap, nearest = cKDTree(feet).query(places, k=few, distance_upper_bound=float(radii.max()) + OWN_M)
    reach = np.append(radii + OWN_M, 0.0)[nearest]
    return np.asarray((gap > reach).reshape(len(places), few).all(axis=1))
