"""Sides of the plot that no photo stands on."""

from __future__ import annotations

import numpy as np
import pytest

from fsinfer.check.open_sides import open_sides


def test_open_sides() -> None:
    angles = np.radians(np.arange(0, 360, 4))
    circle = 8 * np.column_stack([np.cos(angles), np.sin(angles)])
    assert open_sides(circle) == []
    # A quarter left out; photos of a second, smaller round do not close it.
    side = open_sides(np.concatenate([circle[:68], circle[::5] / 2]))
    assert [entry.photos for entry in side] == [(0, 67)]
    assert side[0].length_m == pytest.approx(2 * 8 * np.sin(np.radians(46)), rel=1e-6)
    np.testing.assert_array_equal(
        side[0].beyond(np.array([[5.0, -5.0], [0.0, 0.0], [20.0, -20.0]])), [True, False, False]
    )
    # However the plan is turned: rounding may put a corner beyond the end of its own edge.
    for turn in np.linspace(0.0, 6.0, 50):
        rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        assert [entry.photos for entry in open_sides(circle[:68] @ rotation.T)] == [(0, 67)]
    # There and back on a line, and too few photos: no inside, no side.
    line = np.column_stack([np.arange(0, 20, 0.5), np.zeros(40)])
    assert open_sides(line) == open_sides(line[:2]) == []
    # A walk along the sides of a square, its corners cut: photos on every side.
    step = np.arange(0.5, 10, 0.5)
    zero = np.zeros_like(step)
    square = np.concatenate(
        [np.column_stack(pair) for pair in ((step, zero), (zero + 10, step), (10 - step, zero + 10), (zero, 10 - step))]
    )
    assert open_sides(square) == []
