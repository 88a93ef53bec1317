"""The candidates of a pixel against their definition, and against those that the network was trained with."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from fsinfer.depth.candidates import candidate_planes, hints, spread_indices
from training.model import candidates as trained

Float32 = NDArray[np.float32]
SHAPES = [(17, 26), (18, 25), (18, 26), (17, 25)]


def index_of(seed: int) -> Float32:
    """(9, 13) plane indices: a slanted surface, a stem before it, and noise."""
    rng = np.random.default_rng(seed)
    index = 20 + 0.3 * np.arange(13) + rng.normal(0, 0.1, (9, 13))
    index[:, 6] += 90
    return index.astype(np.float32)


@given(seed=st.integers(0, 99), shape=st.sampled_from(SHAPES))
def test_candidates_stand_round_the_own_cell_and_the_extremes_of_the_nine(seed: int, shape: tuple[int, int]) -> None:
    index = index_of(seed)
    planes = candidate_planes(spread_indices(index, *shape), around=4, step=0.5).reshape(3, 4, *shape)
    np.testing.assert_allclose(np.diff(planes, axis=1), 0.5, atol=1e-5)
    own, least, greatest = planes.mean(axis=1)
    for row in range(shape[0]):
        for column in range(shape[1]):
            cell = row // 2, column // 2
            nine = index[max(0, cell[0] - 1) : cell[0] + 2, max(0, cell[1] - 1) : cell[1] + 2]
            assert least[row, column] == pytest.approx(nine.min(), abs=1e-3)
            assert greatest[row, column] == pytest.approx(nine.max(), abs=1e-3)
            # Between two surfaces there is none: the own index stays within a plane of the cell's.
            assert abs(own[row, column] - index[cell]) <= 1 + 1e-3
    # On even pixels the cell's own, between two of one surface their mean.
    np.testing.assert_allclose(own[::2, ::2], index[: (shape[0] + 1) // 2, : (shape[1] + 1) // 2], atol=1e-3)
    assert own[0, 1] == pytest.approx((index[0, 0] + index[0, 1]) / 2, abs=1e-3)


@pytest.mark.parametrize("shape", SHAPES)
def test_candidates_and_hints_are_those_of_the_training(shape: tuple[int, int]) -> None:
    index, confidence = index_of(7), np.random.default_rng(0).random((9, 13), np.float32)
    planes = candidate_planes(spread_indices(index, *shape), around=trained.AROUND, step=trained.STEP)
    expected = trained.candidate_planes(trained.spread_indices(torch.from_numpy(index), *shape))
    np.testing.assert_allclose(planes, expected.numpy(), atol=1e-4)
    told = trained.hints(expected, torch.from_numpy(confidence)).numpy()
    found = hints(planes, confidence)
    np.testing.assert_allclose(found, told, atol=1e-5)
    # Far from the stem nothing else is near; beside it something is, to one side.
    assert found[:2, 0, 0].max() < 0.2
    assert found[1, 0, 10] == pytest.approx(1.0)
    assert found[0, 0, 12] == pytest.approx(1.0)
