"""A raster of heights: the smoothest surface through the heights of cells, and its height anywhere.

The surface is P. Eilers' asymmetric smoothing in two dimensions: penalised least squares, in which what stands above
the surface hardly pulls.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
#: SuperLU for symmetric matrices. Source: numerics.
_SYMMETRIC: Mapping[str, Any] = {"diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
#: Points at once; what is computed on the way stays in the processor's cache. Source: numerics.
BLOCK = 16_384
#: Stiffness of the surface, step by step: from the opened heights, below undergrowth, to the relief; and of the second,
#: finer surface. Source: shapes of relief and undergrowth (``python -m tests.bench.relief``).
_STIFFNESS, _FINE_STIFFNESS = (3.0, 3.0, 1.0, 1.0, 0.3, 0.3), (1.0, 1.0, 1.0)
#: Holds the surface where no cell has a height. Source: numerics.
_RIDGE = 1e-4
#: What stands so far above the surface hardly pulls: metres at first, what becomes of them in a step, and at last.
#: Source: as the stiffness.
ABOVE_M = (0.2, 0.8, 0.06)
#: The same for what lies below it. Source: not recorded.
BELOW_M = (1.2, 0.7, 0.15)
#: And what is so far from the finer surface, either way. Source: not recorded.
OFF_M = 0.05


def height_on(raster: Floats, origin: Floats, cell_m: float, x: Floats, y: Floats) -> Floats:
    """Height (N,) of a raster (H, W) at positions x and y (N,) by bilinear interpolation; its border continues.

    Cell centres are at ``origin + cell_m * (column, row)``. It is ``scipy.ndimage.map_coordinates`` of order 1 and
    mode "nearest", in a quarter of the time.
    """
    raster = np.pad(raster, [(0, int(size == 1)) for size in raster.shape], mode="edge")
    height, width = raster.shape
    corner = raster[:-1, :-1].ravel()
    right = (raster[:-1, 1:] - raster[:-1, :-1]).ravel()
    up = (raster[1:, :-1] - raster[:-1, :-1]).ravel()
    twist = (raster[1:, 1:] - raster[1:, :-1]).ravel() - right
    result = np.empty(len(x))
    for first in range(0, len(x), BLOCK):
        part = slice(first, first + BLOCK)
        column, across = _cells(x[part], origin[0], cell_m, width)
        row, along = _cells(y[part], origin[1], cell_m, height)
        row *= width - 1
        row += column
        z = twist.take(row)
        z *= across
        z += up.take(row)
        z *= along
        across *= right.take(row)
        z += across
        np.add(z, corner.take(row), out=result[part])
    return result


def _cells(values: Floats, origin: float, cell_m: float, size: int) -> tuple[Ints, Floats]:
    """Which of ``size`` - 1 gaps between cell centres each of the values (N,) lies in, and how far along it, 0 to 1."""
    position = values - origin
    position /= cell_m
    np.clip(position, 0.0, size - 1.0, out=position)
    number = np.minimum(position.astype(np.int64), size - 2)
    position -= number
    return number, position


def smooth_surface(
    cell: Ints,
    height: Floats,
    shape: tuple[int, int],
    smoothness: float,
    *,
    symmetric: bool = False,
    start: Floats | None = None,
    support: Floats | None = None,
    firm: NDArray[np.bool_] | None = None,
    held_to: tuple[Floats, float] | None = None,
) -> Floats:
    """Penalised least squares surface (H, W) through the heights (C,) of cells; asymmetric unless ``symmetric``.

    ``cell`` (C,) are numbers of cells by row, ``smoothness`` the weight of squared second differences against a cell.
    ``start`` (H, W) is a first guess, 0 without one; an asymmetric surface leaves a wrong one only slowly. ``support``
    (C,), 0 to 1, is how much each cell counts, ``firm`` (C,) are known to be ground and pull wherever they lie.
    ``held_to`` is a surface (H, W) and a weight, against one cell's, that
    this one keeps to it with: where nothing was seen it returns there instead of going on as steep as it began.
    """
    about, ridge = (np.zeros(shape), _RIDGE) if held_to is None else held_to
    height = height - about.ravel()[cell]
    equations = _Equations(shape, smoothness, ridge)
    surface = np.zeros(shape[0] * shape[1]) if start is None else (start - about).ravel()
    for step, stiff in enumerate(_FINE_STIFFNESS if symmetric else _STIFFNESS):
        residual = height - surface[cell]
        if symmetric:
            weight = 1.0 / (1.0 + (residual / OFF_M) ** 2) if step else np.ones(len(cell))
        else:
            limit_above, limit_below = (max(start * factor**step, last) for start, factor, last in (ABOVE_M, BELOW_M))
            weight = np.where(residual > 0, np.exp(-((residual / limit_above) ** 2)), 1.0)
            weight = weight if firm is None else np.where(firm, 1.0, weight)
            weight = np.where(residual < -limit_below, (limit_below / np.maximum(-residual, 1e-9)) ** 2, weight)
        weight = weight if support is None else weight * support
        surface = equations.solve(stiff, cell, weight, weight * height)
    return np.asarray(surface.reshape(shape) + about)


class _Equations:
    """(diag(w) + stiffness * penalty) x = b on a raster, for many w and b: ordered once, then only factorised.

    Not by LAPACK's banded solver, which is faster alone but wakes BLAS's threads (:mod:`fsinfer.trees.points.sums`).
    """

    def __init__(self, shape: tuple[int, int], smoothness: float, ridge: float) -> None:
        rows, columns = (_second_difference(n) for n in shape)
        penalty = sparse.kron(rows.T @ rows, sparse.eye(shape[1]))
        penalty = penalty + sparse.kron(sparse.eye(shape[0]), columns.T @ columns)
        penalty = (smoothness * penalty + ridge * sparse.eye(shape[0] * shape[1])).tocsc()
        first = splu(penalty + sparse.eye(penalty.shape[0], format="csc"), permc_spec="MMD_AT_PLUS_A", **_SYMMETRIC)
        self._order = np.argsort(first.perm_c)
        self._place = first.perm_c.astype(np.int64)
        self._matrix = penalty[self._order][:, self._order].tocsc()
        self._matrix.sort_indices()
        self._penalty = self._matrix.data.copy()
        column = np.repeat(np.arange(penalty.shape[0]), np.diff(self._matrix.indptr))
        self._diagonal = np.flatnonzero(self._matrix.indices == column)

    def solve(self, stiffness: float, cell: Ints, weight: Floats, target: Floats) -> Floats:
        """Surface (N,) for weights and targets (C,) at cells (C,), 0 elsewhere."""
        at = self._place[cell]
        self._matrix.data = stiffness * self._penalty
        self._matrix.data[self._diagonal[at]] += weight
        right = np.zeros(len(self._order))
        right[at] = target
        solution = splu(self._matrix, permc_spec="NATURAL", **_SYMMETRIC).solve(right)
        return np.asarray(solution[self._place])


def _second_difference(n: int) -> sparse.spmatrix:
    if n < 3:
        return sparse.csr_matrix((1, n))
    return sparse.diags([np.ones(n - 2), -2.0 * np.ones(n - 2), np.ones(n - 2)], [0, 1, 2], shape=(n - 2, n)).tocsr()
