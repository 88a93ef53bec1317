"""From photographs with a lens to pinhole images: the same rays, by the lens written out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from fsinfer.poses.undistortion import (
    NoWayBackError,
    intrinsic_of,
    pinhole_of,
    straightened,
    undistort,
    undistort_model,
    undistortion_maps,
)

pycolmap = pytest.importorskip("pycolmap")
FOCAL, CENTER, K1 = 300.0, (158.0, 121.0), -0.08
LENS = pycolmap.Camera(camera_id=7, model="SIMPLE_RADIAL", width=320, height=240, params=[FOCAL, *CENTER, K1])


def test_each_pixel_of_the_pinhole_image_lies_where_its_ray_meets_the_photo() -> None:
    pinhole = pinhole_of(LENS)
    assert pinhole.camera_id == 7
    map_x, map_y = undistortion_maps(LENS, pinhole)
    assert map_x.shape == map_y.shape == (pinhole.height, pinhole.width)
    v, u = np.mgrid[: pinhole.height, : pinhole.width]
    # Pixel centres at integers on both sides; COLMAP's centre of projection counts from the corner of the first pixel.
    x, y, _ = np.moveaxis(np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(intrinsic_of(pinhole)).T, -1, 0)
    bent = 1 + K1 * (x**2 + y**2)
    np.testing.assert_allclose(map_x, FOCAL * x * bent + CENTER[0] - 0.5, atol=2e-3)
    np.testing.assert_allclose(map_y, FOCAL * y * bent + CENTER[1] - 0.5, atol=2e-3)


def test_the_pinhole_image_shows_what_lies_on_its_rays() -> None:
    # A photo whose brightness tells the ray's x and whose green tells its y, as the lens sees them.
    v, u = np.mgrid[:240, :320]
    rays = LENS.cam_from_img(np.stack([u.ravel() + 0.5, v.ravel() + 0.5], axis=1).astype(float)).reshape(240, 320, 2)
    photo = np.rint(128 + 180 * rays[..., [0, 1, 0]]).clip(0, 255).astype(np.uint8)
    pinhole = pinhole_of(LENS)
    image = undistort(photo, undistortion_maps(LENS, pinhole))
    v, u = np.mgrid[: pinhole.height, : pinhole.width]
    expected = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(intrinsic_of(pinhole)).T
    inner = (slice(4, -4), slice(4, -4))
    assert np.abs(image[inner][..., :2] - (128 + 180 * expected[inner][..., :2]).clip(0, 255)).max() < 2.0


def test_places_of_a_photo_are_found_in_its_pinhole_image() -> None:
    pinhole = pinhole_of(LENS)
    maps = undistortion_maps(LENS, pinhole)
    pixels = np.array([[20.0, 25.0], [300.0, 30.0], [160.25, 120.75], [40.0, 215.5]])
    rays = np.column_stack([LENS.cam_from_img(pixels + 0.5), np.ones(4)])
    found = straightened(pixels, maps, LENS, pinhole)
    assert found is not None
    np.testing.assert_allclose(found, pinhole.img_from_cam(rays) - 0.5, atol=0.02)
    assert np.abs(found - pixels).max() > 3.0
    # What the photo alone has is found beside what the lens does.
    shifted = straightened(pixels, (maps[0] + np.float32(4.5), maps[1]), LENS, pinhole)
    assert shifted is not None
    np.testing.assert_allclose(shifted[:, 0], found[:, 0] - 4.5, atol=0.4)
    # The pinhole image is cut so that it has no black border.
    assert straightened(np.array([[160.0, 120.0], [0.0, 0.0]]), maps, LENS, pinhole) is None
    assert straightened(np.array([[-150.0, 120.0]]), maps, LENS, pinhole) is None


def test_a_way_back_that_is_not_found_is_no_place_outside() -> None:
    pinhole = pinhole_of(LENS)
    # Every pixel of the image shows the same place of the photo.
    flat = tuple(np.full_like(one, 50.0) for one in undistortion_maps(LENS, pinhole))
    with pytest.raises(NoWayBackError):
        straightened(np.array([[50.5, 50.5]]), (flat[0], flat[1]), LENS, pinhole)


def test_observations_move_with_the_images_and_the_lenses_are_handed_back() -> None:
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_frames_per_rig, options.num_points3D = 1, 3, 40
    options.camera_params = [1280.0, 512.0, 384.0, -0.1]
    model = pycolmap.synthesize_dataset(options)
    before = {i: np.array([point.xy for point in image.points2D]) for i, image in model.images.items()}
    lenses = undistort_model(model)
    assert {camera.model.name for camera in lenses.values()} == {"SIMPLE_RADIAL"}
    assert {camera.model.name for camera in model.cameras.values()} == {"PINHOLE"}
    # The points still project onto their observations, which are no longer where they were.
    assert model.compute_mean_reprojection_error() < 1e-3
    moved = [np.abs(np.array([p.xy for p in image.points2D]) - before[i]).max() for i, image in model.images.items()]
    assert min(moved) > 3.0
