"""A stretch of the walk placed at another scale is found, a walk with a turn or a detour is not."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from fsinfer.poses.verification.scale_jumps import HALF_WINDOW, MIN_PHOTOS, shrunk, strays


def ring(photos: int, step: float = 0.5) -> NDArray[np.float64]:
    angle = np.arange(photos) * step / 8.0
    rng = np.random.default_rng(photos)
    return np.stack([8 * np.cos(angle), 8 * np.sin(angle), 0 * angle], -1) + rng.normal(0, 0.05, (photos, 3))


@given(st.integers(60, 120), st.integers(25, 40), st.sampled_from([0.05, 0.08, 12.0, 26.0]), st.floats(0.01, 100))
def test_a_stretch_at_another_scale_is_found(before: int, after: int, scale: float, unit: float) -> None:
    centers = np.concatenate([ring(before), [3.0, 1.0, 0.0] + scale * ring(after)]) * unit
    found = strays(centers, np.arange(before + after))
    assert found[before + HALF_WINDOW :].all()
    assert not found[: before - HALF_WINDOW].any()


def test_a_gap_before_the_stretch_does_not_hide_it() -> None:
    centers = np.concatenate([ring(158), 26.0 * ring(39)])
    order = np.concatenate([np.arange(158), np.arange(161, 200)])
    found = strays(centers, order)
    assert found[158 + HALF_WINDOW :].all()
    assert not found[:153].any()


@pytest.mark.parametrize("photos", [MIN_PHOTOS, 130])
def test_an_even_walk_has_none(photos: int) -> None:
    assert not strays(ring(photos), np.arange(photos)).any()


def test_photos_in_any_order_have_none() -> None:
    shuffled = np.random.default_rng(0).permutation(ring(100))
    assert not strays(shuffled, np.arange(100)).any()


def test_few_photos_and_equal_parts_are_left_alone() -> None:
    assert not strays(np.concatenate([ring(20), 30 * ring(MIN_PHOTOS - 21)]), np.arange(MIN_PHOTOS - 1)).any()
    assert not strays(np.zeros((60, 3)), np.arange(60)).any()


def test_four_photos_on_the_spot_are_no_stray_stretch() -> None:
    centers = ring(100)
    centers[50:54] = centers[50]
    assert not strays(centers, np.arange(100)).any()


def test_pieces_of_a_falsely_joined_part_go_with_it() -> None:
    lost = np.array([9.0, 0.0, 0.0]) + ring(20)  # the right scale in the wrong place
    centers = np.concatenate([ring(120), 15.0 * ring(20), lost, 13.0 * ring(15)])
    found = strays(centers, np.arange(len(centers)))
    assert found[120 + HALF_WINDOW :].all()
    assert not found[: 120 - HALF_WINDOW].any()


def test_a_second_walk_elsewhere_is_none() -> None:
    centers = np.concatenate([ring(100), np.array([30.0, 0.0, 0.0]) + ring(30)])
    assert not strays(centers, np.arange(130)).any()


def collapsed(photos: int, begin: int, end: int) -> NDArray[np.float64]:
    """A straight walk whose photos from ``begin`` to before ``end`` were placed in order within a hand's breadth."""
    centers = np.stack([0.5 * np.arange(photos), np.zeros(photos), np.zeros(photos)], -1)
    centers[begin:end] = centers[end - 1] + 0.02 * (np.arange(begin, end) - end + 1)[:, None] * [1.0, 0.0, 0.0]
    return centers


@pytest.mark.parametrize(("begin", "end"), [(20, 27), (30, 33), (0, 6), (54, 60)])
@pytest.mark.parametrize("unit", [1.0, 17.0])
def test_a_stretch_that_shrank_is_found_by_what_moves_in_its_photos(begin: int, end: int, unit: float) -> None:
    centers = unit * collapsed(60, begin, end)
    found = shrunk(centers, np.arange(60), np.full(59, 25.0))
    assert np.flatnonzero(found).tolist() == list(range(begin, end))
    # Who stands there and turns sees nothing move beside the turn; of photos without matches nothing is known.
    for still in (1.0, np.nan):
        parallax = np.full(59, 25.0)
        parallax[begin : end - 1] = still
        assert not shrunk(centers, np.arange(60), parallax).any()


def test_two_near_photos_and_a_walk_of_few_are_no_shrunk_stretch() -> None:
    assert not shrunk(collapsed(60, 20, 22), np.arange(60), np.full(59, 25.0)).any()
    few = MIN_PHOTOS - 1
    assert not shrunk(collapsed(few, 20, 27), np.arange(few), np.full(few - 1, 25.0)).any()
    assert not shrunk(np.zeros((60, 3)), np.arange(60), np.full(59, np.nan)).any()


def test_photos_that_are_missing_share_the_way_over_the_gap() -> None:
    order = np.r_[np.arange(22), np.arange(23, 60)]
    centers = collapsed(60, 20, 27)[order]
    parallax = np.full(58, 25.0)
    parallax[21] = 50.0
    assert np.flatnonzero(shrunk(centers, order, parallax)).tolist() == list(range(20, 26))
