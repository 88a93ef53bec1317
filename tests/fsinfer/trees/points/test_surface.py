"""Sectors round a stem."""

import numpy as np
import pytest

from fsinfer.trees.points.surface import LEAST_REACH_M, reach_about_wall, sector_of


@pytest.mark.parametrize("sectors", [8, 24, 36])
def test_sectors_go_round_once_from_minus_pi(sectors: int) -> None:
    middle = (np.arange(sectors) + 0.5) / sectors * 2.0 * np.pi - np.pi
    offsets = 0.2 * np.column_stack([np.cos(middle), np.sin(middle)])
    np.testing.assert_array_equal(sector_of(offsets, sectors), np.arange(sectors))
    # The angle pi itself belongs to the last.
    assert sector_of(np.array([[-1.0, 0.0]]), sectors).tolist() == [sectors - 1]


def test_reach_about_a_wall_follows_its_radius_between_two_limits() -> None:
    assert reach_about_wall(0.02, 0.12) == LEAST_REACH_M
    assert reach_about_wall(0.10, 0.12) == pytest.approx(0.08)
    assert reach_about_wall(0.50, 0.12) == 0.12
