"""Merging points into one per voxel, batch by batch, so that memory follows the surface and not the photographs."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

#: Bits for each axis: three fit into one signed 64-bit key. Source: format.
_AXIS_BITS = 21
#: Cells that they count, and how far apart points may lie, neighbours on both sides left free. Source: format.
_AXIS_CELLS, MAX_EXTENT_VOXELS = 1 << _AXIS_BITS, (1 << _AXIS_BITS) - 4
#: Where more points are left than wanted, the voxel grows by so much more than the square root of their number, lest
#: one step be not quite enough. Source: numerics; points on surfaces fall with the square of the voxel.
_GROWTH = 1.05
#: Lengths and weights that stand for none. Source: numerics.
_LEAST_LENGTH, _LEAST_WEIGHT = 1e-12, 1e-300
#: Points that are merged, or told their voxel, at a time: what they need stays in a core's cache. Source: numerics.
_AT_ONCE = 32_768
#: Times as many points as there are that room is made for when it is short. Source: numerics.
_ROOM = 1.5


@dataclass(frozen=True, kw_only=True)
class Samples:
    """N points with what is averaged over a voxel.

    Attributes
    ----------
    xyz: (N, 3) float64.
    rgb: (N, 3) float32, 0..255.
    normals: (N, 3) float32.
    weight: (N,) float64 > 0, inverse variance of the position up to a factor.
    confidence: (N,) float32.
    views: (N,) int32; a merged point keeps the largest.
    count: (N,) int32, number of depth pixels behind each.
    """

    xyz: NDArray[np.float64]
    rgb: NDArray[np.float32]
    normals: NDArray[np.float32]
    weight: NDArray[np.float64]
    confidence: NDArray[np.float32]
    views: NDArray[np.int32]
    count: NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.xyz)

    @property
    def quality(self) -> NDArray[np.float64]:
        """(N,) inverse variance of a single depth pixel behind each, up to the factor of ``weight``."""
        return self.weight / self.count


def voxel_keys(xyz: NDArray[np.float64], voxel: float) -> NDArray[np.int64]:
    """(N,) int64 key of the cell of each point; the grid is anchored at the world's origin.

    Keys wrap round every two million voxels, so the points must lie within ``MAX_EXTENT_VOXELS`` of each other.
    """
    keys = np.empty(len(xyz), np.int64)
    for start in range(0, len(xyz), _AT_ONCE):
        rows = slice(start, start + _AT_ONCE)
        keys[rows] = _packed(np.floor(xyz[rows] / voxel).astype(np.int64) & (_AXIS_CELLS - 1))
    return keys


def _packed(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """(N,) int64 key of cells (N, 3) that are not negative."""
    return np.asarray((cells[:, 0] << (2 * _AXIS_BITS)) | (cells[:, 1] << _AXIS_BITS) | cells[:, 2])


def merge_voxels(samples: Samples, voxel: float) -> tuple[NDArray[np.int64], Samples]:
    """Merge the points of each voxel into their weighted mean: the keys of the voxels, rising, and the point of each.

    The mean of a patch of a curved surface lies inside it by at most voxel^2 / (8 R): 0.03 mm for voxels of 5 mm
    on a stem of 10 cm radius, so voxels do not bias diameters.
    """
    keys = voxel_keys(samples.xyz, voxel)
    if not len(samples):
        return keys, samples
    order = np.argsort(keys, kind="stable")
    keys = keys[order]
    starts = np.flatnonzero(np.concatenate([[True], keys[1:] != keys[:-1]]))
    merged = _room_for(len(starts), like=samples)
    ends = np.append(starts, len(order))
    # So many voxels at a time as hold that many points.
    cuts = np.unique(np.append(np.searchsorted(starts, np.arange(0, len(order), _AT_ONCE)), len(starts)))
    for first, last in itertools.pairwise(cuts):
        points = take(samples, order[ends[first] : ends[last]])
        _write(merged, int(first), _merged(points, starts[first:last] - ends[first]))
    return keys[starts], Samples(**merged)


def _merged(samples: Samples, starts: NDArray[np.intp]) -> Samples:
    """The mean of each voxel's points, which follow each other from ``starts`` on."""
    weight, count = samples.weight, samples.count
    total, counts = np.add.reduceat(weight, starts), np.add.reduceat(count, starts)
    # Row by row the weighted sum over one voxel.
    every = np.arange(len(weight))
    sums = csr_matrix((weight, every, np.append(starts, len(weight))), shape=(len(starts), len(weight)))

    def mean(values: NDArray[np.floating]) -> NDArray[np.float64]:
        return np.asarray(sums @ values) / total[:, None]

    return Samples(
        xyz=mean(samples.xyz),
        rgb=mean(samples.rgb).astype(np.float32),
        normals=_of_unit_length(mean(samples.normals)),
        weight=total,
        confidence=(np.add.reduceat(samples.confidence * count, starts) / counts).astype(np.float32),
        views=np.maximum.reduceat(samples.views, starts),
        count=counts.astype(np.int32),
    )


