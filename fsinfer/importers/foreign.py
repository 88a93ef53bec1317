"""What every format is read into: photographs with their lenses and poses, and tie points where there are some."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import SceneError
from fsinfer.importers.lens import Lens
from fsinfer.poses.sparse import SparseModel

Floats = NDArray[np.float64]

#: A rotation in a file may be off by this: it is written with six digits or so. Source: numerics.
_ROTATION_TOLERANCE = 2e-3
#: Coordinates beyond this are taken relative to the middle of the cameras. Source: numerics; single precision keeps a
#: millimetre up to here.
FAR_AWAY = 10_000.0
#: Turns the camera axes x right, y up, z backward (OpenGL, ARKit) to x right, y down, z forward. Source: format.
FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
#: From a world whose y points up (ARKit) to one whose z does. Source: format.
Z_UP_FROM_Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])


@dataclass(frozen=True, kw_only=True)
class ForeignPhoto:
    """A registered photograph.

    Attributes
    ----------
    name: of its view in the scene; no two photographs share it.
    path: its file.
    lens: as the program calibrated it; the file may be a reduced copy.
    cam_from_world: (4, 4) float64; x right, y down, z forward.
    """

    name: str
    path: Path
    lens: Lens
    cam_from_world: Floats


@dataclass(frozen=True, kw_only=True)
class ForeignScene:
    """A scene that another program registered.

    Attributes
    ----------
    program: what the format is called.
    files: that it was read from.
    photos: those with a pose and a file.
    sparse: tie points, their observations by the names of the photos; None where the format has none.
    metric: the unit is the metre.
    z_up: the world's z points up.
    origin: (3,) what was subtracted from the world's coordinates; zeros where nothing was.
    left_out: names of photographs without a pose or without a file.
    remarks: what a user has to know of how it was read.
    """

    program: str
    files: tuple[Path, ...]
    photos: tuple[ForeignPhoto, ...]
    sparse: SparseModel | None = None
    metric: bool = False
    z_up: bool = False
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    left_out: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()


def centers_of(photos: Sequence[ForeignPhoto]) -> Floats:
    """(N, 3) camera centres."""
    poses = np.array([photo.cam_from_world for photo in photos])
    return np.asarray(-np.einsum("nji,nj->ni", poses[:, :3, :3], poses[:, :3, 3]))


def moved(scene: ForeignScene, new_from_old: Floats) -> ForeignScene:
    """The scene after a rigid motion (4, 4) of its world."""
    old_from_new = np.linalg.inv(new_from_old)
    photos = tuple(replace(photo, cam_from_world=photo.cam_from_world @ old_from_new) for photo in scene.photos)
    sparse = scene.sparse
    if sparse is not None:
        sparse = replace(sparse, points=sparse.points @ new_from_old[:3, :3].T + new_from_old[:3, 3])
    return replace(scene, photos=photos, sparse=sparse)


def near_origin(scene: ForeignScene) -> ForeignScene:
    """The scene with small coordinates: those of a national grid are taken relative to the middle of the cameras."""
    middle = np.round(np.median(centers_of(scene.photos), axis=0))
    if np.abs(middle).max() < FAR_AWAY:
        return scene
    shift = np.eye(4)
    shift[:3, 3] = -middle
    return replace(moved(scene, shift), origin=(float(middle[0]), float(middle[1]), float(middle[2])))


def pose_from_center(world_from_cam: Floats, where: str) -> Floats:
    """``cam_from_world`` (4, 4) from camera to world (4, 4), whose rotation is made exact.

    Raises
    ------
    SceneError
        The matrix is no rigid motion; ``where`` names it.
    """
    rotation = exact_rotation(world_from_cam[:3, :3], where)
    pose = np.eye(4)
    pose[:3, :3] = rotation.T
    pose[:3, 3] = -rotation.T @ world_from_cam[:3, 3]
    if not np.isfinite(pose).all():
        raise _no_pose(where)
    return pose


def exact_rotation(matrix: Floats, where: str) -> Floats:
    """The rotation (3, 3) next to a matrix that was written with few digits; :class:`SceneError` where it is none."""
    if not np.isfinite(matrix).all():
        raise _no_pose(where)
    left, sizes, right = np.linalg.svd(matrix)
    if np.abs(sizes - 1).max() > _ROTATION_TOLERANCE or np.linalg.det(left @ right) < 0:
        raise _no_pose(where)
    return np.asarray(left @ right)


def rotation_of_quaternion(w: float, x: float, y: float, z: float, where: str) -> Floats:
    """Rotation (3, 3) of a quaternion of any length; :class:`SceneError` for one without a direction."""
    quaternion = np.array([w, x, y, z])
    length = float(np.linalg.norm(quaternion))
    if not np.isfinite(quaternion).all() or length < _ROTATION_TOLERANCE:
        raise _no_pose(where)
    w, x, y, z = (float(part) for part in quaternion / length)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def _no_pose(where: str) -> SceneError:
    return SceneError(f"{where} holds no rotation and place of a camera; export the cameras again")
