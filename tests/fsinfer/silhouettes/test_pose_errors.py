"""The cameras' errors reach the radius of a stem: more from afar, less the more photos see it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fsinfer.poses.adjustment.precision import CameraPrecision
from fsinfer.scene import Camera, Scene, View
from fsinfer.silhouettes.pose_errors import radius_error

INTRINSIC = np.array([[1000.0, 0, 640], [0, 1000.0, 360], [0, 0, 1]])
STEM = np.array([0.0, 0.0, 5.0])
#: The scene is in units of half a metre.
METRES = np.diag([0.5, 0.5, 0.5, 1.0])


def scene_of(count: int, distance: float) -> Scene:
    views = []
    for number in range(count):
        pose = np.eye(4)
        pose[:3, 3] = [0.02 * number, 0.0, 2 * distance - 2 * STEM[2]]
        camera = Camera(intrinsic=INTRINSIC, cam_from_world=pose, depth_min=1.0, depth_max=60.0)
        views.append(View(name=f"{number}", image_path=Path(f"{number}.jpg"), camera=camera, sources=()))
    return Scene(folder=Path(), views=tuple(views))


def std_of(count: int, distance: float, center: float = 0.004, direction: float = 0.001) -> float:
    scene = scene_of(count, distance)
    known = {view.name: CameraPrecision(center_std=center, direction_std_rad=direction) for view in scene.views}
    found = radius_error(scene, METRES, known)
    assert found is not None
    return found(STEM)


def test_one_photo_by_hand() -> None:
    assert std_of(1, 4.0) == pytest.approx(np.hypot(0.5 * 0.004, 4.0 * 0.001))


def test_many_photos_err_by_the_root_of_their_number_less() -> None:
    assert std_of(16, 4.0, direction=0.0) == pytest.approx(std_of(1, 4.0, direction=0.0) / 4)


def test_what_is_farther_moves_more_until_it_is_not_counted() -> None:
    assert std_of(4, 8.0) > std_of(4, 3.0)
    assert std_of(4, 20.0) == 0.0


def test_photos_that_do_not_show_the_stem_do_not_count() -> None:
    scene = scene_of(4, 4.0)
    known = {view.name: CameraPrecision(center_std=0.004, direction_std_rad=0.001) for view in scene.views}
    found = radius_error(scene, METRES, known)
    assert found is not None
    assert found(STEM + np.array([9.0, 0.0, 0.0])) == 0.0
    assert found(STEM - np.array([0.0, 0.0, 9.0])) == 0.0


def test_of_cameras_from_elsewhere_nothing_is_known() -> None:
    assert radius_error(scene_of(3, 4.0), METRES, {}) is None
