"""Correlations between hypotheses that are looked up: exact where they were, near the truth where they are smooth."""

from __future__ import annotations

import pytest
import torch

from training.model.between import Between, spline_matrix
from training.model.packed import Refiner


@pytest.mark.parametrize(("count", "looked_up"), [(16, 8), (8, 6), (4, 2), (6, 6)])
def test_what_is_looked_up_stays_and_straight_lines_are_straight(count: int, looked_up: int) -> None:
    matrix = spline_matrix(count, looked_up)
    assert matrix.shape == (count, looked_up)
    line = torch.linspace(-3, 5, looked_up, dtype=torch.float64)
    torch.testing.assert_close(matrix @ line, torch.linspace(-3, 5, count, dtype=torch.float64))
    # The first and the last are the same hypotheses.
    values = torch.randn(looked_up, dtype=torch.float64)
    torch.testing.assert_close((matrix @ values)[[0, -1]], values[[0, -1]])


def test_a_smooth_peak_between_two_is_found() -> None:
    def peak(count: int) -> torch.Tensor:
        return torch.exp(-((torch.linspace(-1.5, 1.5, count, dtype=torch.float64) - 0.13) ** 2) / 0.6)

    matrix = spline_matrix(16, 8)
    assert float((matrix @ peak(8) - peak(16)).abs().max()) < 0.01
    assert int((matrix @ peak(8)).argmax()) == int(peak(16).argmax())


def test_sets_and_groups_stay_apart() -> None:
    between = Between(count=8, looked_up=6, sets=3)
    volume = torch.randn(3, 6, 4, 5, 7)
    found = between(volume.reshape(3 * 6 * 4, 5, 7)).reshape(3, 8, 4, 5, 7)
    for kind in range(3):
        for group in range(4):
            alone = Between(count=8, looked_up=6)(volume[kind, :, group].contiguous())
            torch.testing.assert_close(found[kind, :, group], alone)


def test_no_checkpoint_holds_the_matrix() -> None:
    refiner = Refiner(planes=16, looked_up=8, groups=2, features=8)
    assert not [name for name in refiner.state_dict() if "between" in name]
    # Its weights are those for all hypotheses, whatever is looked up.
    assert refiner.residual.weight.shape[1] == 32
