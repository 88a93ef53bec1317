"""The raster of the ground: fast ways against plain ones."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from fsinfer.trees import find_ground
from fsinfer.trees.ground.ground import reach_of
from fsinfer.trees.ground.raster import BLOCK, height_on, smooth_surface


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (4, 1), (2, 2), (7, 12)])
def test_heights_are_those_of_map_coordinates(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    raster, origin, cell_m = rng.normal(0.0, 1.0, shape), np.array([3.0, -1.0]), 0.4
    # On the raster, at its cells' centres, and far outside; more than one block.
    xy = origin + cell_m * rng.uniform(-3.0, 15.0, (BLOCK + 100, 2))
    xy[:50] = origin + cell_m * rng.integers(0, max(shape), (50, 2))
    plain = map_coordinates(raster, ((xy - origin) / cell_m)[:, ::-1].T, order=1, mode="nearest")
    np.testing.assert_allclose(height_on(raster, origin, cell_m, xy[:, 0], xy[:, 1]), plain, atol=1e-12)


@pytest.mark.parametrize("shape", [(2, 2), (3, 9), (9, 4)])
def test_a_surface_solves_its_equations(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(1)
    size = shape[0] * shape[1]
    cell = rng.choice(size, size // 2 + 1, replace=False)
    height = rng.normal(0.0, 0.02, len(cell))
    found = smooth_surface(cell, height, shape, 2.0, symmetric=True)
    differences = []
    for axis in (0, 1):
        for at in np.ndindex(*shape):
            if 0 < at[axis] < shape[axis] - 1:
                row = np.zeros(shape)
                row[at] = -2.0
                for side in (-1, 1):
                    row[(at[0] + side, at[1]) if axis == 0 else (at[0], at[1] + side)] = 1.0
                differences.append(row.ravel())
    penalty = 2.0 * sum((np.outer(d, d) for d in differences), start=np.zeros((size, size))) + 1e-4 * np.eye(size)
    surface: NDArray[np.floating] = np.zeros(size)
    for step in range(3):
        weight = 1.0 / (1.0 + ((height - surface[cell]) / 0.05) ** 2) if step else np.ones(len(cell))
        equations, target = penalty.copy(), np.zeros(size)
        equations[cell, cell] += weight
        target[cell] = weight * height
        surface = np.linalg.solve(equations, target)
    np.testing.assert_allclose(found.ravel(), surface, atol=1e-10)


def test_a_surface_does_not_depend_on_which_side_is_the_longer() -> None:
    rng = np.random.default_rng(2)
    height = rng.normal(0.0, 0.3, (5, 8))
    upright = smooth_surface(np.arange(40), height.ravel(), (5, 8), 2.0)
    turned = smooth_surface(np.arange(40), height.T.ravel(), (8, 5), 2.0)
    np.testing.assert_allclose(upright, turned.T, atol=1e-10)


def test_the_reach_alone_is_that_of_the_ground() -> None:
    rng = np.random.default_rng(3)
    ground = np.column_stack([rng.uniform(0.0, 8.0, (20_000, 2)), rng.normal(0.0, 0.01, 20_000)])
    crown = np.column_stack([rng.uniform(2.0, 6.0, (5_000, 2)), rng.uniform(3.0, 6.0, 5_000)])
    points = np.concatenate([ground[np.abs(ground[:, :2] - 4.0).max(axis=1) > 1.0], crown])
    reach = find_ground(points).reach
    assert reach_of(points) == reach
    assert 0.3 < reach < 1.0
    assert reach_of(np.arange(9.0).reshape(3, 3)) == 0.0


def test_a_surface_returns_to_what_it_is_held_to_where_nothing_was_seen() -> None:
    """Seen on a third of a strip, where it rises by 10 cm over the surface that it is held to."""
    shape = (3, 60)
    about = np.tile(0.05 * np.arange(60.0), (3, 1))
    cell = np.flatnonzero(np.tile(np.arange(60) < 20, 3))
    height = about.ravel()[cell] + 0.005 * (cell % 60)
    free = smooth_surface(cell, height - about.ravel()[cell], shape, 0.2, symmetric=True)
    held = smooth_surface(cell, height, shape, 0.2, symmetric=True, held_to=(about, 0.01))
    np.testing.assert_allclose((held - about)[:, :18], free[:, :18], atol=0.01)
    two_metres_on = 24  # cells of 0.4 m
    assert free[:, two_metres_on].min() > 0.08
    assert np.abs((held - about)[:, two_metres_on:]).max() < 0.02
