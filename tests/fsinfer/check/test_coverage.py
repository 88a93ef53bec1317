"""Which walks are lines, beside which all can be walked round, and which have an inside."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.check.coverage import within_walk

TURN = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
ALONG = np.linspace(0.0, 30.0, 40)


@pytest.mark.parametrize(
    ("along", "across", "line"),
    [
        (ALONG, 0.3 * np.sin(7.0 * ALONG), True),
        (ALONG, 1.0 * np.sin(np.pi * ALONG / 30.0), True),
        (ALONG, 5.0 * np.sin(np.pi * ALONG / 30.0), False),  # a bend has one side within
        (ALONG, 3.0 * (np.arange(40) % 2), False),  # on both sides of a path
        (6.0 * np.cos(TURN), 6.0 * np.sin(TURN), False),
        (0.9 * np.cos(TURN), 0.9 * np.sin(TURN), False),  # round one tree
        (0.1 * np.cos(TURN), 0.1 * np.sin(TURN), False),
    ],
    ids=["walked", "slight bend", "bend", "both sides", "plot", "one tree", "spot"],
)
def test_only_beside_a_line_stems_count_that_nothing_encloses(
    along: NDArray[np.float64], across: NDArray[np.float64], line: bool
) -> None:
    cameras = np.column_stack([along, across])
    turn = np.radians(33.0)
    turned = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    beside, far = np.array([along.mean(), across.min() - 4.0]), np.array([along.mean(), across.min() - 20.0])
    assert within_walk(cameras @ turned.T, np.array([beside, far]) @ turned.T).tolist() == [line, False]
