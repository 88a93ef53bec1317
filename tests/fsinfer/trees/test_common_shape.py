"""What stems that were seen all round say of the others' hidden sides."""

from __future__ import annotations

import numpy as np
import pytest

from fsinfer.trees.common_shape import common_shape
from fsinfer.trees.diameter.roundness import Harmonic


def ovals(rng: np.random.Generator, factor: float, stems: int, error: float = 0.2) -> list[Harmonic]:
    return [
        Harmonic(amplitude=rng.normal(0.0, np.hypot(factor, error), 2), covariance=error**2 * np.eye(2))
        for _ in range(stems)
    ]


@pytest.mark.parametrize("factor", [1.0, 1.5, 2.5])
def test_a_plots_factor_comes_back(factor: float) -> None:
    rng = np.random.default_rng(0)
    found = [common_shape(ovals(rng, factor, 25)) for _ in range(40)]
    assert np.mean(found) == pytest.approx(factor, rel=0.1)


def test_a_thousand_stems_are_as_good_as_a_few() -> None:
    assert common_shape(ovals(np.random.default_rng(5), 2.0, 1000)) == pytest.approx(2.0, rel=0.06)


def test_stems_rounder_than_usual_take_nothing_off() -> None:
    assert common_shape(ovals(np.random.default_rng(1), 0.3, 25)) == 1.0


def test_errors_are_not_taken_for_shape() -> None:
    """Round stems whose harmonics are known to two usual standard deviations only."""
    rng = np.random.default_rng(2)
    assert np.mean([common_shape(ovals(rng, 0.5, 25, error=0.9)) for _ in range(20)]) < 1.1


def test_few_stems_say_little_and_none_next_to_nothing() -> None:
    rng = np.random.default_rng(3)
    two = np.mean([common_shape(ovals(rng, 2.5, 2)) for _ in range(200)])
    assert 1.2 < two < 2.0
    assert 1.0 < common_shape([]) < 1.25


def test_one_odd_stem_makes_no_odd_plot() -> None:
    rng = np.random.default_rng(4)
    usual = ovals(rng, 1.0, 12)
    odd = Harmonic(amplitude=np.array([9.0, 0.0]), covariance=0.04 * np.eye(2))
    assert common_shape([*usual, odd]) < common_shape(usual) + 0.35
