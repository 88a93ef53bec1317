"""What the word of points counts that err together."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.trees.points.errors import SIDES, TOGETHER, worth_of_word

UPRIGHT = np.array([2.0, 3.0, 0.0, 0.0, 0.15, 0.0])


def _side(azimuth_deg: float, count: int, std_m: float) -> NDArray[np.float64]:
    angle = np.radians(azimuth_deg)
    place = UPRIGHT[:2] + UPRIGHT[4] * np.array([np.cos(angle), np.sin(angle)])
    return np.tile([*place, 1.3, std_m, 0.0], (count, 1))


def test_a_side_of_many_counts_little_more_than_one_of_few() -> None:
    points = np.concatenate([_side(7.0, 10, 0.001), _side(97.0, 1000, 0.001)])
    worth = worth_of_word(points, UPRIGHT, 1.3)
    few, many = worth[:10].sum(), worth[10:].sum()
    assert few == pytest.approx(10 / (1 + 10 * TOGETHER**2))
    assert many < 1 / TOGETHER**2
    assert many < 2.5 * few


def test_sharp_and_hazy_points_of_a_side_do_not_err_together() -> None:
    sharp, hazy = _side(7.0, 50, 0.001), _side(7.0, 500, 0.016)
    alone = worth_of_word(sharp, UPRIGHT, 1.3)
    assert worth_of_word(np.concatenate([sharp, hazy]), UPRIGHT, 1.3)[:50] == pytest.approx(alone)
    # Alike sure, they do.
    assert worth_of_word(np.concatenate([sharp, sharp]), UPRIGHT, 1.3)[0] < 0.6 * alone[0]


def test_of_four_times_the_haze_two_factors_of_two_err_apart() -> None:
    haze = np.geomspace(0.008, 0.032, 600)
    points = np.concatenate([_side(7.0, 1, std_m) for std_m in haze])
    words = worth_of_word(points, UPRIGHT, 1.3).sum() * TOGETHER**2
    # Those about 8, 16 and 32 mm: a side of points that are all alike sure tells one word.
    assert 2.0 < words < 3.0


def test_sides_are_those_about_a_leaning_axis() -> None:
    lean = UPRIGHT.copy()
    lean[2:4] = 0.5, -0.2
    up = _side(7.0, 20, 0.002)
    up[:, :2] += 0.8 * lean[2:4]
    up[:, 2] += 0.8
    both = np.concatenate([_side(7.0, 20, 0.002), up])
    assert worth_of_word(both, lean, 1.3) == pytest.approx(1 / (1 + 40 * TOGETHER**2))
    assert pytest.approx(15.0) == 360 / SIDES


def test_points_that_tell_nothing_count_in_full() -> None:
    assert worth_of_word(_side(7.0, 30, 0.001)[:, :3], UPRIGHT, 1.3).tolist() == [1.0] * 30
