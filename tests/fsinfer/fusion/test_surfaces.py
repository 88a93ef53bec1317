"""The surface round a pixel: how many neighbours it takes, and the normal of a plane that leans every way."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.depth.maps import DepthMap, DepthMaps, PixelGrid
from fsinfer.fusion.fuse import FusionSettings, find_neighbours, fuse_view
from fsinfer.fusion.surfaces import pixel_normals, smooth_pixels
from fsinfer.io.images import read_image, write_image
from tests.fsinfer.fusion.test_fuse import make_scene

AROUND = [(row, column) for row in (-1, 0, 1) for column in (-1, 0, 1) if (row, column) != (0, 0)]


def map_of(inverse: NDArray[np.floating], *, focal: float = 140.0) -> DepthMap:
    """A map with its principal point at (3, 5), which is no centre of symmetry."""
    return DepthMap(
        inverse_depth=np.asarray(inverse, np.float32),
        confidence=np.ones(inverse.shape, np.float32),
        intrinsic=np.array([[focal, 0, 3.0], [0, 1.1 * focal, 5.0], [0, 0, 1]]),
        cam_from_world=np.eye(4),
        grid=PixelGrid(step_x=1.0, step_y=1.0),
    )


@pytest.mark.parametrize("other", [0.0, 0.25, 2.0])
def test_five_of_eight_neighbours_make_a_surface(other: float) -> None:
    """Whichever three are missing, nearer or farther."""
    for missing, kept in ((3, True), (4, False)):
        for places in combinations(AROUND, missing):
            inverse = np.full((7, 9), 0.5)
            for row, column in places:
                inverse[3 + row, 4 + column] = other
            assert smooth_pixels(map_of(inverse), min_neighbours=5, noise=1e-3)[3, 4] == kept, places


@pytest.mark.parametrize(("share", "kept"), [(0.0021, True), (0.0027, True), (0.0032, False)])
def test_neighbours_may_differ_by_slope_and_noise(share: float, kept: bool) -> None:
    # Of a long lens the slope alone, 80 degrees, is 0.19 % a pixel; noise adds 0.1 %.
    inverse = np.full((7, 9), 0.5)
    inverse[3, 4] *= 1 + share
    keep = smooth_pixels(map_of(inverse, focal=3000.0), min_neighbours=5, noise=1e-3)
    assert keep[3, 4] == kept


def test_at_the_border_as_large_a_part_of_what_there_is() -> None:
    inverse = np.full((6, 8), 0.5)
    assert smooth_pixels(map_of(inverse), min_neighbours=5, noise=1e-3).all()
    inverse[0, 1] = inverse[1, 0] = 0.1  # two of the corner's three
    assert not smooth_pixels(map_of(inverse), min_neighbours=5, noise=1e-3)[0, 0]
    inverse[1, 0] = 0.5  # one of three
    assert smooth_pixels(map_of(inverse), min_neighbours=5, noise=1e-3)[0, 0]


@pytest.mark.parametrize("normal", [(0.0, 0.0, -1.0), (0.5, 0.2, -0.8), (-0.3, 0.6, -0.7), (0.1, -0.7, -0.6)])
def test_the_normal_of_a_plane_is_exact_wherever_it_leans(normal: tuple[float, float, float]) -> None:
    unit = np.array(normal) / np.linalg.norm(normal)
    reference = map_of(np.ones((20, 24)))
    u, v = np.meshgrid(np.arange(24), np.arange(20))
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(reference.intrinsic).T
    plane = replace(reference, inverse_depth=np.asarray(rays @ unit / (-2.0), np.float32))  # n . X = -2
    rows, columns = np.mgrid[0:20:3, 0:24:4].reshape(2, -1)
    found = pixel_normals(plane, rows, columns, noise=1e-3)
    np.testing.assert_allclose(found, np.tile(unit, (len(rows), 1)), atol=2e-3)
    # What does not lie on the plane has no say.
    holes = plane.inverse_depth.copy()
    holes[::5, ::4] = 0
    holes[2::5, 2::4] *= 3
    keep = np.ones((20, 24), bool)
    keep[::5, ::4] = keep[2::5, 2::4] = False
    rows, columns = np.nonzero(keep)
    found = pixel_normals(replace(plane, inverse_depth=holes), rows, columns, noise=1e-3)
    np.testing.assert_allclose(found, np.tile(unit, (len(rows), 1)), atol=4e-3)


def test_the_normal_of_a_rough_surface_is_that_of_its_definition_at_every_pixel() -> None:
    """Border, holes and edges among them; the neighbours one by one."""
    rng = np.random.default_rng(3)
    height, width = 17, 21
    inverse = 0.4 + 0.05 * rng.random((height, width))
    inverse[:, 12:] += 0.6
    inverse[rng.random((height, width)) < 0.15] = 0
    reference = map_of(inverse)
    rows, columns = np.nonzero(reference.inverse_depth > 0)
    found = pixel_normals(reference, rows, columns, noise=1e-3)
    seen = reference.inverse_depth.astype(float)
    for row, column, normal in zip(rows.tolist(), columns.tolist(), found, strict=True):
        offsets, differences = [], []
        for reach in (1, 2):
            for down, right in AROUND:
                other = (
                    min(max(row + reach * down, 0), height - 1),
                    min(max(column + reach * right, 0), width - 1),
                )
                limit = 5.7 / 140.0 * reach * np.hypot(down, right) + 1e-3
                difference = seen[other] - seen[row, column]
                if seen[other] > 0 and abs(difference) <= limit * min(seen[other], seen[row, column]):
                    offsets.append((other[1] - column, other[0] - row))
                    differences.append(difference)
        ways = np.array(offsets, float).reshape(-1, 2)
        slope = np.zeros(2)
        if np.linalg.matrix_rank(ways) == 2:
            slope = np.linalg.lstsq(ways, np.array(differences), rcond=None)[0]
        plane = -np.array([*slope, seen[row, column] - slope @ (column, row)]) @ reference.intrinsic
        np.testing.assert_allclose(normal, plane / np.linalg.norm(plane), atol=2e-4)


def test_the_colour_of_a_point_is_the_mean_over_its_pixel(tmp_path: Path) -> None:
    scene = make_scene(tmp_path / "scene", tmp_path, cameras=3)
    rng = np.random.default_rng(0)
    path = scene.views[0].image_path
    image = rng.integers(0, 255, read_image(path).shape, dtype=np.uint8)
    write_image(path, image)
    maps = DepthMaps(scene, tmp_path)
    found = fuse_view(scene, maps, 0, (1, 2), min_confidence=0.5, settings=FusionSettings())
    camera = scene.views[0].camera
    seen = (found.xyz @ camera.cam_from_world[:3, :3].T + camera.cam_from_world[:3, 3]) @ camera.intrinsic.T
    x, y = np.rint(seen[:, :2] / seen[:, 2:]).astype(int).T
    # Depth pixels are two image pixels wide: three are averaged, so that the middle stays in place.
    np.testing.assert_allclose(found.rgb, cv2.blur(image, (3, 3))[y, x], atol=1.0)
    assert fuse_view(scene, maps, 0, (), min_confidence=0.5, settings=FusionSettings()).xyz.shape == (0, 3)
    assert find_neighbours(scene, maps.available, 1)[0] == (1,)
