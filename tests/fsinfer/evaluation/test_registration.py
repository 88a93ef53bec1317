"""Two maps of the same trees: partners by position, and the motion between their frames."""

from __future__ import annotations

import tracemalloc
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from fsinfer.evaluation.registration import apply, assign, register


def trees(count: int, seed: int) -> NDArray[np.float64]:
    """Positions (N, 2) at least a metre apart on 20 by 20 m."""
    rng = np.random.default_rng(seed)
    xy = [rng.uniform(0, 20, 2)]
    while len(xy) < count:
        place = rng.uniform(0, 20, 2)
        if np.linalg.norm(np.array(xy) - place, axis=1).min() > 1.0:
            xy.append(place)
    return np.array(xy)


def back(motion: NDArray[np.float64]) -> NDArray[np.float64]:
    """The motion that undoes ``motion``."""
    undone = np.array([-motion[0], 0.0, 0.0])
    undone[1:] = -apply(undone, motion[None, 1:])[0]
    return undone


@given(motion=st.tuples(st.floats(-3, 3), st.floats(-100, 100), st.floats(-100, 100)), seed=st.integers(0, 50))
def test_a_motion_turns_anticlockwise_then_shifts_and_keeps_distances(
    motion: tuple[float, float, float], seed: int
) -> None:
    xy = np.random.default_rng(seed).uniform(-5, 5, (6, 2))
    there = apply(np.array(motion), xy)
    plane = (xy @ [1, 1j]) * np.exp(1j * motion[0]) + complex(motion[1], motion[2])
    np.testing.assert_allclose(there, np.column_stack([plane.real, plane.imag]), atol=1e-10)
    np.testing.assert_allclose(apply(back(np.array(motion)), there), xy, atol=1e-10)


@pytest.mark.parametrize(("away", "seed"), [((0.1, 0.0, 0.0), 0), ((-2.9, 4e5, -30.0), 1), ((1.7, -8.0, 5e5), 2)])
def test_a_turned_and_shifted_map_with_losses_is_laid_back(away: tuple[float, float, float], seed: int) -> None:
    truth = trees(14, seed)
    rng = np.random.default_rng([seed, 1])
    # Two trees were missed, two false ones found, and places are off by 3 cm.
    seen = np.concatenate([truth[2:] + rng.normal(0, 0.03, (12, 2)), rng.uniform(0, 20, (2, 2))])
    found = apply(np.array(away), seen)
    motion = register(truth, found, 0.5)
    assert motion is not None
    laid = apply(motion, found)
    off = laid[:12] - truth[2:]
    assert np.linalg.norm(off, axis=1).max() < 0.15
    # All partners together decide, not the pair that was tried first.
    np.testing.assert_allclose(off.mean(axis=0), 0.0, atol=1e-6)
    assert {(i, i - 2) for i in range(2, 14)} <= set(assign(truth, laid, 0.5))


@pytest.mark.parametrize("seed", range(4))
def test_of_two_ways_that_find_all_partners_the_one_with_the_nearer_ones_is_taken(seed: int) -> None:
    # Turned by half, each of these trees comes to stand within 0.4 m of another one.
    half = np.array([[6.0, 1.0], [3.0, -5.0], [8.0, 7.0]])
    off = np.random.default_rng(seed).uniform(-0.2, 0.2, (6, 2))
    truth = np.concatenate([half, -half]) + off
    found = apply(np.array([0.8, 20.0, -7.0]), truth)
    assert len(assign(truth, -truth, 0.5)) == len(truth)
    motion = register(truth, found, 0.5)
    assert motion is not None
    np.testing.assert_allclose(apply(motion, found), truth, atol=1e-6)


def test_maps_that_hold_no_long_pair_are_not_laid() -> None:
    one, close = np.zeros((1, 2)), np.array([[0.0, 0.0], [0.5, 0.0]])
    assert register(one, close, 0.5) is None
    assert register(close, one, 0.5) is None
    assert register(close, close, 0.5) is None


def test_a_large_plot_is_laid_by_its_positions_alone() -> None:
    # 60 trees have some hundred thousand pairs of like lengths, of which few are tried.
    truth = trees(60, 3)
    rng = np.random.default_rng(4)
    seen = np.concatenate([truth[6:] + rng.normal(0, 0.05, (54, 2)), rng.uniform(-2, 22, (6, 2))])
    motion = register(truth, apply(np.array([2.1, 30.0, -4.0]), seen), 0.5)
    assert motion is not None
    laid = apply(motion, apply(np.array([2.1, 30.0, -4.0]), seen))
    assert np.linalg.norm(laid[:54] - truth[6:], axis=1).max() < 0.25


def test_hundreds_of_trees_need_little_memory() -> None:
    # 300 trees have some 10^8 pairs of like lengths.
    rng = np.random.default_rng(5)
    truth = rng.uniform(0, 45, (300, 2))
    found = apply(np.array([2.1, 30.0, -4.0]), truth + rng.normal(0, 0.05, truth.shape))
    tracemalloc.start()
    try:
        motion = register(truth, found, 0.5)
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert motion is not None
    assert np.linalg.norm(apply(motion, found) - truth, axis=1).max() < 0.25
    assert most < 100e6


@given(seed=st.integers(0, 500), limit=st.floats(0.1, 1.5))
def test_partners_are_the_most_pairs_and_then_the_nearest(seed: int, limit: float) -> None:
    rng = np.random.default_rng(seed)
    truth, found = rng.uniform(0, 2, (4, 2)), rng.uniform(0, 2, (4, 2))
    links = assign(truth, found, limit)
    distance = np.linalg.norm(truth[:, None] - found[None], axis=2)
    assert len({i for i, _ in links}) == len({j for _, j in links}) == len(links)
    all_ways = [
        [distance[i, j] for i, j in enumerate(way) if distance[i, j] <= limit] for way in permutations(range(4))
    ]
    most = max(len(way) for way in all_ways)
    assert len(links) == most
    assert sum(distance[i, j] for i, j in links) <= min(sum(way) for way in all_ways if len(way) == most) + 1e-9
    assert all(distance[i, j] <= limit for i, j in links)


def test_nothing_has_no_partners() -> None:
    assert assign(np.zeros((0, 2)), np.zeros((3, 2)), 1.0) == []
    assert assign(np.zeros((3, 2)), np.zeros((0, 2)), 1.0) == []
