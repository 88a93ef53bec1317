"""Points by place: what is near a position in plan, one point a cell, and how far apart points lie."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
#: Entries of a table of 32-bit numbers, one for each cell; only pages that hold points are ever touched.
#: Source: numerics.
MAX_TABLE = 100_000_000
#: Of so many points within half a metre of height others are not looked at for the spacing. Source: numerics.
MANY_POINTS = 50_000
#: The extent of a plot is that between these percentiles. Source: not recorded.
BOX_PERCENTILES = (0.5, 99.5)
#: Points are left out that lie farther outside of that box than half its size and so many metres. Source: not recorded.
BOX_MARGIN_M = 2.0
#: Points whose nearest neighbour tells the spacing. Source: numerics.
SPACING_SAMPLE = 2000
#: Half the height of the layer in which neighbours are looked for, and what of it has all of them, metres.
#: Source: numerics.
SPACING_HALF_M, SPACING_ASKED_M = 0.25, 0.2


def column_min(points: Floats) -> Floats:
    """Least value of each column of points (N, C): (C,), several times faster than along the rows."""
    return np.array([points[:, column].min() for column in range(points.shape[1])])


def column_max(points: Floats) -> Floats:
    """Greatest value of each column of points (N, C): (C,)."""
    return np.array([points[:, column].max() for column in range(points.shape[1])])


def rows(points: Floats, chosen: Bools) -> Floats:
    """Those of points (N, C) that are ``chosen`` (N,), five times faster than ``points[chosen]``."""
    return taken(points, np.flatnonzero(chosen))


def taken(points: Floats, order: Ints) -> Floats:
    """Rows ``order`` (K,) of points (N, C) that lie in memory row by row or column by column."""
    if points.flags.c_contiguous:
        return points.take(order, axis=0)
    return np.asarray(points.T.take(order, axis=1).T)


def cell_numbers(points: Floats, cell_m: float) -> Ints:
    """(N,) numbers, not negative, of the square cells that points (N, 2), N > 0, lie in, column by column."""
    column, row = (np.floor(points[:, axis] / cell_m).astype(np.int64) for axis in range(2))
    return np.asarray((column - column.min()) * (int(np.ptp(row)) + 1) + (row - row.min()))


def count_cells(points: Floats, cell_m: float) -> int:
    """Number of square cells that points (N, 2) lie in."""
    return len(np.unique(cell_numbers(points, cell_m))) if len(points) else 0


def near_paths(points: Floats, starts: Floats, ends: Floats, radius_m: float, *, cell_m: float = 0.1) -> Bools:
    """Which points (N, >= 2) may lie within ``radius_m`` in plan of the segments from ``starts`` to ``ends`` (K, 2).

    By cells of ``cell_m``: all that do, and some a cell farther away.
    """
    if len(points) == 0 or len(starts) == 0:
        return np.zeros(len(points), dtype=bool)
    low, high = column_min(points)[:2], column_max(points)[:2]
    shape = ((high - low) / cell_m).astype(np.int64) + 1
    wanted = np.zeros(shape, dtype=bool)
    # Half a diagonal of the cells at each end of the distance, and half a step along the segment.
    reach = radius_m + 2.0 * cell_m
    for start, end in zip(starts, ends, strict=True):
        for share in np.linspace(0.0, 1.0, int(np.hypot(*(end - start)) / cell_m) + 2):
            at = (start + share * (end - start) - low) / cell_m - 0.5
            first = np.maximum(np.floor(at - reach / cell_m).astype(np.int64), 0)
            last = np.minimum(np.ceil(at + reach / cell_m).astype(np.int64) + 1, shape)
            if (first >= last).any():
                continue
            x, y = np.ogrid[first[0] : last[0], first[1] : last[1]]
            wanted[first[0] : last[0], first[1] : last[1]] |= np.hypot(x - at[0], y - at[1]) <= reach / cell_m
    column = ((points[:, 0] - low[0]) / cell_m).astype(np.int64)
    row = ((points[:, 1] - low[1]) / cell_m).astype(np.int64)
    return np.asarray(wanted.ravel()[column * shape[1] + row])


class PlanIndex:
    """Points (N, >= 2) sorted by square cells in plan, for many quick looks at what is near a position."""

    def __init__(self, points: Floats, cell_m: float) -> None:
        self._cell_m = cell_m
        if len(points) == 0:
            self._points, self._shape, self._starts, self._low = points, (0, 0), np.zeros(1, np.int64), np.zeros(2)
            return
        self._low = column_min(points)[:2]
        column = ((points[:, 0] - self._low[0]) / cell_m).astype(np.int32)
        row = ((points[:, 1] - self._low[1]) / cell_m).astype(np.int32)
        self._shape = (int(column.max()) + 1, int(row.max()) + 1)
        key = column * self._shape[1] + row
        # NumPy sorts integers of 16 bits by radix, ten times faster than longer ones.
        order = np.argsort(key.astype(np.uint16) if self._shape[0] * self._shape[1] < 2**16 else key, kind="stable")
        self._points = taken(points, order)
        self._starts = np.concatenate([[0], np.cumsum(np.bincount(key, minlength=self._shape[0] * self._shape[1]))])

    def near(self, xy: Floats, radius_m: float) -> Floats:
        """Points no farther than ``radius_m`` from the position (2,) in plan."""
        low = np.floor((xy - radius_m - self._low) / self._cell_m).astype(np.int64)
        high = np.floor((xy + radius_m - self._low) / self._cell_m).astype(np.int64)
        first, last = max(int(low[1]), 0), min(int(high[1]), self._shape[1] - 1)
        columns = range(max(int(low[0]), 0), min(int(high[0]), self._shape[0] - 1) + 1)
        if first > last or len(columns) == 0:
            return self._points[:0]
        width = self._shape[1]
        spans = [(self._starts[row * width + first], self._starts[row * width + last + 1]) for row in columns]
        found = np.concatenate([self._points[a:b] for a, b in spans])
        distance2 = (found[:, 0] - xy[0]) ** 2 + (found[:, 1] - xy[1]) ** 2
        return rows(found, distance2 <= radius_m**2)


def measured_spacing(points: Floats, *, seed: int = 0) -> float:
    """Median distance to the nearest neighbour, from a random two thousand of the points (N, 3).

    Of dense clouds only those within half a metre of height, about the median, are looked at.
    """
    rng = np.random.default_rng(seed)
    rise = np.abs(points[:, 2] - np.median(points[:: max(len(points) // 10_000, 1), 2]))
    near = rows(points, rise <= SPACING_HALF_M)
    if len(near) < MANY_POINTS:
        near, asked = points, points
    else:
        # Whose neighbours are all there.
        asked = rows(points, rise <= SPACING_ASKED_M)
    index = rng.choice(len(asked), min(len(asked), SPACING_SAMPLE), replace=False)
    # Sliding midpoints instead of medians, and large leaves: the tree is built thrice as fast, and hardly asked.
    tree = cKDTree(near, balanced_tree=False, compact_nodes=False, leafsize=64)
    return float(np.median(tree.query(asked[index], k=2)[0][:, 1]))


def thin(points: Floats, cell_m: float) -> Floats:
    """One point of each occupied cubic cell of points (N, 3), in their order."""
    if len(points) == 0:
        return points
    low = column_min(points)
    cells = [((points[:, axis] - low[axis]) / cell_m).astype(np.int64) for axis in range(3)]
    extent = [int(cell.max()) + 1 for cell in cells]
    key = (cells[0] * extent[1] + cells[1]) * extent[2] + cells[2]
    if float(extent[0]) * float(extent[1]) * float(extent[2]) > MAX_TABLE:
        return taken(points, _first_of_each(key))
    # Written from the last to the first: the first of each cell stays.
    number = np.arange(len(key), dtype=np.int32)
    table = np.empty(extent[0] * extent[1] * extent[2], dtype=np.int32)
    table[key[::-1]] = number[::-1]
    return rows(points, table.take(key) == number)


def _first_of_each(key: Ints) -> Ints:
    """Rows, ascending, at which each value of keys (N,) >= 0 occurs first.

    Key and row in one number, because integers are sorted several times faster than they are argsorted.
    """
    bits = len(key).bit_length()
    if int(key.max()) >= 2 ** (63 - bits):
        return np.sort(np.unique(key, return_index=True)[1])
    both = np.sort((key << bits) + np.arange(len(key)))
    key = both >> bits
    first = np.flatnonzero(np.r_[True, key[1:] != key[:-1]])
    return np.sort(both.take(first) & (2**bits - 1))
