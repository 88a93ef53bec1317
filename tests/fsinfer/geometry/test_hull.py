"""The area that places in the plan enclose: a convex hull with a margin."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from fsinfer.geometry.hull import in_hull


@given(
    corners=st.integers(3, 9),
    turn=st.floats(0, 6.3),
    size_m=st.floats(1, 50),
    margin_m=st.floats(0, 5),
    seed=st.integers(0, 99),
)
def test_the_margin_is_kept_on_every_side(corners: int, turn: float, size_m: float, margin_m: float, seed: int) -> None:
    angle = turn + 2 * np.pi * np.arange(corners) / corners
    at = np.array([-300.0, 70.0])
    polygon = at + size_m * np.column_stack([np.cos(angle), np.sin(angle)])
    # Places inside of the polygon, which are no corners of the hull, change nothing.
    inner = at + 0.3 * size_m * np.random.default_rng(seed).uniform(-1, 1, (5, 2)) / np.sqrt(2) * np.cos(
        np.pi / corners
    )
    middle = angle + np.pi / corners
    outward = np.column_stack([np.cos(middle), np.sin(middle)])
    side_m = size_m * np.cos(np.pi / corners)
    for off_m, expected in ((-0.01, True), (margin_m - 0.01, True), (margin_m + 0.01, False)):
        places = at + (side_m + off_m) * outward
        assert (in_hull(np.concatenate([inner, polygon]), places, margin_m) == expected).all()


@pytest.mark.parametrize(
    "corners",
    [np.zeros((0, 2)), np.array([[0.0, 0], [1, 1]]), np.column_stack([np.arange(5.0), 2 * np.arange(5.0)])],
    ids=["none", "two", "on a line"],
)
def test_corners_that_enclose_nothing_keep_nothing_out(corners: NDArray[np.float64]) -> None:
    assert in_hull(corners, np.array([[1e6, -1e6], [0.0, 0.0]]), 0.0).tolist() == [True, True]


def test_no_places() -> None:
    assert in_hull(np.array([[0.0, 0], [1, 0], [0, 1]]), np.zeros((0, 2)), 1.0).shape == (0,)
