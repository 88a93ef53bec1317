"""Points by place: what is near a position in plan, one point a cell, and how far apart points lie."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
# A table of 32-bit numbers with an entry for each cell, of which only the pages that hold points are ever touched.
MAX_TABLE = 100_000_000


class PlanIndex:
    """Points (N, >= 2) sorted by square cells in plan, for many quick looks at what is near a position."""

    def __init__(self, points: Floats, cell_m: float) -> None:
        self._cell_m = cell_m
        if len(points) == 0:
            self._points, self._shape, self._starts, self._low = points, (0, 0), np.zeros(1, np.int64), np.zeros(2)
            return
        self._low = points[:, :2].min(axis=0)
        cell = ((points[:, :2] - self._low) / cell_m).astype(np.int32)
        self._shape = (int(cell[:, 0].max()) + 1, int(cell[:, 1].max()) + 1)
        key = cell[:, 0] * self._shape[1] + cell[:, 1]
        order = np.argsort(key, kind="stable")
        self._points = points[order]
        self._starts = np.concatenate([[0], np.cumsum(np.bincount(key, minlength=self._shape[0] * self._shape[1]))])

    def near(self, xy: Floats, radius_m: float) -> Floats:
        """Points no farther than ``radius_m`` from the position (2,) in plan."""
        low = np.floor((xy - radius_m - self._low) / self._cell_m).astype(np.int64)
        high = np.floor((xy + radius_m - self._low) / self._cell_m).astype(np.int64)
        first, last = max(int(low[1]), 0), min(int(high[1]), self._shape[1] - 1)
        rows = range(max(int(low[0]), 0), min(int(high[0]), self._shape[0] - 1) + 1)
        if first > last or len(rows) == 0:
            return self._points[:0]
        width = self._shape[1]
        spans = [(self._starts[row * width + first], self._starts[row * width + last + 1]) for row in rows]
        found = np.concatenate([self._points[a:b] for a, b in spans])
        distance2 = (found[:, 0] - xy[0]) ** 2 + (found[:, 1] - xy[1]) ** 2
        return np.asarray(found[distance2 <= radius_m**2])


def measured_spacing(points: Floats, *, seed: int = 0) -> float:
    """Median distance to the nearest neighbour, from a random two thousand of the points (N, 3)."""
    rng = np.random.default_rng(seed)
    index = rng.choice(len(points), min(len(points), 2000), replace=False)
    # Sliding midpoints instead of medians: the tree is built thrice as fast, and hardly asked.
    tree = cKDTree(points, balanced_tree=False, compact_nodes=False)
    return float(np.median(tree.query(points[index], k=2)[0][:, 1]))


def thin(points: Floats, cell_m: float) -> Floats:
    """One point of each occupied cubic cell of points (N, 3), in their order."""
    if len(points) == 0:
        return points
    cells = ((points - points.min(axis=0)) / cell_m).astype(np.int64)
    extent = cells.max(axis=0) + 1
    key = (cells[:, 0] * extent[1] + cells[:, 1]) * extent[2] + cells[:, 2]
    if float(extent[0]) * float(extent[1]) * float(extent[2]) > MAX_TABLE:
        return np.asarray(points[np.sort(np.unique(key, return_index=True)[1])])
    # Written from the last to the first: the first of each cell stays.
    number = np.arange(len(key), dtype=np.int32)
    table = np.empty(int(np.prod(extent)), dtype=np.int32)
    table[key[::-1]] = number[::-1]
    return np.asarray(points[table[key] == number])
