"""How well each camera is known beside its neighbours: from the inverse of the last adjustment's reduced system."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.linalg import cho_solve

from fsinfer.errors import SceneError
from fsinfer.io.json_text import read_json
from fsinfer.poses.adjustment.fit import Weighting, columns_of, normal_equations
from fsinfer.poses.adjustment.problem import Group, Unknowns
from fsinfer.poses.adjustment.projection import Floats
from fsinfer.poses.adjustment.reduced_system import Structure, factored, reduce_points

#: Photos that share the most points with one, beside which its place is told. Source: MVSNet's ten source views.
_NEIGHBOURS = 10
#: Damping of the reduced system, so that points seen by two photos along one line can be taken out. Source: numerics.
_DAMPING = 1e-9


@dataclass(frozen=True, kw_only=True)
class CameraPrecision:
    """Standard deviations of a camera relative to the photos that share the most points with it.

    Attributes
    ----------
    center_std: of its centre on one axis, model units. direction_std_rad: of its rotation about one axis, radians.
    """

    center_std: float
    direction_std_rad: float


def camera_precisions(
    structure: Structure, at: Unknowns, groups: Sequence[Group], weighting: Weighting
) -> list[CameraPrecision]:
    """One for each photo of an adjustment that has converged.

    The covariance of all cameras is the inverse of the reduced system (Triggs et al. 2000, section 9), scaled by the
    residuals' variance; what no observation fixes (place, direction and scale of the whole) is taken out by inner
    constraints over each photo and its neighbours (Baarda's S-transformation). Wrong matches count by their weights.
    The errors of observations are taken as independent. On a rendered phone's ring of 60 photos the cameras were 1.3 mm
    off beside their neighbours, where 0.8 mm an axis (1.4 mm in space) were told.
    """
    matrix = reduce_points(structure, normal_equations(structure, at, groups, weighting), _DAMPING).matrix
    photos, size = len(at.rotations), 6 + len(columns_of(groups))
    gauge = np.zeros((len(matrix), 7))
    # A pose's shift is that of the point in the camera; its centre moves by -R^T of it.
    moves = _gauge(at)
    for photo, rotation in enumerate(at.rotations):
        gauge[photo * size : photo * size + 3] = moves[photo, :3]
        gauge[photo * size + 3 : photo * size + 6] = -rotation @ moves[photo, 3:]
    gauge = np.linalg.qr(gauge)[0]
    matrix += np.diag(matrix).mean() * gauge @ gauge.T
    factor = factored(matrix)
    poses = (np.arange(photos)[:, None] * size + np.arange(6)).ravel()
    unit = np.zeros((len(matrix), len(poses)), order="F")
    unit[poses, np.arange(len(poses))] = 1
    inverse = cho_solve(factor, unit, overwrite_b=True, check_finite=False)
    del matrix, factor, unit
    covariance = inverse[poses]
    del inverse
    turned = np.zeros((photos, 6, 6))
    turned[:, :3, :3] = np.eye(3)
    turned[:, 3:, 3:] = -at.rotations.transpose(0, 2, 1)
    covariance = np.einsum("nij,njmk,mlk->niml", turned, covariance.reshape(photos, 6, photos, 6), turned)
    covariance *= _variance(structure, at, groups, weighting)
    found = []
    for photo, near in enumerate(_neighbours(structure, photos)):
        block = covariance[np.ix_(near, range(6), near, range(6))].reshape(6 * len(near), -1)
        spread = float(np.sqrt(((at.centers[near] - at.centers[near].mean(axis=0)) ** 2).sum(1).mean()))
        weights = np.tile([1.0] * 3 + [1 / max(spread, np.finfo(float).tiny) ** 2] * 3, len(near))
        local = moves[near].reshape(-1, 7)
        fixed = np.linalg.pinv(local * np.sqrt(weights)[:, None]) * np.sqrt(weights)
        free = np.eye(len(block)) - local @ fixed
        own = 6 * near.index(photo)
        variance = np.einsum("ij,jk,ik->i", free[own : own + 6], block, free[own : own + 6])
        found.append(
            CameraPrecision(
                center_std=float(np.sqrt(variance[3:].mean())), direction_std_rad=float(np.sqrt(variance[:3].mean()))
            )
        )
    return found


def _gauge(at: Unknowns) -> Floats:
    """(N, 6, 7): each camera's turn and its centre's way, where the whole is shifted, turned and grows."""
    moves = np.zeros((len(at.rotations), 6, 7))
    centers = at.centers
    moves[:, 3:, :3] = np.eye(3)
    moves[:, :3, 3:6] = -at.rotations
    # omega x C, as a matrix on omega.
    moves[:, 3:, 3:6] = np.cross(np.eye(3)[None], centers[:, None, :]).transpose(0, 2, 1)
    moves[:, 3:, 6] = centers - centers.mean(axis=0)
    return moves


def _variance(structure: Structure, at: Unknowns, groups: Sequence[Group], weighting: Weighting) -> float:
    """Of an observation of full weight, from the weighted residuals and the number of unknowns."""
    squared = (at.residuals(structure.seen) ** 2).sum(1)
    weights = 1 / (1 + squared / weighting.loss_px**2)
    unknowns = len(at.rotations) * (6 + len(columns_of(groups))) + 3 * len(at.points)
    return float((weights * squared).sum() / max(2 * weights.sum() - unknowns, 1.0))


def _neighbours(structure: Structure, photos: int) -> list[list[int]]:
    """For each photo itself and those that share the most points with it, in order of their numbers."""
    shared = np.zeros((photos, photos), dtype=np.int64)
    for one, others, _, _, ends in structure.pairs_by_photo():
        for other, count in zip(others, np.diff(ends, prepend=0).tolist(), strict=True):
            if one != other:
                shared[one, other] = shared[other, one] = count
    near = []
    for photo in range(photos):
        best = np.argsort(-shared[photo], kind="stable")[:_NEIGHBOURS]
        near.append(sorted({photo, *(int(other) for other in best if shared[photo, other] > 0)}))
    return near


def read_camera_precisions(scene: Path | str) -> dict[str, CameraPrecision]:
    """By the name of the view, from the ``poses.json`` of a scene; empty for a scene of another origin.

    Raises
    ------
    SceneError
        The file is damaged.
    """
    path = Path(scene) / "poses.json"
    if not path.is_file():
        return {}
    try:
        entries = read_json(path).get("camera_std", {})
        return {
            name: CameraPrecision(center_std=float(entry["center"]), direction_std_rad=float(entry["direction_rad"]))
            for name, entry in entries.items()
        }
    except (OSError, ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
        msg = f"{path} is damaged ({error}); make the scene again with: fsinfer poses"
        raise SceneError(msg) from error
