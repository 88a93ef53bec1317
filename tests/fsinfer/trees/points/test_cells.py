"""Fast looks at points by cells, against the plain way of finding the same."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from fsinfer.trees.points.cells import (
    PlanIndex,
    cell_numbers,
    column_max,
    column_min,
    count_cells,
    near_paths,
    rows,
    taken,
    thin,
)
from fsinfer.trees.search.find import _rounds
from fsinfer.trees.search.hough import _REACH_CELLS, _moments


def test_points_near_a_place_are_all_found() -> None:
    points = np.random.default_rng(0).uniform([-5.0, -3.0, 0.0], [5.0, 3.0, 1.0], (4000, 3))
    # Few cells and many: their numbers are sorted in 16 bits and in more.
    for cell_m in (1.0, 0.01):
        index = PlanIndex(points, cell_m)
        for place in ([0.0, 0.0], [4.9, -2.9], [-4.9, 2.9], [9.0, 0.0]):
            away = np.hypot(points[:, 0] - place[0], points[:, 1] - place[1])
            found = index.near(np.array(place), 0.7)
            assert {tuple(p) for p in found} == {tuple(p) for p in points[away <= 0.7]}


def test_no_point_near_a_path_is_left_out() -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform(-3.0, 3.0, (20000, 3))
    starts, ends = rng.uniform(-3.5, 3.5, (6, 2)), rng.uniform(-3.5, 3.5, (6, 2))
    ends[0] = starts[0]
    starts[1], ends[1] = (3.0, 3.0), (0.0, 0.0)
    share = np.linspace(0.0, 1.0, 600)[:, None]
    path = np.concatenate([a + share * (b - a) for a, b in zip(starts, ends, strict=True)])
    away = cKDTree(path).query(points[:, :2])[0]
    near = near_paths(points, starts, ends, 0.5, cell_m=0.1)
    assert near[away <= 0.5].all()
    assert not near[away > 1.0].any()


def test_nothing_is_near_no_path() -> None:
    none = np.zeros((0, 2))
    assert not near_paths(np.ones((3, 3)), none, none, 1.0).any()
    assert near_paths(np.zeros((0, 3)), np.zeros((1, 2)), np.zeros((1, 2)), 1.0).shape == (0,)


def test_cells_are_counted_once() -> None:
    points = np.random.default_rng(2).uniform(-1.0, 1.0, (500, 2))
    assert count_cells(points, 0.1) == len(np.unique(np.floor(points / 0.1), axis=0))
    assert count_cells(points[:0], 0.1) == 0


def test_cells_have_numbers_of_their_own_that_are_not_negative_wherever_the_points_lie() -> None:
    points = np.random.default_rng(2).uniform(-1.0, 1.0, (500, 2))
    for moved in (points, points - 7.0, points + 7.0, points * [1.0, 30.0]):
        numbers = cell_numbers(moved, 0.25)
        cells = np.floor(moved / 0.25)
        same = (cells[:, None] == cells[None]).all(axis=2)
        assert numbers.min() >= 0
        assert ((numbers[:, None] == numbers[None]) == same).all()


def test_columns_have_the_bounds_of_numpy() -> None:
    points = np.random.default_rng(3).normal(0.0, 1.0, (100, 3))
    np.testing.assert_array_equal(column_min(points), points.min(axis=0))
    np.testing.assert_array_equal(column_max(points), points.max(axis=0))


def test_thinning_keeps_the_first_of_each_cell() -> None:
    points = np.random.default_rng(4).uniform(0.0, 1.0, (3000, 3))
    cells = np.floor((points - points.min(axis=0)) / 0.1).astype(int)
    first = np.sort(np.unique(cells, axis=0, return_index=True)[1])
    np.testing.assert_array_equal(thin(points, 0.1), points[first])


def test_moments_of_a_grid_are_those_of_a_search_for_neighbours() -> None:
    rng = np.random.default_rng(5)
    reach, side = int(_REACH_CELLS), 40
    filled = np.zeros((side, side), dtype=np.uint8)
    inner = filled[reach:-reach, reach:-reach]
    inner[rng.random(inner.shape) < 0.2] = 1
    inner[inner > 0] = rng.integers(1, 6, int(inner.sum()))
    key = np.flatnonzero(filled)
    moments, count = _moments(filled.ravel(), key, side)
    cells = np.column_stack([key // side, key % side]).astype(np.float64)
    near = cKDTree(cells).query_ball_point(cells, _REACH_CELLS)
    for row, own in enumerate(near):
        offset, weight = cells[own] - cells[row], filled.ravel()[key[own]]
        x, y = offset.T
        plain = [(weight * v).sum() for v in (np.ones(len(x)), x, y, x**2, y**2, x * y)]
        np.testing.assert_allclose(moments[row], plain)
        assert count[row] == len(own)


def test_rounds_hold_every_place_once_and_none_before_its_stronger_neighbour() -> None:
    xy = np.random.default_rng(6).uniform(0.0, 3.0, (200, 2))
    rounds = list(_rounds(xy, 0.3))
    assert sorted(np.concatenate(rounds).tolist()) == list(range(200))
    number = np.empty(200, dtype=int)
    for this, places in enumerate(rounds):
        number[places] = this
    apart = np.linalg.norm(xy[:, None] - xy[None], axis=2)
    first, second = np.nonzero(np.triu(apart < 0.3, 1))
    assert (number[first] < number[second]).all()
    assert len(list(_rounds(np.zeros((0, 2)), 0.3))) == 0


def test_rows_are_those_of_numpy_in_both_orders() -> None:
    rng = np.random.default_rng(7)
    points, chosen, order = rng.normal(0.0, 1.0, (100, 3)), rng.random(100) < 0.3, rng.permutation(100)
    for same in (points, np.asfortranarray(points), np.asfortranarray(points)[:, :2], points[::2]):
        np.testing.assert_array_equal(rows(same, chosen[: len(same)]), same[chosen[: len(same)]])
        np.testing.assert_array_equal(taken(same, order[order < len(same)]), same[order[order < len(same)]])
