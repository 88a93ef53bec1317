"""The lens and a photo's own effects: against arithmetic by hand, and derivatives against differences."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from fsinfer.poses.adjustment.projection import LENS, OWN, Floats, project, project_with_jacobians, read_at, read_at_of

LENS_OF_ALL_TERMS = [1000.0, 1010.0, 640.0, 360.0, 0.03, -0.01, 0.001, -0.002, 0.003, 0.02, 0.01, -0.005]
OWN_STD = [0.01, 2, 2, 0.01, 0.01, 0.01, 0.05, 0.05, 0.05]


def differences(function: Callable[[Floats], Floats], size: int, step: float = 1e-6) -> Floats:
    """(n, 2, size) central differences."""
    sides = [(function(step * axis) - function(-step * axis)) / (2 * step) for axis in np.eye(size)]
    return np.stack(sides, axis=2)


def test_derivatives_are_those_of_differences() -> None:
    rng = np.random.default_rng(0)
    points = rng.normal(size=(40, 3)) + np.array([0, 0, 5])
    tau = rng.uniform(-0.5, 0.5, 40)
    lens = np.tile(LENS_OF_ALL_TERMS, (40, 1))
    own = rng.normal(size=(40, OWN)) * OWN_STD
    pixels, by_point, by_own, by_lens = project_with_jacobians(points, tau, lens, own)
    np.testing.assert_array_equal(pixels, project(points, tau, lens, own))
    np.testing.assert_allclose(by_point, differences(lambda d: project(points + d, tau, lens, own), 3), atol=1e-5)
    np.testing.assert_allclose(by_own, differences(lambda d: project(points, tau, lens, own + d), OWN), atol=1e-5)
    np.testing.assert_allclose(by_lens, differences(lambda d: project(points, tau, lens + d, own), LENS), atol=1e-5)


def test_lens_is_that_of_colmap() -> None:
    pycolmap = pytest.importorskip("pycolmap")
    camera = pycolmap.Camera(camera_id=1, model="FULL_OPENCV", width=1280, height=720, params=LENS_OF_ALL_TERMS)
    points = np.random.default_rng(1).normal(size=(40, 3)) * (1, 1, 0.5) + (0, 0, 4)
    lens = np.tile(LENS_OF_ALL_TERMS, (40, 1))
    pixels = project(points, np.zeros(40), lens, np.zeros((40, OWN)))
    np.testing.assert_allclose(pixels, camera.img_from_cam(points), atol=1e-9)


@pytest.mark.parametrize(
    ("index", "value", "moves_by"),
    [
        (0, np.log(1.01), (1.0, 0.5)),
        (1, 2.0, (2.0, 0.0)),
        (2, 2.0, (0.0, 2.0)),
        # The last row's camera sees the point (1, 0.5, 10) turned by half of 0.02 rad about z: x falls by 0.005.
        (5, 0.02, (-0.5, 1.0)),
        (6, 0.1, (5.0, 0.0)),
    ],
    ids=["focal", "principal x", "principal y", "turn about z", "way along x"],
)
def test_each_of_a_photo_moves_the_last_row(index: int, value: float, moves_by: tuple[float, float]) -> None:
    lens = np.array([[1000.0, 1000.0, 640.0, 360.0, *[0.0] * 8]])
    point, last = np.array([[1.0, 0.5, 10.0]]), np.array([0.5])
    own = np.zeros((1, OWN))
    still = project(point, last, lens, own)
    own[0, index] = value
    np.testing.assert_allclose(project(point, last, lens, own) - still, [moves_by], atol=1e-9)


def test_rows_are_read_across_the_longer_side_of_pictures_held_either_way() -> None:
    pixels = np.random.default_rng(0).uniform(0.0, 300.0, (40, 2))
    sizes = np.where(np.arange(40)[:, None] % 2 == 0, [400, 300], [300, 400])
    expected = [read_at(pixels[i : i + 1], *map(int, sizes[i]))[0] for i in range(40)]
    np.testing.assert_allclose(read_at_of(pixels, sizes), expected)
    # The top of a picture that lies, and the left of one that stands, are read first.
    assert read_at(np.array([[150.0, 0.0]]), 400, 300) == -0.5
    assert read_at(np.array([[0.0, 150.0]]), 300, 400) == -0.5
