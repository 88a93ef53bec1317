"""Photographs at the size of a benchmark keep their cameras."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fsinfer.errors import SceneError
from fsinfer.scene import read_scene, read_view_image
from tests.bench.scene_views import views_of_scene
from tests.support.plane_scene import FOCAL_PX, PLANE_DEPTH, write_plane_scene


# The principal point (70, 54) of 108 x 140 pixels: all of them, the middle 100 columns twice as large, 50 rows.
@pytest.mark.parametrize(
    ("size", "principal"), [((108, 140), (70, 54)), ((216, 200), (100.5, 108.5)), ((50, 140), (70, 25))]
)
def test_a_place_is_seen_where_its_camera_says(
    size: tuple[int, int], principal: tuple[float, float], tmp_path: Path
) -> None:
    scene = read_scene(write_plane_scene(tmp_path))
    images, intrinsics, poses, depth_range = views_of_scene(tmp_path, 3, *size)
    assert depth_range == (1.5, 12.0)
    first = scene.views[1]
    order = [first, *(scene.views[i] for i in first.sources)]
    assert len(images) == 3
    for image, intrinsic, pose, view in zip(images, intrinsics, poses, order, strict=True):
        assert image.shape == (*size, 3)
        np.testing.assert_array_equal(pose, view.camera.cam_from_world)
        np.testing.assert_allclose(intrinsic[:2, 2], principal)
        grown = intrinsic[0, 0] / FOCAL_PX
        np.testing.assert_allclose(intrinsic[1, 1] / FOCAL_PX, grown, rtol=0.03)
        whole = read_view_image(view)
        # Middles of the squares that the photographs are made of, by way of the plane.
        for y, x in ((52, 70), (58, 61), (40, 85)):
            at = np.linalg.inv(view.camera.intrinsic) @ [x, y, 1.0] * PLANE_DEPTH
            u, v, _ = intrinsic @ at / PLANE_DEPTH
            if 2 <= u < size[1] - 3 and 2 <= v < size[0] - 3:
                np.testing.assert_allclose(image[round(v), round(u)], whole[y, x], atol=70 if grown < 1 else 4)


def test_too_few_sources(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="has 2 sources, 4 are needed"):
        views_of_scene(write_plane_scene(tmp_path), 5, 108, 140)
