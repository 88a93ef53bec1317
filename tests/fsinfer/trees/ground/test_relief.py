"""Valleys, banks, ditches and mounds are ground; undergrowth on them is not."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.trees import analyse_plot, find_ground
from fsinfer.trees.ground.lowest import MOST_CELLS, lowest_cells
from fsinfer.trees.ground.settings import GroundSettings
from tests.support.relief import FEET, SHAPES, Shape, gentle, hummocks, relief_plot, stream


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


def surface_points(shape: Shape, *, seed: int = 5) -> NDArray[np.float64]:
    """Points on a surface of 20 m by 20 m, without stems."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-10.0, 10.0, (80_000, 2))
    return np.column_stack([xy, shape(*xy.T) + rng.normal(0.0, 0.01, len(xy))])


def test_a_thicket_is_no_terrace() -> None:
    def thicket(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.where((np.abs(x) < 3.0) & (np.abs(y) < 3.0), 2.0 + 0.05 * np.sin(3.0 * x), 0.0)

    points = surface_points(thicket)
    assert not lowest_cells(points, GroundSettings()).at_bank.any()
    assert np.abs(find_ground(points).height_at(np.zeros((1, 2)))) < 0.3
    # Beside a bank along the plot three metres of either side are looked at without prejudice.
    bank = points + np.column_stack([np.zeros((len(points), 2)), 2.5 * (points[:, 0] > 5.0)])
    cells = lowest_cells(bank, GroundSettings())
    assert cells.at_bank.mean() == pytest.approx((2.6 + 3.0 + 3.0) / 20.0, abs=0.08)


@pytest.mark.parametrize(("height", "radius"), [(0.4, 1.2), (0.8, 2.5)])
def test_a_stream_far_away_does_not_lift_the_ground_onto_ferns(height: float, radius: float) -> None:
    def ferns(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        off = np.minimum(np.hypot(x + 4.0, y) / radius, 1.0)
        return np.asarray(0.5 * height * (1.0 + np.cos(np.pi * off)))

    at = np.array([[-4.0, 0.0]])
    alone = find_ground(surface_points(ferns)).height_at(at)
    beside = find_ground(surface_points(lambda x, y: ferns(x, y) + stream(2.0, 6.0)(x, y))).height_at(at)
    assert float(beside[0] - alone[0]) < 0.03


@pytest.mark.parametrize(("radius", "depth"), [(1.0, 2.0), (2.0, 2.0), (1.5, 1.0)])
def test_the_floor_of_a_hollow_with_steep_sides_is_ground(radius: float, depth: float) -> None:
    width = depth / np.tan(np.radians(60.0))

    def hollow(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(-depth * np.clip((radius + width - np.hypot(x - 5.0, y - 5.0)) / width, 0.0, 1.0))

    places = np.array([[5.0, 5.0], [5.0 + 0.7 * radius, 5.0], [-5.0, -5.0]])
    error = find_ground(surface_points(hollow)).height_at(places) - [-depth, -depth, 0.0]
    assert np.abs(error).max() < 0.1


@pytest.mark.parametrize("shape", [gentle, hummocks])
def test_the_ground_does_not_climb_onto_undergrowth(shape: Shape) -> None:
    plot = relief_plot(shape, patches=20)
    error = find_ground(plot.points).height_at(FEET) - plot.ground_m
    assert np.sqrt((error**2).mean()) < 0.04
    assert error.max() < 0.12


@pytest.mark.parametrize("shape", [gentle, hummocks])
def test_ground_that_undergrowth_leaves_free_on_half_of_the_plot_is_found(shape: Shape) -> None:
    rng = np.random.default_rng(4)
    points = surface_points(shape)
    column, row = np.floor(points[:, :2].T + 10.0).astype(int)
    # Metres of the plot that show nothing but leaves 15 to 60 cm up.
    leaves = (rng.random((21, 21)) < 0.5)[column, row]
    height = rng.uniform(0.25, 0.6, (21, 21))[column, row] * rng.uniform(0.6, 1.0, len(points))
    ground = find_ground(points + np.column_stack([np.zeros((len(points), 2)), height * leaves]))
    assert ground.method == "plane + raster"
    assert 0.5 < ground.share < 0.75
    free = points[~leaves][::200, :2]
    error = ground.height_at(free) - shape(*free.T)
    assert np.sqrt((error**2).mean()) < 0.015
    assert np.abs(error).max() < 0.1


@pytest.mark.parametrize("along", [0, 1])
def test_a_plot_of_many_hectares_has_no_more_cells_than_can_be_solved(along: int) -> None:
    size = np.array([200.0, 200.0])
    size[along] = 600.0
    xy = np.random.default_rng(6).uniform(0.0, 1.0, (60_000, 2)) * size
    cells = lowest_cells(np.column_stack([xy, np.zeros(len(xy))]), GroundSettings())
    assert cells.settings.cell_m == pytest.approx(np.sqrt(size.prod() / MOST_CELLS), rel=0.01)
    assert cells.shape[0] * cells.shape[1] == pytest.approx(MOST_CELLS, rel=0.02)
    # One of a hectare keeps its fine ones.
    near = lowest_cells(np.column_stack([xy / size * 97.0, np.zeros(len(xy))]), GroundSettings())
    assert near.settings.cell_m == GroundSettings().cell_m


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
