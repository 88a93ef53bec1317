"""Sources of a scene without tie points, of many views that look over the same ground."""

from __future__ import annotations

import numpy as np

from fsinfer.importers.views import GeometricSettings, scores_without_points
from fsinfer.poses.view_selection import choose_sources
from fsinfer.scene import Camera


def _dense_walk(count: int, side_m: float) -> list[Camera]:
    """Cameras at breast height that look level in all directions."""
    rng = np.random.default_rng(0)
    intrinsic = np.array([[1200.0, 0.0, 960.0], [0.0, 1200.0, 540.0], [0.0, 0.0, 1.0]])
    cameras = []
    for x, y, turn in rng.uniform([0.0, 0.0, -np.pi], [side_m, side_m, np.pi], (count, 3)):
        ahead, down = np.array([np.cos(turn), np.sin(turn), 0.0]), np.array([0.0, 0.0, -1.0])
        pose = np.eye(4)
        pose[:3, :3] = [np.cross(down, ahead), down, ahead]
        pose[:3, 3] = -pose[:3, :3] @ [x, y, 1.5]
        cameras.append(Camera(intrinsic=intrinsic, cam_from_world=pose, depth_min=0.5, depth_max=30.0))
    return cameras


def test_many_views_of_one_ground_get_their_sources_from_fewer_places() -> None:
    """What pairs share grows with the third power of the views; a bounded part of it tells the same sources."""
    cameras = _dense_walk(120, 10.0)
    sizes = [(1920, 1080)] * len(cameras)
    whole = scores_without_points(cameras, sizes, GeometricSettings(most_shared=10**12))
    part = scores_without_points(cameras, sizes, GeometricSettings(most_shared=200_000))
    assert np.array_equal(scores_without_points(cameras, sizes), whole)
    assert part.sum() < 0.5 * whole.sum()
    best, chosen = choose_sources(whole, 8), choose_sources(part, 8)
    kept = [sum(whole[view, i] for i, _ in chosen[view]) / sum(score for _, score in best[view]) for view in chosen]
    assert np.mean(kept) > 0.97


def test_views_aside_of_a_dense_part_keep_their_sources() -> None:
    """Of a path to a plot with a thousand views most had none: what was drawn was drawn from the plot."""
    intrinsic = np.array([[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]])
    plot = [(8.0 * np.cos(turn), 8.0 * np.sin(turn), turn + np.pi) for turn in np.linspace(0.0, 2.0 * np.pi, 150)]
    path = [(60.0 + 3.0 * step, 0.0, 2.4) for step in range(12)]
    cameras = []
    for x, y, turn in (*plot, *path):
        ahead, down = np.array([np.cos(turn), np.sin(turn), 0.0]), np.array([0.0, 0.0, -1.0])
        pose = np.eye(4)
        pose[:3, :3] = [np.cross(down, ahead), down, ahead]
        pose[:3, 3] = -pose[:3, :3] @ [x, y, 1.5]
        cameras.append(Camera(intrinsic=intrinsic, cam_from_world=pose, depth_min=0.5, depth_max=15.0))
    sizes = [(640, 480)] * len(cameras)
    whole = scores_without_points(cameras, sizes, GeometricSettings(most_shared=10**12))
    part = scores_without_points(cameras, sizes, GeometricSettings(most_shared=200_000))
    assert part.sum() < 0.1 * whole.sum()
    sources = choose_sources(whole[150:, 150:], 8)
    assert min(len(of_view) for of_view in sources.values()) >= 4
    chosen = choose_sources(part[150:, 150:], 8)
    assert {view: {i for i, _ in own} for view, own in chosen.items()} == {
        view: {i for i, _ in own} for view, own in sources.items()
    }
