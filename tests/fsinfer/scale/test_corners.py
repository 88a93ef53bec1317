"""Corners of blurred squares, to a twentieth of a pixel where the edges can be followed."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.scale.corners import refine_corners

SIZE, FINE = 120, 8


def square(
    side_px: float, turn_deg: float, blur_px: float, at: tuple[float, float]
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Picture of a dark square, and its corners (4, 2), clockwise as seen; pixel centres lie at integers."""
    angle = np.radians(turn_deg) + np.radians([225, 315, 45, 135])
    corners = np.array(at) + side_px / np.sqrt(2) * np.column_stack([np.cos(angle), np.sin(angle)])
    fine = (np.arange(SIZE * FINE) + 0.5) / FINE - 0.5
    u, v = np.meshgrid(fine, fine)
    outside = np.zeros_like(u, dtype=bool)
    for (x, y), (to_x, to_y) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        outside |= (to_x - x) * (v - y) - (to_y - y) * (u - x) < 0
    exact = np.where(outside, 210.0, 40.0).reshape(SIZE, FINE, SIZE, FINE).mean(axis=(1, 3))
    return np.rint(cv2.GaussianBlur(exact, (0, 0), blur_px)).astype(np.uint8), corners


@pytest.mark.parametrize(
    ("side_px", "turn_deg", "blur_px"), [(26.0, 3.0, 0.7), (35.0, 40.0, 1.2), (50.0, -80.0, 1.5), (70.0, 170.0, 1.0)]
)
def test_corners_half_a_pixel_off_are_moved_onto_the_blurred_square(
    side_px: float, turn_deg: float, blur_px: float
) -> None:
    x, y, seed = 59.3, 60.6, round(side_px)
    picture, corners = square(side_px, turn_deg, blur_px, (x, y))
    off = np.random.default_rng(seed).uniform(-0.5, 0.5, (4, 2))
    found = refine_corners(picture, corners + off)
    assert np.linalg.norm(found - corners, axis=1).max() < 0.08
    # The side is what the scale is taken from: within a thousandth and a half, where blur would make it shorter.
    sides = np.linalg.norm(found - np.roll(found, 1, axis=0), axis=1)
    assert abs(sides.mean() / side_px - 1) < 0.0015


def test_a_corner_whose_edge_is_covered_stays_where_it_was() -> None:
    picture, corners = square(50, 10, 1.0, (60, 60))
    # A leaf over most of the edge from the first to the second corner: neither of the two can be improved.
    middle = (corners[0] + corners[1]) / 2
    cv2.circle(picture, (round(middle[0]), round(middle[1])), 20, (125.0,), -1)
    start = corners + np.array([0.4, -0.3])
    found = refine_corners(picture, start)
    np.testing.assert_array_equal(found[:2], start[:2])
    assert np.linalg.norm(found[2:] - corners[2:], axis=1).max() < 0.1


def test_a_scratch_beside_an_edge_is_not_taken_for_it() -> None:
    picture, corners = square(50, 0, 0.8, (60, 60))
    left, top = np.rint(corners[0]).astype(int)
    picture[top + 3, left + 5 : left + 46] = 210
    found = refine_corners(picture, corners + 0.3)
    np.testing.assert_array_equal(found[:2], corners[:2] + 0.3)
    assert np.linalg.norm(found[2:] - corners[2:], axis=1).max() < 0.1


def test_a_square_at_the_border_or_without_contrast_stays() -> None:
    _, corners = square(50, 0, 1.0, (60, 60))
    grey = np.full((SIZE, SIZE), 128, np.uint8)
    np.testing.assert_array_equal(refine_corners(grey, corners), corners)
    picture, corners = square(50, 0, 1.0, (26, 60))
    # The edge at the border cannot be followed: its two corners stay, the others are improved.
    found = refine_corners(picture, corners + 0.3)
    np.testing.assert_array_equal(found[[0, 3]], corners[[0, 3]] + 0.3)
    assert np.linalg.norm(found[[1, 2]] - corners[[1, 2]], axis=1).max() < 0.1


def test_a_corner_is_never_moved_far() -> None:
    # The lines of a square that is much smaller than what was detected meet far from the corners given.
    picture, corners = square(50, 0, 1.0, (60, 60))
    start = 60 + (corners - 60) * 1.2
    found = refine_corners(picture, start)
    assert np.linalg.norm(found - start, axis=1).max() <= max(1.5, 0.08 * 60)
