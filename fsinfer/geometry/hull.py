"""The area that a few places of a plan enclose."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

Floats = NDArray[np.float64]


def in_hull(corners: Floats, places: Floats, margin_m: float) -> NDArray[np.bool_]:
    """Whether ``places`` (K, 2) lie in the convex hull of ``corners`` (N, 2), or at most ``margin_m`` outside it.

    Corners that enclose nothing (fewer than three, or all on a line) keep nothing out: everything is inside.
    """
    everything = np.ones(len(places), dtype=bool)
    if len(corners) < 3 or np.linalg.matrix_rank(corners - corners.mean(axis=0), tol=1e-6) < 2 or len(places) == 0:
        return everything
    try:
        sides = ConvexHull(corners).equations  # outward unit normal and offset of each side
    except QhullError:
        return everything
    return np.asarray((places @ sides[:, :2].T + sides[:, 2]).max(axis=1) <= margin_m)
