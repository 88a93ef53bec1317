"""Similarities of space: rotation, one scale and a shift, as a (4, 4) matrix ``target_from_source``."""

from __future__ import annotations

from functools import reduce

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
#: Points in a line fix no turn: their second extent is less than this share of the first. Source: numerics.
_LEAST_SPREAD = 1e-9


def scale_of(similarity: Floats) -> float:
    """Units of the target frame in one unit of the source frame: the cube root of the volume that a unit cube gets."""
    return float(np.cbrt(np.linalg.det(similarity[:3, :3])))


def rotation_of(similarity: Floats) -> Floats:
    """Rotation (3, 3) of a (4, 4) similarity, without its scale."""
    return np.asarray(similarity[:3, :3] / np.cbrt(np.linalg.det(similarity[:3, :3])))


def apply(similarity: Floats, points: Floats) -> Floats:
    """Points (..., 3) of the source frame in the target frame."""
    return np.asarray(points @ similarity[:3, :3].T + similarity[:3, 3])


def scaling(factor: float) -> Floats:
    """Similarity (4, 4) that multiplies coordinates by ``factor`` and does nothing else."""
    return np.diag([factor, factor, factor, 1.0])


def compose(first: Floats, *others: Floats) -> Floats:
    """Product (4, 4) of similarities, which applies the last one first, as matrices do.

    ``compose(plot_from_world, world_from_scene)`` is ``plot_from_scene``.
    """
    return reduce(np.matmul, others, first)


def fit_similarity(source: Floats, target: Floats) -> Floats | None:
    """Least-squares similarity (4, 4) from points (N, 3) to others (Umeyama 1991); None where they do not fix one."""
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    left, sizes, right = np.linalg.svd(b.T @ a)
    variance = float((a**2).sum())
    if len(source) < 3 or variance <= 0 or sizes[1] <= _LEAST_SPREAD * sizes[0]:
        return None
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    scale = float((sizes * signs).sum() / variance)
    if not scale > 0:
        return None
    matrix = np.eye(4)
    matrix[:3, :3] = scale * (left * signs) @ right
    matrix[:3, 3] = target.mean(axis=0) - matrix[:3, :3] @ source.mean(axis=0)
    return matrix
