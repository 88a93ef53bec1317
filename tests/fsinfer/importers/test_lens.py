"""Lenses bend rays as OpenCV has them, and pinhole images hold nothing but the photo."""

from __future__ import annotations

import re

import cv2
import numpy as np
import pytest

from fsinfer.errors import SceneError
from fsinfer.importers.lens import Lens, pinhole_of, undistortion_maps
from fsinfer.poses.undistortion import undistort
from tests.support import foreign_scenes as made

BENT = Lens(
    width=160, height=120, fx=130.0, fy=128.0, cx=81.3, cy=58.9, skew=0.4,
    radial=(-0.12, 0.05, 0.01, 0.002), tangential=(0.002, -0.003),
)  # fmt: skip
BARREL = Lens(width=160, height=120, fx=130.0, fy=130.0, cx=79.5, cy=59.5, radial=(-0.2,))
CUSHION = Lens(width=160, height=120, fx=130.0, fy=130.0, cx=79.5, cy=59.5, radial=(0.2,))


def border(lens: Lens) -> np.ndarray:
    u, v = np.meshgrid(np.linspace(-0.5, lens.width - 0.5, 23), np.linspace(-0.5, lens.height - 0.5, 19))
    return np.stack([u.ravel(), v.ravel()], axis=1)


def test_a_rational_lens_is_opencvs() -> None:
    coefficients = (-0.1, 0.04, 0.002, -0.003, 0.01, 0.02, -0.01, 0.003)
    lens = Lens(
        width=160, height=120, fx=130.0, fy=128.0, cx=81.3, cy=58.9,
        radial=(coefficients[0], coefficients[1], coefficients[4]), divisor=coefficients[5:],
        tangential=(coefficients[2], coefficients[3]),
    )  # fmt: skip
    rays = np.random.default_rng(0).uniform(-0.6, 0.6, (200, 2))
    points = np.column_stack([rays, np.ones(200)])
    expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), lens.intrinsic, np.array(coefficients))
    np.testing.assert_allclose(lens.pixels_of(rays), expected[:, 0], atol=1e-9)


@pytest.mark.parametrize("lens", [BENT, BARREL, CUSHION])
def test_rays_fall_on_the_pixels_that_they_are_of(lens: Lens) -> None:
    pixels = border(lens)
    np.testing.assert_allclose(lens.pixels_of(lens.rays_of(pixels)), pixels, atol=1e-6)


@pytest.mark.parametrize("lens", [BENT, BARREL, CUSHION])
def test_the_pinhole_image_shows_the_photo_alone_and_much_of_it(lens: Lens) -> None:
    pinhole = pinhole_of(lens)
    assert pinhole.is_pinhole
    assert (pinhole.fx, pinhole.fy) == (lens.fx, lens.fy)
    x, y = undistortion_maps(lens, pinhole)
    assert x.shape == (pinhole.height, pinhole.width)
    # The border of the image is the photo's: half a pixel beyond the centres of its pixels.
    assert min(x.min(), y.min()) >= -0.3
    assert x.max() <= lens.width - 0.7
    assert y.max() <= lens.height - 0.7
    # The largest: a pixel more on each side would look beyond the photo.
    assert min(x.min(), y.min(), lens.width - 1 - x.max(), lens.height - 1 - y.max()) < 0.6


def test_an_undistorted_photo_is_the_one_without_a_lens() -> None:
    photo = made.truth(made.BROWN).photos[1]
    k1, k2, p1, p2, k3 = made.BROWN.bent
    lens = Lens(
        width=160, height=120, fx=130.0, fy=130.0, cx=81.3, cy=58.9, radial=(k1, k2, k3), tangential=(p1, p2)
    )  # fmt: skip
    pinhole = pinhole_of(lens)
    straight = made.TrueLens(fx=pinhole.fx, fy=pinhole.fy, cx=pinhole.cx, cy=pinhole.cy)
    expected = made.render(photo, straight, (pinhole.width, pinhole.height)).astype(float)
    found = undistort(made.render(photo, made.BROWN), undistortion_maps(lens, pinhole)).astype(float)
    difference = np.abs(found - expected)[2:-2, 2:-2]
    shifted = np.abs(found[2:-2, 3:-1] - expected[2:-2, 2:-2])
    assert difference.mean() < 1.5
    assert difference.mean() < shifted.mean() / 5  # a pixel to the side would be seen


def test_a_reduced_copy_keeps_its_rays() -> None:
    half = BENT.of_size(80, 60)
    # The centre of a pixel of the copy is the corner of four of the photo.
    np.testing.assert_allclose(
        half.rays_of(np.array([[10.0, 20.0]])), BENT.rays_of(np.array([[20.5, 40.5]])), atol=1e-9
    )
    assert BENT.of_size(54, 40).width == 54  # 40.5 is rounded
    with pytest.raises(SceneError, match="100x60 pixels large, its camera was calibrated for 160x120"):
        BENT.of_size(100, 60)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"radial": (-1.5,)}, "cannot be undone"),
        ({"radial": (0.0, 0.0, -40.0)}, "cannot be undone"),
        ({"radial": (50.0,)}, "would have"),
        ({"divisor": (-9.0,)}, "cannot be undone|would have"),
    ],
)
def test_a_lens_that_none_has_is_told(change: dict[str, tuple[float, ...]], told: str) -> None:
    with pytest.raises(SceneError) as raised:
        pinhole_of(Lens(width=160, height=120, fx=130.0, fy=130.0, cx=79.5, cy=59.5, **change))  # type: ignore[arg-type]
    assert re.search(told, str(raised.value))


def test_a_border_beyond_a_fold_is_told() -> None:
    # The bent rays rise, fall and rise again: the border has a ray, but another one falls on the same pixel.
    lens = Lens(width=160, height=120, fx=130.0, fy=130.0, cx=79.5, cy=59.5, radial=(-2.0, 1.5))
    beyond = np.array([[1.02, 0.0]])
    with pytest.raises(SceneError, match="cannot be undone"):
        lens.rays_of(lens.pixels_of(beyond))


@pytest.mark.parametrize("change", [{"fx": 0.0}, {"fy": -1.0}, {"cx": float("nan")}, {"width": 0}])
def test_a_lens_without_sense_is_told(change: dict[str, float]) -> None:
    values = {"width": 160, "height": 120, "fx": 130.0, "fy": 130.0, "cx": 80.0, "cy": 60.0} | change
    with pytest.raises(SceneError, match="focal lengths"):
        Lens(**values)  # type: ignore[arg-type]
