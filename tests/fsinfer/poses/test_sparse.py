"""Depth maps are compared with sparse points where and how they should be."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.depth.maps import PixelGrid
from fsinfer.depth.sfm_check import SfmCheckSettings as CheckSettings
from fsinfer.depth.sfm_check import check_depth, compare_depth
from fsinfer.errors import SceneError
from fsinfer.io.pfm import read_pfm, write_pfm
from fsinfer.poses.sparse import SparseModel, read_sparse
from fsinfer.scene import Scene, read_scene
from tests.support.synthetic_plot import depth_map, write_depth_folder, write_scene_folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("plot")
    write_scene_folder(folder)
    return folder


@pytest.fixture(scope="module")
def scene(folder: Path) -> Scene:
    return read_scene(folder)


@pytest.fixture
def sparse(scene: Scene) -> SparseModel:
    """Surface points made of the exact depth maps of three views, each seen in its own view only."""
    rng = np.random.default_rng(0)
    points: list[NDArray[np.float64]] = []
    observations = {}
    for index in (0, 3, 6):
        view = scene.views[index]
        depth = depth_map(index)
        rows, columns = np.nonzero(depth)
        chosen = rng.choice(len(rows), 40, replace=False)
        u, v = columns[chosen], rows[chosen]
        z = depth[v, u].astype(np.float64)
        in_camera = np.linalg.inv(view.camera.intrinsic) @ np.stack([u * z, v * z, z])
        pose = view.camera.cam_from_world
        first = sum(len(p) for p in points)
        points.append((pose[:3, :3].T @ (in_camera - pose[:3, 3:])).T)
        observations[view.name] = np.arange(first, first + 40)
    together = np.concatenate(points)
    return SparseModel(
        points=together,
        errors_px=np.full(len(together), 0.2),
        track_lengths=np.full(len(together), 5),
        observations=observations,
    )


def scaled(out: Path, names: list[str], factor: float) -> None:
    for name in names:
        path = out / "depth" / f"{name}.pfm"
        write_pfm(path, read_pfm(path) * np.float32(factor))


def test_exact_depth_differs_by_nothing(scene: Scene, sparse: SparseModel, tmp_path: Path) -> None:
    write_depth_folder(scene, tmp_path)
    check = check_depth(scene, sparse, tmp_path)
    assert check.median_rel is not None
    assert check.median_rel < 1e-5
    assert (check.compared, check.asked, check.relaxed) == (120, 120, False)


def test_wrong_depth_is_seen_where_it_is(scene: Scene, sparse: SparseModel, tmp_path: Path) -> None:
    write_depth_folder(scene, tmp_path)
    names = [scene.views[index].name for index in (0, 3)]
    scaled(tmp_path, names[:1], 1.03)
    scaled(tmp_path, names[1:], 0.98)
    check = check_depth(scene, sparse, tmp_path)
    assert check.per_view_rel[names[0]] == pytest.approx(0.03, abs=1e-4)
    assert check.per_view_rel[names[1]] == pytest.approx(0.02, abs=1e-4)
    assert check.median_rel == pytest.approx(0.02, abs=1e-4)


def test_poor_points_do_not_count_unless_there_are_no_others(
    scene: Scene, sparse: SparseModel, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    write_depth_folder(scene, tmp_path)
    points, tracks, errors = sparse.points.copy(), sparse.track_lengths.copy(), sparse.errors_px.copy()
    points[:35] *= 1.5
    tracks[:20], errors[20:35] = 3, 0.8
    poor = SparseModel(points=points, errors_px=errors, track_lengths=tracks, observations=sparse.observations)
    check = check_depth(scene, poor, tmp_path)
    assert check.asked == 85
    assert max(check.per_view_rel.values()) < 1e-5
    with caplog.at_level(logging.WARNING):
        relaxed = check_depth(scene, poor, tmp_path, settings=CheckSettings(min_points=100))
    assert relaxed.relaxed
    assert relaxed.asked == 120
    assert "weaker points" in caplog.text


def test_no_depth_at_the_points(scene: Scene, sparse: SparseModel, tmp_path: Path) -> None:
    write_depth_folder(scene, tmp_path)
    scaled(tmp_path, [view.name for view in scene.views], 0.0)
    check = check_depth(scene, sparse, tmp_path)
    assert check.median_rel is None
    assert (check.compared, check.asked) == (0, 120)
    with pytest.raises(SceneError, match="fsinfer depth"):
        check_depth(scene, sparse, tmp_path / "empty")


def test_a_coarse_map_is_interpolated_on_planes_and_not_across_edges(scene: Scene) -> None:
    camera = scene.views[0].camera
    pose, matrix = camera.cam_from_world, camera.intrinsic
    grid = PixelGrid(step_x=2.0, step_y=2.0, offset_x_px=0.5, offset_y_px=0.5)
    u, v = np.meshgrid(np.arange(100) * 2 + 0.5, np.arange(75) * 2 + 0.5)
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(matrix).T
    # 1 / z is linear in the image for a plane n x = 1.
    inverse = (rays @ np.array([0.05, 0.02, 0.2])).astype(np.float32)
    step = inverse.copy()
    step[:, 50:] *= 2
    image_points = np.random.default_rng(0).uniform(2, 145, (200, 2)) * [1.35, 1]
    directions = np.column_stack([image_points, np.ones(200)]) @ np.linalg.inv(matrix).T
    on_plane = directions / (directions @ np.array([0.05, 0.02, 0.2]))[:, None]
    world = (on_plane - pose[:3, 3]) @ pose[:3, :3]
    assert np.nanmax(compare_depth(inverse, camera, grid, world)) < 1e-5
    across = compare_depth(step, camera, grid, world)
    near = np.abs(across - 0.5) < 0.01
    assert (near | (across < 0.02)).all()  # either side, nothing between
    behind = compare_depth(inverse, camera, grid, (-on_plane - pose[:3, 3]) @ pose[:3, :3])
    assert np.isnan(behind).all()


def test_folder_that_is_no_model(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="fsinfer poses"):
        read_sparse(tmp_path)
    for name in ("cameras", "images", "points3D", "frames", "rigs"):
        (tmp_path / f"{name}.bin").write_bytes(b"\x07\x00")
    with pytest.raises(SceneError, match="fsinfer poses"):
        read_sparse(tmp_path)
