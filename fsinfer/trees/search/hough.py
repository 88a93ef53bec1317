"""Candidates for stems: cells of wall-like surface vote along their normals for the centres of all radii.

Votes of height bands add up over a metre of height, where only vertical round things agree.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, uniform_filter

from fsinfer.trees.points.cells import MAX_TABLE, column_max, column_min, rows
from fsinfer.trees.search.stem import StemSettings

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
#: Surroundings of a cell, of which the line-likeness and the normal are taken, in cells. Source: numerics.
_REACH_CELLS = 3.6
#: Cells whose neighbours are looked up at once: in one thread, see fsinfer.trees.points.sums. Source: numerics.
_CHUNK = 1000
#: Cells of the image of votes, at most: bounds the memory to 100 MB. Source: numerics.
_MOST_VOTES = 12e6
#: Steps of a band by which its filling is told. Source: numerics.
_STEPS = 5
#: Candidates, beside a few on a small plot; 30,000 a hectare bound the time in a thicket. Source: numerics.
_SEEDS_PER_M2, _SEEDS = 3.0, 50
#: Width in cells of the squares over which votes are added up, and over which a peak is the highest. Source: numerics.
_BLUR_CELLS, _PEAK_CELLS = 3, 5


def hough_seeds(slab: Floats, cell_m: float, s: StemSettings) -> Floats:
    """Candidate centres (K, 3) as x, y, mid height of the window, strongest first."""
    origin = column_min(slab)[:2] - s.radius_m[1]
    extent = column_max(slab)[:2] + s.radius_m[1] - origin
    vote_cell = float(max(2.0 * s.cell_m, np.sqrt(extent[0] * extent[1] / _MOST_VOTES)))
    shape = tuple(int(v) for v in np.ceil(extent / vote_cell)[::-1] + 1)
    band = np.floor((slab[:, 2] - s.heights_m[0]) / s.band_m).astype(np.int64)
    bands = int(np.ceil((s.heights_m[1] - s.heights_m[0]) / s.band_m))
    votes: list[tuple[Ints, Floats]] = []
    for number in range(bands):
        center, normal, weight = _wall_cells(rows(slab, band == number), cell_m, s.band_m)
        votes.append(_votes(center - origin, normal, weight, vote_cell, shape, s))
    per_window = max(round(s.window_m / s.band_m), 1)
    found = []
    for first in range(0, max(bands - per_window, 0) + 1, max(per_window // 2, 1)):
        chosen = votes[first : first + per_window]
        index = np.concatenate([v[0] for v in chosen])
        weight = np.concatenate([v[1] for v in chosen])
        image = np.bincount(index, weights=weight, minlength=shape[0] * shape[1]).reshape(shape) / per_window
        image = uniform_filter(image, size=_BLUR_CELLS, mode="constant") * float(_BLUR_CELLS**2)
        peak = (image >= s.min_votes) & (image == maximum_filter(image, size=_PEAK_CELLS, mode="constant"))
        row, column = np.nonzero(peak)
        xy = origin + (np.column_stack([column, row]) + 0.5) * vote_cell
        height = s.heights_m[0] + (first + 0.5 * per_window) * s.band_m
        found.append(np.column_stack([xy, np.full(len(xy), height), image[row, column]]))
    seeds = np.concatenate(found)
    limit = int(np.ceil(_SEEDS_PER_M2 * extent[0] * extent[1])) + _SEEDS
    order = np.lexsort((seeds[:, 1], seeds[:, 0], -seeds[:, 3]))[:limit]
    return seeds[order, :3]


def _wall_cells(points: Floats, cell_m: float, band_m: float) -> tuple[Floats, Floats, Floats]:
    """Occupied cells of one band: centre (C, 2), horizontal normal (C, 2), weight (C,).

    The weight is the share of the band's height that the cell fills times how line-like its surroundings are, so that
    vertical walls count and level twigs hardly do.
    """
    if len(points) < _STEPS:
        return np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0)
    steps = _STEPS
    low = column_min(points)
    # A margin as wide as the reach, so that every cell has all its neighbours.
    margin = int(_REACH_CELLS)
    column = ((points[:, 0] - low[0]) / cell_m).astype(np.int64) + margin
    row = ((points[:, 1] - low[1]) / cell_m).astype(np.int64) + margin
    rise = np.minimum((points[:, 2] - low[2]) / (band_m / steps), steps - 1).astype(np.int64)
    width = int(row.max()) + 1 + margin
    size = (int(column.max()) + 1 + margin) * width
    key, filled = _filled(rise, column * width + row, size)
    share = filled[key] / steps
    center = low[:2] + (np.column_stack([key // width, key % width]) - margin + 0.5) * cell_m
    moments, count = _moments(filled, key, width)
    total = moments[:, 0]
    mean_x, mean_y = moments[:, 1] / total, moments[:, 2] / total
    xx = moments[:, 3] / total - mean_x**2
    yy = moments[:, 4] / total - mean_y**2
    xy = moments[:, 5] / total - mean_x * mean_y
    # Closed-form eigenvectors of 2x2 matrices: the normal is perpendicular to the major axis.
    angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    difference = np.hypot(xx - yy, 2.0 * xy)
    linear = difference / np.maximum(xx + yy + difference, 1e-12) * 2.0
    normal = np.column_stack([-np.sin(angle), np.cos(angle)])
    alone = count < 3
    return center[~alone], normal[~alone], (share * np.minimum(linear, 1.0))[~alone]


def _filled(rise: Ints, own: Ints, size: int) -> tuple[Ints, NDArray[np.uint8]]:
    """The occupied cells (C,), ascending, and in how many of the steps ``rise`` (N,) each of all ``size`` cells is.

    ``own`` (N,) is the cell of each point. Where most of many cells are empty, as about a walk along a road, they are
    neither looked at nor written: memory that is only asked for is none yet.
    """
    if _STEPS * size <= MAX_TABLE:
        occupied = np.zeros(_STEPS * size, dtype=np.uint8)
        occupied[rise * size + own] = 1
        filled = occupied.reshape(_STEPS, size).sum(axis=0, dtype=np.uint8)
        return np.flatnonzero(filled > 0), filled
    key, count = np.unique(np.unique(own * _STEPS + rise) // _STEPS, return_counts=True)
    filled = np.zeros(size, dtype=np.uint8)
    filled[key] = count
    return key, filled


def _moments(filled: NDArray[np.uint8], key: Ints, width: int) -> tuple[Floats, Ints]:
    """Sums (C, 6) of 1, x, y, xx, yy, xy over the cells within ``_REACH_CELLS`` of each, and their number (C,).

    ``filled`` (S,) are the weights of a grid of rows of ``width``, ``key`` (C,) the occupied cells; x and y are in
    cells from each.
    """
    reach = int(_REACH_CELLS)
    x, y = (steps.ravel() for steps in np.mgrid[-reach : reach + 1, -reach : reach + 1])
    inside = x**2 + y**2 <= _REACH_CELLS**2
    x, y = x[inside], y[inside]
    basis = np.column_stack([np.ones(len(x)), x, y, x**2, y**2, x * y]).astype(np.float32)
    moments = np.empty((len(key), 6))
    count = np.empty(len(key), dtype=np.int64)
    for first in range(0, len(key), _CHUNK):
        weight = filled[key[first : first + _CHUNK, None] + (x * width + y)]
        moments[first : first + _CHUNK] = weight.astype(np.float32) @ basis
        count[first : first + _CHUNK] = np.count_nonzero(weight, axis=1)
    return moments, count


def _votes(
    center: Floats, normal: Floats, weight: Floats, vote_cell: float, shape: tuple[int, ...], s: StemSettings
) -> tuple[Ints, Floats]:
    radii = np.arange(s.radius_m[0] + 0.5 * vote_cell, s.radius_m[1], vote_cell)
    radii = np.concatenate([-radii, radii])
    if len(center) == 0:
        return np.zeros(0, dtype=np.int64), np.zeros(0)
    column, row = (_steps_along(center[:, axis], normal[:, axis], radii, vote_cell) for axis in range(2))
    index = row * shape[1]
    index += column
    weights = np.repeat(weight, len(radii))
    if column.min() < 0 or row.min() < 0 or column.max() >= shape[1] or row.max() >= shape[0]:
        inside = (column >= 0) & (row >= 0) & (column < shape[1]) & (row < shape[0])
        return index[inside], weights[inside.ravel()]
    return index.ravel(), weights


def _steps_along(center: Floats, normal: Floats, radii: Floats, vote_cell: float) -> Ints:
    """Cell numbers (C, R) along one axis of the places ``radii`` (R,) away from each of the centres (C,)."""
    position = normal[:, None] * radii
    position += center[:, None]
    position /= vote_cell
    return position.astype(np.int64)
