"""Markers tell by how much a camera draws edges beside where they are (markers of seed 44030)."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from fsinfer.scale.blooming import bloom_of, common_blooming, without_blooming
from fsinfer.scale.corners import refine_corners
from fsinfer.scale.detection import predefined_dictionary
from tests.support.printed_marker import marker_photo

PRINTED = predefined_dictionary("4X4_50")


def side_of(corners: NDArray[np.float64]) -> float:
    return float(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).mean())


def shifts(side_px: float, *, blur_px: float, gamma: float) -> tuple[list[float], list[float], list[float]]:
    """Of markers: how far edges stand outwards, what the markers tell of it, and what is left when that is undone."""
    rng = np.random.default_rng(44030)
    true, told, left = [], [], []
    for number in range(24):
        picture, corners = marker_photo(number, side_px, rng, blur_px=blur_px, gamma=gamma)
        found = refine_corners(picture, corners + rng.normal(0, 0.2, (4, 2)))
        shift = bloom_of(picture, found, number, PRINTED)
        if shift is not None:
            true.append((side_of(found) - side_of(corners)) / 2)
            told.append(shift)
            left.append((side_of(without_blooming(found, shift)) - side_of(corners)) / 2)
    return true, told, left


@pytest.mark.parametrize(("side_px", "blur_px"), [(36.0, 0.5), (50.0, 0.8), (80.0, 0.8)])
def test_white_that_bloomed_over_black_is_told_and_undone(side_px: float, blur_px: float) -> None:
    true, told, left = shifts(side_px, blur_px=blur_px, gamma=2.2)
    assert len(told) >= 12
    assert np.median(true) < -0.25
    assert np.median(told) == pytest.approx(np.median(true), abs=0.05)
    assert abs(np.median(left)) < 0.05


@pytest.mark.parametrize("side_px", [36.0, 60.0])
def test_edges_that_stand_where_they_are_stay_there(side_px: float) -> None:
    true, told, left = shifts(side_px, blur_px=0.7, gamma=1.0)
    assert len(told) >= 12
    assert abs(np.median(true)) < 0.02
    assert abs(np.median(told)) < 0.02
    assert abs(np.median(left)) < 0.02


def test_small_markers_and_flat_ones_tell_nothing() -> None:
    rng = np.random.default_rng(44030)
    picture, corners = marker_photo(3, 24.0, rng, blur_px=0.7)
    assert bloom_of(picture, corners, 3, PRINTED) is None
    picture, corners = marker_photo(3, 60.0, rng, blur_px=0.7)
    assert bloom_of(picture, corners, 3, PRINTED) is not None
    assert bloom_of((picture // 12 + 90).astype(np.uint8), corners, 3, PRINTED) is None
    # Beyond the edge of the picture there is nothing to measure.
    assert bloom_of(picture, corners + 70, 3, PRINTED) is None


@pytest.mark.parametrize("turn", [0, 1, 2, 3])
def test_a_marker_on_its_side_tells_the_same(turn: int) -> None:
    picture, corners = marker_photo(7, 60.0, np.random.default_rng(44030), blur_px=0.8, gamma=2.2)
    upright = bloom_of(picture, corners, 7, PRINTED)
    for _ in range(turn):
        # A quarter to the left: what was at the right comes to the top; the printed order stays.
        corners = np.column_stack([corners[:, 1], picture.shape[1] - 1 - corners[:, 0]])
        picture = np.ascontiguousarray(np.rot90(picture))
    turned = bloom_of(picture, corners, 7, PRINTED)
    assert upright is not None
    assert turned == pytest.approx(upright, abs=0.01)


@given(st.floats(-0.8, 0.8), st.floats(20, 90), st.floats(0, 6.28))
def test_every_edge_is_moved_by_the_shift(shift_px: float, side_px: float, turn: float) -> None:
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * side_px / 2
    turned = square @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    moved = without_blooming(turned, shift_px)
    assert side_of(moved) == pytest.approx(side_px - 2 * shift_px, abs=1e-6)
    np.testing.assert_allclose(moved.mean(axis=0), 0, atol=1e-6)


def test_sightings_are_taken_together() -> None:
    told = [-0.5, -0.52, None, -0.48, -0.5, 0.4, -0.51]
    blooming = common_blooming(told, fewest=5, least_std_px=0.03, varies=0.2)
    assert blooming is not None
    assert blooming.shift_px == pytest.approx(-0.5, abs=0.01)
    assert 0.1 < blooming.std_px < 0.12
    assert common_blooming(told, fewest=7, least_std_px=0.03, varies=0.2) is None
    still = common_blooming([0.0, 0.01, -0.01, 0.0, 0.0], fewest=5, least_std_px=0.03, varies=0.2)
    assert still is not None
    assert 0.03 <= still.std_px < 0.035
