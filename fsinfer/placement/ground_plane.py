"""The ground as a plane below the cameras: good enough for where breast height begins, not for which way is up."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fsinfer.placement.settings import LevelSettings
from fsinfer.trees.points.cells import cell_numbers

Array = NDArray[np.float64]

#: Cells, and points in each, that a ground needs. Source: judgement; twice what a plane needs.
_MIN_CELLS, _MIN_CELL_POINTS = 6, 3
#: One in so many points of a cell lies below the one that stands for it. Source: judgement; single points below the
#: ground are common in clouds from images.
_BELOW_SEED = 10
#: RANSAC trials, and rounds of fits to what a plane holds. Source: numerics; with half of the cells ground, 200 trials
#: miss with probability 3e-12.
_TRIALS, _PLANE_ROUNDS = 200, 5
#: Lengths that stand for none. Source: numerics.
_LEAST_LENGTH = 1e-12


def ground_plane(
    upright: Array, cameras: Array, *, settings: LevelSettings | None = None, seed: int = 0
) -> Array | None:
    """RANSAC plane through the lowest points of the cells of a grid, below the cameras.

    Parameters
    ----------
    upright: (N, 3), z roughly up. cameras: (C, 3) in the same frame.

    Returns
    -------
    (3,) a, b, c of ``z = a x + b y + c``, or None where no plane within ``max_tilt_deg`` holds a fifth of the cells.
    """
    settings = settings or LevelSettings()
    center = np.median(cameras, axis=0)
    low = upright[upright[:, 2] < np.median(cameras[:, 2])]
    if len(low) < _MIN_CELLS * _MIN_CELL_POINTS:
        return None
    # Backgrounds far away are no ground of this plot: look as far as twice the reach of most points.
    distance = np.hypot(*(low[:, :2] - center[:2]).T)
    reach = 2 * float(np.median(distance))
    low = low[distance <= reach]
    own = cell_numbers(low[:, :2] - center[:2], 2 * reach / settings.cells)
    order = np.lexsort((low[:, 2], own))
    starts = np.flatnonzero(np.diff(own[order], prepend=-1))
    counts = np.diff(np.append(starts, len(order)))
    # The lowest tenth, not the lowest: single points below the ground are common in clouds from images.
    seeds = low[order[starts + counts // _BELOW_SEED]][counts >= _MIN_CELL_POINTS]
    if len(seeds) < _MIN_CELLS:
        return None
    rng = np.random.default_rng(seed)
    tolerance = settings.plane_tolerance * 2 * reach
    best, best_score = None, settings.min_ground_part * len(seeds)
    for _ in range(_TRIALS):
        three = seeds[rng.choice(len(seeds), 3, replace=False)]
        normal = np.cross(three[1] - three[0], three[2] - three[0])
        length = float(np.linalg.norm(normal))
        if length < _LEAST_LENGTH or abs(normal[2]) < length * np.cos(np.radians(settings.max_tilt_deg)):
            continue
        residual = (seeds - three[0]) @ normal / length
        # MSAC: what lies within counts by how near it lies, so that the best of several full planes wins.
        score = float(np.clip(1 - (residual / tolerance) ** 2, 0, None).sum())
        if score > best_score:
            best, best_score = np.abs(residual) < 2 * tolerance, score
    if best is None:
        return None
    plane = np.zeros(3)
    for _ in range(_PLANE_ROUNDS):
        inliers = seeds[best]
        plane = np.linalg.lstsq(np.column_stack([inliers[:, :2], np.ones(len(inliers))]), inliers[:, 2], rcond=None)[0]
        best = np.abs(seeds[:, :2] @ plane[:2] + plane[2] - seeds[:, 2]) < tolerance
        if best.sum() < _MIN_CELLS:
            break
    return np.asarray(plane)
