"""Which boards agree: a wrong print is outvoted however near it is seen, and never moves the others."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsinfer.scale.agreement import agreement, markers_of_boards
from fsinfer.scale.square_fit import MarkerSettings

SETTINGS = MarkerSettings()


@pytest.mark.parametrize("wrong", [0.8, 0.94, 1.06, 1.41])
@pytest.mark.parametrize("near", [0.0002, 0.002])
def test_two_boards_outvote_a_third_however_sharp(wrong: float, near: float) -> None:
    found = agreement(np.array([1.001, wrong, 0.999]), np.array([0.004, near, 0.004]), SETTINGS)
    assert found.agrees.tolist() == [True, False, True]
    assert found.decided
    assert found.value == pytest.approx(1.0, abs=1e-4)
    assert found.rel_std < 0.01


def test_two_boards_that_contradict_each_other_are_in_the_interval() -> None:
    found = agreement(np.array([1.0, 1.06]), np.array([0.001, 0.001]), SETTINGS)
    assert found.agrees.all()
    assert not found.decided
    assert abs(found.value - 1.0) < 1.96 * found.rel_std
    assert abs(found.value - 1.06) < 1.96 * found.rel_std
    # And so are all where each says something else.
    found = agreement(np.array([0.9, 1.0, 1.1]), np.full(3, 0.001), SETTINGS)
    assert found.agrees.all()
    assert not found.decided
    assert found.rel_std > 0.05


def test_boards_of_a_warped_model_do_not_contradict_each_other() -> None:
    found = agreement(np.array([1.0, 1.006, 0.994, 1.012]), np.full(4, 0.001), SETTINGS)
    assert found.agrees.all()
    assert found.decided
    # Those that are known badly may lie farther off.
    assert agreement(np.array([1.0, 1.06]), np.array([0.001, 0.02]), SETTINGS).decided


@pytest.mark.parametrize("turned", [False, True])
def test_of_two_pairs_that_share_a_board_the_surer_counts(turned: bool) -> None:
    # The outer two contradict each other, and the one between them either neither; it is by far the surest.
    scales, stds = np.array([0.98, 1.0, 1.02]), np.array([0.004, 0.0005, 0.003])
    if turned:
        scales, stds = 2.0 - scales, stds
    found = agreement(scales, stds, SETTINGS)
    assert found.agrees.tolist() == [False, True, True]
    assert found.decided


@given(
    scales=st.lists(st.floats(0.9, 1.1), min_size=1, max_size=8),
    seed=st.integers(0, 1000),
)
def test_the_order_and_the_unit_do_not_matter(scales: list[float], seed: int) -> None:
    values = np.unique(scales)
    stds = np.random.default_rng(seed).uniform(0.001, 0.02, len(values))
    found = agreement(values, stds, SETTINGS)
    order = np.random.default_rng(seed).permutation(len(values))
    turned = agreement(7.0 * values[order], stds[order], SETTINGS)
    assert turned.agrees.tolist() == found.agrees[order].tolist()
    assert turned.value == pytest.approx(7.0 * found.value)
    assert turned.rel_std == pytest.approx(found.rel_std)
    assert values.min() <= found.value <= values.max() or found.value == pytest.approx(values.min())


def test_both_faces_of_a_board_are_one_opinion() -> None:
    centers = np.array([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0], [0.0, 0.0, 0.01], [5.0, 0.1, 0.0], [5.0, 3.0, 0.0]])
    normals = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
    # Side by side is not back to back, and neither is what looks at each other from afar.
    numbers = list(range(5))
    assert markers_of_boards(numbers, centers, normals, np.full(5, 0.2)) == [[0, 2], [1], [3], [4]]
    assert markers_of_boards(numbers, centers, np.full((5, 3), np.nan), np.full(5, 0.2)) == [[0], [1], [2], [3], [4]]


def test_a_board_that_a_drift_shows_twice_is_one_opinion() -> None:
    centers = np.array([[0.0, 0.0, 0.0], [0.2, 0.0, 0.0], [0.0, 0.0, 0.01], [0.1, 0.0, 0.0], [5.0, 0.0, 0.0]])
    normals = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    sides = np.full(5, 0.15)
    # Its other face belongs to it, too. What looks elsewhere or stands far away is another one of that number.
    assert markers_of_boards([21, 21, 22, 21, 21], centers, normals, sides) == [[0, 1, 2], [3], [4]]
    # Another number beside it is another board.
    assert markers_of_boards([21, 22, 23, 24, 25], centers, normals, sides) == [[0, 2], [1], [3], [4]]
