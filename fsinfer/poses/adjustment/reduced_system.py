"""The normal equations of an adjustment, points eliminated: the Schur complement of photos and lenses.

Triggs, McLauchlan, Hartley and Fitzgibbon 2000, "Bundle adjustment - a modern synthesis", section 6. The blocks of two
photos are products of all rows of points that both see, so that BLAS does the work.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_matrix

from fsinfer.poses.adjustment.problem import Ints, Observations
from fsinfer.poses.adjustment.projection import Floats

#: Least share of the largest diagonal entry of a point that is added, so that its block can be inverted. Source:
#: numerics.
_LEAST = 1e-12


class Structure:
    """Who sees what: the parts of the equations that do not change from step to step."""

    def __init__(self, seen: Observations, points: int) -> None:
        photos = len(seen.camera)
        count = len(seen.photo)
        self.seen = seen
        self.points = points
        self.ends = np.searchsorted(seen.photo, np.arange(photos + 1))
        self.sum_by_point = csr_matrix((np.ones(count), (seen.point, np.arange(count))), shape=(points, count))
        first, second = _pairs(seen.point)
        key = seen.photo[first] * photos + seen.photo[second]
        order = np.argsort(key, kind="stable")
        self.first, self.second = first[order], second[order]
        self.pair_keys, self.pair_starts = np.unique(key[order], return_index=True)

    def photos(self) -> Iterator[tuple[int, slice]]:
        """Each photo and the rows of its observations."""
        for photo in range(len(self.ends) - 1):
            yield photo, slice(int(self.ends[photo]), int(self.ends[photo + 1]))

    def pairs_by_photo(self) -> Iterator[tuple[int, list[int], Ints, Ints, list[int]]]:
        """A photo, the others that share points with it, and the rows of these points in it and in the others.

        The rows are those of the others one after the other; the list at the end says where those of each end.
        """
        photos = len(self.ends) - 1
        ends = np.append(self.pair_starts, len(self.first))
        of_photo = np.searchsorted(self.pair_keys, np.arange(photos + 1) * photos)
        for photo, (first, last) in enumerate(pairwise(of_photo.tolist())):
            rows = slice(int(ends[first]), int(ends[last]))
            others = (self.pair_keys[first:last] - photo * photos).tolist()
            of_each = (ends[first + 1 : last + 1] - ends[first]).tolist()
            yield photo, others, self.first[rows], self.second[rows], of_each


def _pairs(point: Ints) -> tuple[Ints, Ints]:
    """All pairs of rows, the smaller first, that belong to one point."""
    order = np.argsort(point, kind="stable")
    starts = np.flatnonzero(np.r_[True, np.diff(point[order]) > 0])
    lengths = np.diff(np.append(starts, len(point)))
    first, second = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    for length in np.unique(lengths[lengths > 1]):
        rows = order[starts[lengths == length][:, None] + np.arange(length)]
        left, right = np.triu_indices(length, 1)
        first.append(rows[:, left].ravel())
        second.append(rows[:, right].ravel())
    return np.concatenate(first), np.concatenate(second)


@dataclass(frozen=True, kw_only=True)
class Rows:
    """Weighted rows of the Jacobian, and the residuals.

    Attributes
    ----------
    residuals: (n, 2). by_photo: (n, 2, D). by_point: (n, 2, 3). by_lens: (n, 2, M), of all lenses together.
    """

    residuals: Floats
    by_photo: Floats
    by_point: Floats
    by_lens: Floats


@dataclass(frozen=True, kw_only=True)
class Blocks:
    """Normal equations before the points are eliminated, undamped.

    Attributes
    ----------
    cameras: (q, q) with q = N D + M, photos first, lenses last. cameras_right: (q,) J^T r.
    crossed: (n, 3, D) of each observation, crossed_lens: (P, 3, M). points: (P, 3, 3). points_right: (P, 3).
    """

    cameras: Floats
    cameras_right: Floats
    crossed: Floats
    crossed_lens: Floats
    points: Floats
    points_right: Floats


def blocks_of(structure: Structure, rows: Rows) -> Blocks:
    """Sum J^T J and J^T r."""
    size = rows.by_photo.shape[2]
    lenses = rows.by_lens.shape[2]
    photos = len(structure.ends) - 1
    border = slice(photos * size, photos * size + lenses)
    cameras = np.zeros((border.stop, border.stop))
    right = np.zeros(border.stop)
    for photo, part in structure.photos():
        at = slice(photo * size, (photo + 1) * size)
        jacobian = rows.by_photo[part].reshape(-1, size)
        lens = _stacked(rows.by_lens[part])
        cameras[at, at] = jacobian.T @ jacobian
        cameras[at, border] = jacobian.T @ lens
        cameras[border, border] += lens.T @ lens
        residuals = rows.residuals[part].ravel()
        right[at] = jacobian.T @ residuals
        right[border] += lens.T @ residuals
    sums = structure.sum_by_point

    def by_point_times(values: Floats) -> Floats:
        # Products of matrices as small as these take four times as long.
        return np.asarray(np.einsum("nij,nik->njk", rows.by_point, values))

    def summed(values: Floats) -> Floats:
        return np.asarray(sums @ values.reshape(len(values), -1)).reshape(structure.points, *values.shape[1:])

    return Blocks(
        cameras=cameras,
        cameras_right=right,
        crossed=by_point_times(rows.by_photo),
        crossed_lens=summed(by_point_times(rows.by_lens)),
        points=summed(by_point_times(rows.by_point)),
        points_right=summed(by_point_times(rows.residuals[:, :, None])[:, :, 0]),
    )


def _stacked(blocks: Floats) -> Floats:
    """Blocks (n, r, M) one below the other, (n r, M). M is 0 where no lens may change: of several with few photos."""
    count, height, width = blocks.shape
    return blocks.reshape(count * height, width)


@dataclass(frozen=True, kw_only=True)
class Reduced:
    """The reduced system, upper triangle, and what the way back to the points needs.

    ``matrix`` (q, q), ``right`` (q,); ``inverse`` (P, 3, 3) of the points' Cholesky factors; ``half`` (n, 3, D) and
    ``half_lens`` (P, 3, M): ``inverse`` times the crossed blocks; ``half_right`` (P, 3).
    """

    matrix: Floats
    right: Floats
    inverse: Floats
    half: Floats
    half_lens: Floats
    half_right: Floats


def reduce_points(structure: Structure, blocks: Blocks, damping: float) -> Reduced:
    """Eliminate the points; each diagonal entry is raised by its ``damping``-fold first (Levenberg-Marquardt)."""
    diagonal = np.einsum("pii->pi", blocks.points)
    lifted = blocks.points.copy()
    most = diagonal.max(axis=1, keepdims=True)
    np.einsum("pii->pi", lifted)[:] += damping * diagonal + _LEAST * most
    inverse = np.linalg.inv(np.linalg.cholesky(lifted))
    half = inverse[structure.seen.point] @ blocks.crossed
    half_lens = inverse @ blocks.crossed_lens
    half_right = (inverse @ blocks.points_right[:, :, None])[:, :, 0]
    matrix = blocks.cameras.copy()
    matrix[np.diag_indices_from(matrix)] *= 1 + damping
    right = blocks.cameras_right.copy()
    size, lenses = half.shape[2], half_lens.shape[2]
    border = slice(len(right) - lenses, len(right))
    for photo, part in structure.photos():
        at = slice(photo * size, (photo + 1) * size)
        own = half[part].reshape(-1, size)
        point = structure.seen.point[part]
        matrix[at, at] -= own.T @ own
        matrix[at, border] -= own.T @ _stacked(half_lens[point])
        right[at] -= own.T @ half_right[point].ravel()
    flat = _stacked(half_lens)
    matrix[border, border] -= flat.T @ flat
    right[border] -= flat.T @ half_right.ravel()
    for one, others, rows, columns, ends in structure.pairs_by_photo():
        top = slice(one * size, (one + 1) * size)
        # Taken out of their places for all pairs of a photo at once: for each pair it took as long as the products.
        of_one, of_others = half[rows].reshape(-1, size), half[columns].reshape(-1, size)
        start = 0
        for other, end in zip(others, ends, strict=True):
            product = of_one[3 * start : 3 * end].T @ of_others[3 * start : 3 * end]
            # A point may be seen twice in one photo.
            matrix[top, other * size : (other + 1) * size] -= product + product.T if one == other else product
            start = end
    return Reduced(matrix=matrix, right=right, inverse=inverse, half=half, half_lens=half_lens, half_right=half_right)


def factored(upper: Floats) -> tuple[Floats, bool]:
    """Cholesky's factor for :func:`scipy.linalg.cho_solve`, in the place of a matrix (q, q) of which the upper triangle
    counts.

    Of 300 photos it takes 160 MB. LAPACK works in place on columns, which are the rows of what it is given here.

    Raises
    ------
    numpy.linalg.LinAlgError
        The matrix is not positive definite.
    """
    factor: tuple[Floats, bool] = cho_factor(upper.T, lower=True, overwrite_a=True, check_finite=False)
    return factor


def solve(structure: Structure, reduced: Reduced) -> tuple[Floats, Floats]:
    """The step: (q,) of photos and lenses, (P, 3) of the points; ``reduced.matrix`` is overwritten.

    Raises
    ------
    numpy.linalg.LinAlgError
        The damped matrix is not positive definite.
    """
    factor = factored(reduced.matrix)
    cameras: Floats = -cho_solve(factor, reduced.right, check_finite=False)
    size, lenses = reduced.half.shape[2], reduced.half_lens.shape[2]
    photos = cameras[: len(cameras) - lenses].reshape(-1, size)
    moved = (reduced.half @ photos[structure.seen.photo][:, :, None])[:, :, 0]
    right = -reduced.half_right - structure.sum_by_point @ moved
    right -= reduced.half_lens @ cameras[len(cameras) - lenses :]
    points: NDArray[np.float64] = (reduced.inverse.transpose(0, 2, 1) @ right[:, :, None])[:, :, 0]
    return cameras, points
