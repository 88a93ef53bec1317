"""A point in space from its pixels in several views: linear start, then least squares on the pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

#: Steps of the fit at most. Source: numerics.
_ITERATIONS = 10
#: A step smaller than this share of the depth is the last. Source: numerics.
_LAST_STEP = 1e-10
#: Condition of the normal equations from which there is no solution, and depths that stand for none. Source: numerics.
_WORST_CONDITION, _LEAST_DEPTH = 1e14, 1e-12


@dataclass(frozen=True, kw_only=True)
class TriangulatedPoint:
    """A point seen in two or more views.

    Attributes
    ----------
    xyz: (3,) float64, scene units.
    covariance: (3, 3) float64, scene units squared, for pixel errors of one pixel standard deviation.
    errors_px: (V,) float64, distance of each pixel from the projected point.
    """

    xyz: NDArray[np.float64]
    covariance: NDArray[np.float64]
    errors_px: NDArray[np.float64]

    @property
    def max_error_px(self) -> float:
        """The largest of the pixel errors."""
        return float(self.errors_px.max())


def triangulate(projections: Sequence[NDArray[np.float64]], pixels: NDArray[np.float64]) -> TriangulatedPoint | None:
    """Triangulate one point (Hartley and Zisserman, *Multiple View Geometry*, 12.2, then Gauss-Newton).

    Parameters
    ----------
    projections: V matrices K [R | t], (3, 4) float64.
    pixels: (V, 2) float64.

    Returns
    -------
    None where the rays are parallel or meet behind a camera.
    """
    matrices = np.stack(list(projections))
    rows = np.concatenate(
        [pixels[:, :1] * matrices[:, 2] - matrices[:, 0], pixels[:, 1:] * matrices[:, 2] - matrices[:, 1]]
    )
    rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    solution = np.linalg.svd(rows)[2][3]
    if abs(solution[3]) < _LEAST_DEPTH:
        return None
    xyz = solution[:3] / solution[3]
    for _ in range(_ITERATIONS):
        residual, jacobian, depth = _linearize(matrices, pixels, xyz)
        normal = jacobian.T @ jacobian
        if (depth <= 0).any() or np.linalg.cond(normal) > _WORST_CONDITION:
            return None
        step = np.linalg.solve(normal, -jacobian.T @ residual)
        xyz = xyz + step
        if float(np.linalg.norm(step)) < _LAST_STEP * float(depth.min()):
            break
    residual, jacobian, depth = _linearize(matrices, pixels, xyz)
    normal = jacobian.T @ jacobian
    if (depth <= 0).any() or not np.isfinite(xyz).all() or np.linalg.cond(normal) > _WORST_CONDITION:
        return None
    errors_px = np.linalg.norm(residual.reshape(-1, 2), axis=1)
    return TriangulatedPoint(
        xyz=xyz, covariance=np.asarray(np.linalg.inv(normal), dtype=np.float64), errors_px=errors_px
    )


def _linearize(
    matrices: NDArray[np.float64], pixels: NDArray[np.float64], xyz: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Residuals (2V,), their derivatives by the point (2V, 3) and the depths (V,)."""
    projected = matrices[:, :, :3] @ xyz + matrices[:, :, 3]
    depth = projected[:, 2]
    safe = np.where(np.abs(depth) < _LEAST_DEPTH, _LEAST_DEPTH, depth)
    image = projected[:, :2] / safe[:, None]
    jacobian = (matrices[:, :2, :3] - image[:, :, None] * matrices[:, 2:, :3]) / safe[:, None, None]
    return (image - pixels).reshape(-1), jacobian.reshape(-1, 3), depth
