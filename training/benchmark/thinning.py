"""Random thinning of a cloud to a least distance between its points, exactly and without a loop over points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

#: Points whose pairs fit into memory even if all of them lie within the distance of each other. Source: numerics.
FIRST_BATCH = 1024
#: Points asked for at a time: 32 MB of answers. Source: numerics.
QUERY_CHUNK = 2_000_000


def thin(points: NDArray[np.float64], distance: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Choose points in random order, each unless a chosen one lies within ``distance`` of it.

    No two chosen points are within ``distance`` of each other, and every other point is within ``distance`` of a
    chosen one. The result is exactly that of going through the points one by one in the random order (as the DTU
    benchmark's ``reducePts`` does), but it is found in batches, each as large as all before it together: what the
    points chosen so far leave over of a batch is settled among itself, and with a random order that is little.

    Parameters
    ----------
    points: (N, 3), any unit.
    distance: in the same unit; a distance equal to it counts as within.
    rng: draws the order.

    Returns
    -------
    (N,) mask of the chosen points.
    """
    count = len(points)
    local = spatial_order(points, 5 * distance)
    points = points[local]
    rank = np.empty(count, dtype=np.intp)
    rank[rng.permutation(count)] = np.arange(count)
    rank = rank[local]
    chosen = np.zeros(count, dtype=bool)
    beyond = np.nextafter(distance, np.inf)  # the tree's bound is exclusive
    start, stop = 0, min(FIRST_BATCH, count)
    while start < count:
        batch = np.flatnonzero((rank >= start) & (rank < stop))
        kept = np.flatnonzero(chosen)
        if len(kept):
            batch = batch[~_any_within(points[kept], points[batch], beyond)]
        if len(batch):
            batch = batch[np.argsort(rank[batch])]
            chosen[batch[_first_of_each(points[batch], distance)]] = True
        start, stop = stop, min(2 * stop, count)
    result = np.empty(count, dtype=bool)
    result[local] = chosen
    return result


def spatial_order(points: NDArray[np.float64], cell: float) -> NDArray[np.intp]:
    """Order of the points by cells of a grid: a tree that is asked for neighbours in it is some four times faster."""
    if not len(points):
        return np.empty(0, dtype=np.intp)
    bits = 20  # an axis; what lies farther from the low corner shares the last cell
    index = np.minimum((points - points.min(axis=0)) / cell, 2**bits - 1).astype(np.int64)
    return np.argsort((index[:, 0] << 2 * bits) | (index[:, 1] << bits) | index[:, 2])


def _any_within(kept: NDArray[np.float64], asked: NDArray[np.float64], bound: float) -> NDArray[np.bool_]:
    tree = cKDTree(kept, compact_nodes=False)
    near = np.empty(len(asked), dtype=bool)
    for first in range(0, len(asked), QUERY_CHUNK):
        part = slice(first, first + QUERY_CHUNK)
        distances, _ = tree.query(asked[part], distance_upper_bound=bound, workers=-1)
        near[part] = np.isfinite(distances)
    return near


def _first_of_each(points: NDArray[np.float64], distance: float) -> NDArray[np.bool_]:
    """Greedy choice in the order of the rows, all rows at once that have no earlier undecided neighbour."""
    pairs = cKDTree(points).query_pairs(distance, output_type="ndarray")  # i < j, so i comes first
    undecided = np.ones(len(points), dtype=bool)
    chosen = np.zeros(len(points), dtype=bool)
    while True:
        free = undecided.copy()
        free[pairs[:, 1]] = False
        chosen |= free
        undecided &= ~free
        undecided[pairs[free[pairs[:, 0]], 1]] = False
        pairs = pairs[undecided[pairs].all(axis=1)]
        if not len(pairs):
            return chosen | undecided
