"""Whether the sides of a polygon cross."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fsinfer.plot_border.request import Place

Floats = NDArray[np.float64]


def sides_cross(corners: tuple[Place, ...]) -> bool:
    """Whether two sides of a polygon that are no neighbours have a point in common."""
    starts = np.array(corners, dtype=np.float64)
    ends = np.roll(starts, -1, axis=0)
    count = len(corners)
    for i in range(count - 2):
        # The last side is a neighbour of the first.
        others = slice(i + 2, count - 1 if i == 0 else count)
        if _meets_any(starts[i], ends[i], starts[others], ends[others]):
            return True
    return False


def _meets_any(a: Floats, b: Floats, c: Floats, d: Floats) -> bool:
    """Whether the side from ``a`` to ``b`` (2,) has a point in common with one of those from ``c`` to ``d`` (N, 2)."""

    def turn(p: Floats, q: Floats, r: Floats) -> Floats:
        pq, pr = (q - p).T, (r - p).T
        return np.asarray(pq[0] * pr[1] - pq[1] * pr[0])

    # Sides in one line lie on both sides of each other by every turn, however far apart they are.
    beside = (np.maximum(a, b) < np.minimum(c, d)) | (np.maximum(c, d) < np.minimum(a, b))
    crossed = (turn(a, b, c) * turn(a, b, d) <= 0) & (turn(c, d, a) * turn(c, d, b) <= 0)
    return bool((~beside.any(axis=1) & crossed).any())