def _of_unit_length(normals: NDArray[np.float64]) -> NDArray[np.float32]:
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(normals / np.maximum(lengths, _LEAST_LENGTH), dtype=np.float32)


def select(samples: Samples, chosen: NDArray[np.bool_]) -> Samples:
    """Keep the points of a mask."""
    return Samples(**{name: getattr(samples, name)[chosen] for name in Samples.__dataclass_fields__})


def take(samples: Samples, numbers: NDArray[np.intp]) -> Samples:
    """Those of these numbers, in their order."""
    return Samples(**{name: values.take(numbers, axis=0) for name, values in _fields(samples).items()})


def sum_within(
    xyz: NDArray[np.float64],
    cell: float,
    values: NDArray[np.floating | np.integer],
    bins: NDArray[np.int64] | None = None,
) -> NDArray[np.float64]:
    """Sums of ``values`` in the 3x3x3 cells around each point's own, over points of the same bin.

    Parameters
    ----------
    values: (N,), or (K, N) for K sums at once.
    bins: (N,) small non-negative integers; points of different bins do not see each other.

    Returns
    -------
    In the shape of ``values``.
    """
    cells = np.floor(xyz / cell).astype(np.int64)
    cells -= cells.min(axis=0, initial=np.iinfo(np.int64).max) - 1  # so that neighbours on the lower side have a key
    plain = _packed(cells)
    del cells
    each = np.atleast_2d(values)
    result = np.zeros(each.shape)
    labels = np.zeros(len(xyz), np.int64) if bins is None else bins
    for label in np.unique(labels):
        mine = np.flatnonzero(labels == label)
        keys, own = np.unique(plain[mine], return_inverse=True)
        sums = np.stack([np.bincount(own, weights=row[mine], minlength=len(keys)) for row in each])
        total = np.zeros(sums.shape)
        for dx in (-1, 0, 1):
            for dy in (-1, 0, 1):
                # Three cells above each other have keys that follow each other: those there are stand side by side.
                lowest = keys + ((dx << (2 * _AXIS_BITS)) + (dy << _AXIS_BITS) - 1)
                first = np.searchsorted(keys, lowest)
                for place in (first, first + 1, first + 2):
                    inside = np.minimum(place, len(keys) - 1)
                    there = (place < len(keys)) & (keys[inside] <= lowest + 2)
                    total += np.where(there, sums[:, inside], 0)
        result[:, mine] = total[:, own]
    return result.reshape(values.shape)


def much_worse_than_nearby(samples: Samples, cell: float, ratio: float) -> NDArray[np.bool_]:
    """(N,) bool: points whose standard deviation is over ``ratio`` times that of their surroundings.

    A trunk seen from near and from far gets a halo of the far views' points round the near views' sharp surface.
    Where near observations exist the far ones add nothing but that halo. A point is compared with those within one to
    two cells that face the same way (one of six directions), so that a side seen only from far is kept. The variance of
    the surroundings is the mean over their pixels, each weighted by its inverse variance.
    """
    quality = samples.quality
    axis = np.abs(samples.normals).argmax(axis=1)
    facing = 2 * axis + (samples.normals[np.arange(len(axis)), axis] > 0)
    of_quality, weight = sum_within(samples.xyz, cell, np.stack([samples.weight * quality, samples.weight]), facing)
    best = of_quality / np.maximum(weight, _LEAST_WEIGHT)
    return np.asarray(quality * ratio**2 < best)


