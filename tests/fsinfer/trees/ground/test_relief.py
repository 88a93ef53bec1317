"""Valleys, banks, ditches and mounds are ground; undergrowth on them is not."""

from __future__ import annotations

import numpy as np
import pytest

from fsinfer.trees import analyse_plot, find_ground
from fsinfer.trees.ground.lowest import lowest_cells
from fsinfer.trees.ground.settings import GroundSettings
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
        ("cut_2_5m", 0.08),
        ("stream_2m", 0.10),
    ],
)
def test_the_ground_follows_relief_on_both_sides(name: str, worst_m: float) -> None:
    plot = relief_plot(SHAPES[name])
    ground = find_ground(plot.points)
    assert ground.share > 0.9
    assert np.abs(ground.height_at(FEET) - plot.ground_m).max() < worst_m


@pytest.mark.parametrize("name", ["cut_2_5m", "stream_2m"])
def test_ground_beside_steep_banks_is_part_of_the_plot(name: str) -> None:
    """Of a plot with a cut of 2.5 m a sixth was missing, of one with a stream half of its stems to the hectare."""
    stand = analyse_plot(relief_plot(SHAPES[name]).points).stand
    assert stand.plot_area_m2 == pytest.approx(400.0, rel=0.02)
    assert (stand.stems, stand.stems_on_area) == (len(FEET), len(FEET))


def test_a_thicket_is_no_terrace() -> None:
    rng = np.random.default_rng(5)
    xy = rng.uniform(-10.0, 10.0, (80_000, 2))
    inside = np.abs(xy).max(axis=1) < 3.0
    points = np.column_stack([xy, np.where(inside, 2.0 + 0.05 * np.sin(3.0 * xy[:, 0]), 0.0)])
    points[:, 2] += rng.normal(0.0, 0.01, len(points))
    assert not lowest_cells(points, GroundSettings()).terrace.any()
    assert np.abs(find_ground(points).height_at(np.zeros((1, 2)))) < 0.3
    # Half of the plot is level ground above a bank.
    bank = points + np.column_stack([np.zeros((len(xy), 2)), 2.5 * (xy[:, 0] > 5.0)])
    assert lowest_cells(bank, GroundSettings()).terrace.mean() == pytest.approx(0.25, abs=0.02)


@pytest.mark.parametrize("shape", [gentle, hummocks])
def test_the_ground_does_not_climb_onto_undergrowth(shape: Shape) -> None:
    plot = relief_plot(shape, patches=20)
    error = find_ground(plot.points).height_at(FEET) - plot.ground_m
    assert np.sqrt((error**2).mean()) < 0.04
    assert error.max() < 0.12


@pytest.mark.parametrize("slope", [0.0, 0.1])
def test_leaves_beyond_the_last_seen_ground_lift_it_little(slope: float) -> None:
    """Round a walk 250 points show each cell of the ground, farther out two dozen those of the ferns on it.

    Ferns of 5 to 30 cm are all that is known there; counted like the ground they lift it by 13 cm, up to 21.
    """
    rng = np.random.default_rng(45040)
    xy = rng.uniform(-8.0, 8.0, (400_000, 2))
    seen = np.column_stack([xy, slope * xy[:, 0] + rng.normal(0.0, 0.008, len(xy))])
    cells = np.array([(x, y) for x in np.arange(-11.8, 12.0, 0.4) for y in np.arange(-11.8, 12.0, 0.4)])
    cells = cells[(np.abs(cells).max(axis=1) > 8.2) & (rng.random(len(cells)) < 0.5)]
    leaves = np.repeat(cells, 24, axis=0) + rng.uniform(-0.19, 0.19, (24 * len(cells), 2))
    height = np.repeat(rng.uniform(0.05, 0.3, len(cells)), 24) + rng.uniform(0.0, 0.03, len(leaves))
    ground = find_ground(np.vstack([seen, np.column_stack([leaves, slope * leaves[:, 0] + height])]))
    feet = np.array([(side * 9.0, along) for side in (-1.0, 1.0) for along in np.arange(-7.0, 7.1, 1.0)])
    error = ground.height_at(feet) - slope * feet[:, 0]
    assert abs(error.mean()) < 0.115
    assert np.abs(error).max() < 0.18
