"""What a fused point says of its own error along the line of sight."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fsinfer.fusion.depth_error import MATCH_PX, depth_std, pixel_size, std_at_unit_depth
from fsinfer.fusion.fuse import fuse
from fsinfer.io.cloud import DEPTH_STD, PIXEL_SIZE
from fsinfer.io.images import write_image
from fsinfer.placement.place import transform_cloud
from fsinfer.scene import Camera, Scene, View, read_view_image
from tests.fsinfer.fusion.test_fuse import STEP, make_scene

FOCAL_PX = 800.0


def cameras(*places: tuple[float, float, float], sources: tuple[tuple[int, ...], ...]) -> Scene:
    """Cameras that all look along z."""
    views = []
    for number, (place, own) in enumerate(zip(places, sources, strict=True)):
        pose = np.eye(4)
        pose[:3, 3] = -np.array(place)
        intrinsic = np.diag([FOCAL_PX, FOCAL_PX, 1.0])
        camera = Camera(intrinsic=intrinsic, cam_from_world=pose, depth_min=1.0, depth_max=9.0)
        views.append(View(name=f"{number}", image_path=Path(f"{number}.jpg"), camera=camera, sources=own))
    return Scene(folder=Path(), views=tuple(views))


def test_the_normal_case_of_stereo() -> None:
    scene = cameras((0, 0, 0), (0.5, 0, 0), sources=((1,), (0,)))
    at_unit = std_at_unit_depth(scene, [0, 1], [FOCAL_PX, FOCAL_PX])
    assert at_unit == pytest.approx(MATCH_PX / (FOCAL_PX * 0.5))
    depth = np.array([1.0, 4.0, 8.0])
    assert depth_std(depth**-4.0, at_unit) == pytest.approx(at_unit * depth**2, rel=0.02)
    # Nine views that agree are three times as sure as one.
    assert depth_std(9.0 * depth**-4.0, at_unit) == pytest.approx(at_unit * depth**2 / 3.0, rel=0.02)


def test_a_step_along_the_line_of_sight_is_no_base() -> None:
    ahead = cameras((0, 0, 0), (0, 0, 2.0), (0.3, 0.4, 1.0), sources=((1, 2), (0, 2), (0, 1)))
    assert std_at_unit_depth(ahead, [0], [FOCAL_PX]) == pytest.approx(MATCH_PX / (FOCAL_PX * 0.5))
    behind_each_other = cameras((0, 0, 0), (0, 0, 2.0), sources=((1,), (0,)))
    assert std_at_unit_depth(behind_each_other, [0, 1], [FOCAL_PX, FOCAL_PX]) == 0.0
    assert std_at_unit_depth(cameras((0, 0, 0), sources=((),)), [0], [FOCAL_PX]) == 0.0


def test_steps_are_fine_and_few() -> None:
    depth = np.linspace(1.0, 2.0, 1000)
    std = depth_std(depth**-4.0, 1e-3)
    assert np.abs(std / (1e-3 * depth**2) - 1.0).max() <= 1 / 64
    assert 40 <= len(np.unique(std)) <= 80


def test_a_pixel_is_as_long_as_its_place_is_deep() -> None:
    depth, views = np.array([1.0, 4.0, 8.0]), np.array([1, 3, 9])
    size = pixel_size(views * depth**-4.0, views, FOCAL_PX)
    assert size.dtype == np.float32
    assert size == pytest.approx(depth / FOCAL_PX, rel=0.04)
    fine = pixel_size(np.linspace(1.0, 2.0, 1000) ** -4.0, np.ones(1000, np.int32), FOCAL_PX)
    assert 16 <= len(np.unique(fine)) <= 18


def test_a_fused_cloud_tells_it_in_its_own_unit(tmp_path: Path) -> None:
    scene = make_scene(tmp_path / "scene", tmp_path)
    cloud = fuse(scene, tmp_path)
    std = cloud.extra[DEPTH_STD]
    assert std.dtype == np.float32
    depth = np.linalg.norm(cloud.xyz - np.array([view.camera.center for view in scene.views])[:, None], axis=2)
    at_unit = std_at_unit_depth(scene, range(len(scene.views)), [view.camera.intrinsic[0, 0] for view in scene.views])
    # Of five views that agree, at the nearest camera, and of one, at the farthest: depths are shorter than distances.
    assert (std > 0.6 * at_unit * depth.min(axis=0) ** 2 / np.sqrt(5.0)).all()
    assert (std < 1.02 * at_unit * depth.max(axis=0) ** 2).all()
    size = cloud.extra[PIXEL_SIZE]
    # Of the depth maps: the patch that a depth is the mean of is one of the reduced picture.
    focal_px = scene.views[0].camera.intrinsic[0, 0] / STEP
    assert (size > 0.6 * depth.min(axis=0) / focal_px).all()
    assert (size < 1.5 * depth.max(axis=0) / focal_px).all()
    moved = transform_cloud(cloud, np.diag([2.0, 2.0, 2.0, 1.0]))
    assert moved.extra[PIXEL_SIZE] == pytest.approx(2.0 * size)
    assert moved.extra[DEPTH_STD] == pytest.approx(2.0 * std)
    assert moved.extra["confidence"] is cloud.extra["confidence"]


def test_of_reduced_photographs_a_match_is_as_much_less_sure(tmp_path: Path) -> None:
    scene = make_scene(tmp_path / "scene", tmp_path)
    given = fuse(scene, tmp_path).extra[DEPTH_STD]
    # The same maps of photographs of twice the size, which the network was given at half of it.
    views = []
    for view in scene.views:
        camera = replace(view.camera, intrinsic=np.array([[2, 0, 0.5], [0, 2, 0.5], [0, 0, 1]]) @ view.camera.intrinsic)
        path = tmp_path / view.image_path.name
        write_image(path, read_view_image(view).repeat(2, axis=0).repeat(2, axis=1))
        views.append(replace(view, camera=camera, image_path=path))
    index = {"pixel_step": 2 * STEP, "offset_x_px": 0.5, "offset_y_px": 0.5}
    (tmp_path / "depth" / "depth.json").write_text(json.dumps(index))
    reduced = fuse(replace(scene, views=tuple(views)), tmp_path).extra[DEPTH_STD]
    assert reduced == pytest.approx(given, rel=0.04)