class VoxelMerger:
    """Collects batches and merges them whenever ``batch_points`` new ones have come.

    Only what is new is sorted: it is merged by itself, and then into the voxels that are there already.
    """

    def __init__(self, voxel: float, *, max_points: int, batch_points: int) -> None:
        self.voxel = voxel
        self._max_points = max_points
        self._batch_points = batch_points
        self._voxels: _Voxels | None = None
        # One place for what waits, which is filled again and again: fresh memory costs more than what is written to it.
        self._waiting: dict[str, NDArray[Any]] = {}
        self._count = 0

    def add(self, samples: Samples) -> None:
        """Take one batch."""
        if not self._waiting:
            # Those of the view that fills a batch come on top; what is not written takes no memory.
            self._waiting = _room_for(self._batch_points + 2 * len(samples), like=samples)
        _write(self._waiting, self._count, samples)
        self._count += len(samples)
        if self._count > self._batch_points:
            self._merge()

    def result(self) -> Samples | None:
        """Return everything merged, in voxels as large as ``max_points`` asks for, and keep nothing of it.

        None when nothing came.
        """
        self._merge()
        self._waiting = {}
        merged, self._voxels = None if self._voxels is None else self._voxels.samples(), None
        return merged

    def _merge(self) -> None:
        if not self._count:
            return
        waiting = Samples(**{name: values[: self._count] for name, values in self._waiting.items()})
        self._count = 0
        keys, merged = merge_voxels(waiting, self.voxel)
        if self._voxels is None:
            self._voxels = _Voxels(keys, merged)
        else:
            self._voxels.add(keys, merged)
        while len(self._voxels) > self._max_points:
            self.voxel *= _GROWTH * (len(self._voxels) / self._max_points) ** 0.5
            self._voxels = _Voxels(*merge_voxels(self._voxels.in_no_order(), self.voxel))


class _Voxels:
    """Merged points in the order in which their voxels came, and where that of each key is.

    Only what is new or changed is written, so that a batch costs what its own size asks for.
    """

    def __init__(self, keys: NDArray[np.int64], points: Samples) -> None:
        """``keys`` are without doubles and rise, as those of :func:`merge_voxels`."""
        self._keys = keys
        self._place = np.arange(len(keys))
        self._count = len(keys)
        # By the fields' names, with room for more behind what is there.
        self._values = _fields(points)

    def __len__(self) -> int:
        return self._count

    def samples(self) -> Samples:
        """All points in the order of their keys."""
        return Samples(**{name: values[self._place] for name, values in self._values.items()})

    def in_no_order(self) -> Samples:
        """The same as they lie in memory, which is not copied."""
        return Samples(**{name: values[: self._count] for name, values in self._values.items()})

    def add(self, keys: NDArray[np.int64], new: Samples) -> None:
        """Merge points into the voxels; ``keys`` as at first."""
        at = np.searchsorted(self._keys, keys)
        known = self._keys[np.minimum(at, len(self._keys) - 1)] == keys
        old = np.flatnonzero(known)
        for start in range(0, len(old), _AT_ONCE):
            numbers = old[start : start + _AT_ONCE]
            self._average(self._place[at[numbers]], take(new, numbers))
        gaps = at[~known]
        self._place = np.insert(self._place, gaps, np.arange(self._count, self._count + len(gaps)))
        self._keys = np.insert(self._keys, gaps, keys[~known])
        self._append(select(new, ~known))

    def _average(self, at: NDArray[np.intp], new: Samples) -> None:
        held = self._values
        total = held["weight"][at] + new.weight
        share = (new.weight / total)[:, None]
        for name in ("xyz", "rgb"):
            there = held[name][at]
            held[name][at] = there + (getattr(new, name) - there) * share
        held["normals"][at] = _of_unit_length(held["normals"][at] * (1 - share) + new.normals * share)
        held["weight"][at] = total
        counts = held["count"][at] + new.count
        confidence = held["confidence"][at]
        held["confidence"][at] = confidence + (new.confidence - confidence) * (new.count / counts)
        held["count"][at] = counts
        held["views"][at] = np.maximum(held["views"][at], new.views)

    def _append(self, new: Samples) -> None:
        _write(self._values, self._count, new)
        self._count += len(new)


def _fields(samples: Samples) -> dict[str, NDArray[Any]]:
    return {name: getattr(samples, name) for name in Samples.__dataclass_fields__}


def _room_for(count: int, like: Samples) -> dict[str, NDArray[Any]]:
    """Fields of so many points, not filled."""
    return {name: np.empty((count, *values.shape[1:]), values.dtype) for name, values in _fields(like).items()}


def _write(fields: dict[str, NDArray[Any]], start: int, new: Samples) -> None:
    """Write ``new`` from number ``start`` on, into fields that are replaced by larger ones where they are too short."""
    end = start + len(new)
    for name, added in _fields(new).items():
        values = fields[name]
        if end > len(values):
            # Room for more than is needed, so that it is not copied each time; one field after the other, so that
            # little is held twice.
            larger = np.empty((max(end, int(_ROOM * len(values))), *values.shape[1:]), values.dtype)
            larger[:start] = values[:start]
            values = fields[name] = larger
        values[start:end] = added
