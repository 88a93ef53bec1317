"""Valleys, banks, ditches and mounds are ground; undergrowth on them is not."""

from __future__ import annotations

import numpy as np
import pytest

from fsinfer.trees import find_ground
from tests.support.relief import FEET, SHAPES, Shape, gentle, hummocks, relief_plot


@pytest.mark.parametrize(
    ("name", "worst_m"),
    [
        ("valley_12deg", 0.05),
        ("valley_25deg", 0.08),
        ("bank_1_5m", 0.09),
        ("ditch_1m", 0.10),
        ("hummocks", 0.05),
        ("mound_0_5m", 0.08),
        ("terrace_down_0_5m", 0.05),
    ],
)
def test_the_ground_follows_relief_on_both_sides(name: str, worst_m: float) -> None:
    plot = relief_plot(SHAPES[name])
    ground = find_ground(plot.points)
    assert ground.share > 0.9
    assert np.abs(ground.height_at(FEET) - plot.ground_m).max() < worst_m


@pytest.mark.parametrize("shape", [gentle, hummocks])
def test_the_ground_does_not_climb_onto_undergrowth(shape: Shape) -> None:
    plot = relief_plot(shape, patches=20)
    error = find_ground(plot.points).height_at(FEET) - plot.ground_m
    assert np.sqrt((error**2).mean()) < 0.04
    assert error.max() < 0.12
