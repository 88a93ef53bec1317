"""Two walls of one stem: copies of it a shift apart are told from bark that stands off, whichever way they lie."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.trees.diameter.double_wall import TwoWalls, two_walls

RADIUS, SIGMA = 0.2, 0.004


def ring(seed: int, radius: float = RADIUS, *, middle: NDArray[np.float64] | None = None) -> NDArray[np.float64]:
    rng = np.random.default_rng(seed)
    angle, from_middle = rng.uniform(0.0, 2.0 * np.pi, 3000), radius + rng.normal(0.0, SIGMA, 3000)
    points = from_middle[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    return np.asarray(points if middle is None else points + middle)


def walls_of(points: NDArray[np.float64], radius: float) -> TwoWalls:
    """By the residuals of a circle about the origin."""
    return two_walls(points, np.hypot(*points.T) - radius, SIGMA)


@pytest.mark.parametrize("way_deg", range(0, 360, 30))
def test_a_stem_scanned_twice_is_a_shift_whichever_way_it_goes(way_deg: int) -> None:
    way = 0.02 * np.array([np.cos(np.radians(way_deg)), np.sin(np.radians(way_deg))])
    found = walls_of(np.concatenate([ring(1, middle=way), ring(2, middle=-way)]), RADIUS)
    assert found.shifted
    assert found.whole
    # They are 4 cm apart along the shift, and less beside it.
    assert 0.02 < found.gap_m < 0.042


def test_bark_that_stands_off_is_as_far_apart_all_round_and_no_shift() -> None:
    found = walls_of(np.concatenate([ring(1), ring(2, RADIUS + 0.03)]), RADIUS + 0.015)
    assert not found.shifted
    assert found.gap_m == pytest.approx(0.03, abs=0.003)
    assert walls_of(ring(1), RADIUS) == TwoWalls()
