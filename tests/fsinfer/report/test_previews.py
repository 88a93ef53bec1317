from pathlib import Path

import numpy as np

from fsinfer.io.cloud import PointCloud
from fsinfer.report.cloud.previews import BACKGROUND_RGB, NO_DEPTH_RGB, cloud_view, depth_preview


def test_depth_colours_go_from_red_near_to_blue_far(tmp_path: Path) -> None:
    depth = np.tile(np.linspace(1, 8, 50, dtype=np.float32), (10, 1))
    depth[0] = 0
    depth[1] = np.nan
    picture = depth_preview(depth)
    assert (picture[:2] == NO_DEPTH_RGB).all()
    near, far = picture[5, 0].astype(int), picture[5, -1].astype(int)
    assert near[0] > 2 * near[2]
    assert far[2] > far[0]
    np.testing.assert_array_equal(picture[5, 10], picture[9, 10])
    assert (depth_preview(np.zeros((4, 5), np.float32)) == NO_DEPTH_RGB).all()


def test_nearer_points_hide_farther_ones_and_axes_point_where_they_should() -> None:
    side = np.linspace(0, 1, 60)
    x, y = (a.ravel() for a in np.meshgrid(side, side))
    low = np.column_stack([x, y, np.zeros_like(x)])
    high = np.column_stack([0.5 * x, 0.5 * y, np.ones_like(x)])
    rgb = np.concatenate([np.tile([255, 0, 0], (3600, 1)), np.tile([0, 0, 255], (3600, 1))]).astype(np.uint8)
    for order in (slice(None), slice(None, None, -1)):
        cloud = PointCloud(xyz=np.concatenate([low, high])[order], rgb=rgb[order])
        picture = cloud_view(cloud, "top", size_px=50)
        # y up: the high patch lies in the lower left quarter.
        assert (picture[35:48, 3:20] == [0, 0, 255]).all(axis=2).mean() > 0.95
        assert (picture[3:20, 30:48] == [255, 0, 0]).all(axis=2).mean() > 0.95
        view = cloud_view(cloud, "side", size_px=50)
        assert (view[:3] == [0, 0, 255]).all(axis=2).any()
        assert (view[-3:] == [255, 0, 0]).all(axis=2).any()
        assert (view[20:30] == BACKGROUND_RGB).all()


def test_cloud_without_colours_and_single_point(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    picture = cloud_view(PointCloud(xyz=rng.uniform(0, 3, (2000, 3)) * [1, 1, 0.3]), "side")
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 50
    assert cloud_view(PointCloud(xyz=np.zeros((1, 3)))).ndim == 3
