"""A stretch of the walk placed at another scale is found, a walk with a turn or a detour is not."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from fsinfer.poses.verification.scale_jumps import HALF_WINDOW, MIN_PHOTOS, strays


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
