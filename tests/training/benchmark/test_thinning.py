"""Thinning to a least distance, against the plain loop that defines it."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from training.benchmark.thinning import spatial_order, thin


def one_by_one(points: NDArray[np.float64], distance: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    """The benchmark's definition: in random order, a point stays and takes away all that lie within the distance."""
    left = np.ones(len(points), dtype=bool)
    for i in rng.permutation(len(points)):
        if left[i]:
            left[np.linalg.norm(points - points[i], axis=1) <= distance] = False
            left[i] = True
    return left


@pytest.mark.parametrize("extent", [0.5, 3.0, 30.0])
def test_it_chooses_what_the_loop_chooses(extent: float) -> None:
    points = np.random.default_rng(1).uniform(0, extent, (5000, 3)) * (1, 1, 0.05)
    chosen = thin(points, 0.2, np.random.default_rng(7))
    np.testing.assert_array_equal(chosen, one_by_one(points, 0.2, np.random.default_rng(7)))
    assert 0 < chosen.sum() < 5000


def test_a_distance_equal_to_the_least_one_is_too_near() -> None:
    points = np.arange(3000.0)[:, None] * (1, 0, 0)
    assert thin(points, np.nextafter(1.0, 0), np.random.default_rng(0)).all()
    chosen = np.flatnonzero(thin(points, 1.0, np.random.default_rng(0)))
    assert set(np.diff(chosen)) == {2, 3}  # no two neighbours stay, and no gap has room for another


def test_thousands_of_equal_points_leave_one() -> None:
    points = np.zeros((20_000, 3))
    points[0] = 1e9  # far beyond the grid of spatial_order
    chosen = thin(points, 0.2, np.random.default_rng(0))
    assert chosen[0]
    assert chosen.sum() == 2


def test_no_points_and_other_seeds() -> None:
    assert thin(np.empty((0, 3)), 0.2, np.random.default_rng(0)).shape == (0,)
    points = np.random.default_rng(1).uniform(0, 1, (500, 3))
    assert (thin(points, 0.2, np.random.default_rng(0)) != thin(points, 0.2, np.random.default_rng(1))).any()


def test_spatial_order_keeps_cells_together() -> None:
    points = np.random.default_rng(0).uniform(0, 2, (100, 3))
    cells = [tuple(row) for row in np.floor(points - points.min(axis=0))[spatial_order(points, 1.0)]]
    changes = sum(a != b for a, b in pairwise(cells))
    assert changes == len(set(cells)) - 1
