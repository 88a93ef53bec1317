import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.errors import CloudError
from fsinfer.trees import find_ground
from tests.support.stem_clouds import stem_plot, terrain


def _ground(
    seed: int = 0, slope: float = 0.0, bumps: float = 0.0, noise: float = 0.01, count: int = 30000
) -> NDArray[np.float64]:
    rng = np.random.default_rng(seed)
    xy = rng.uniform(0.0, 12.0, (count, 2))
    return np.column_stack([xy, terrain(xy, slope, bumps) + rng.normal(0.0, noise, count)])


def _grid() -> NDArray[np.float64]:
    return np.stack(np.meshgrid(np.linspace(0.5, 11.5, 23), np.linspace(0.5, 11.5, 23)), -1).reshape(-1, 2)


def test_flat_ground_is_a_plane_without_a_raster() -> None:
    ground = find_ground(_ground(slope=0.1))
    assert ground.method == "plane"
    assert ground.raster_m is None
    np.testing.assert_allclose(ground.height_at(_grid()), terrain(_grid(), 0.1, 0.0), atol=0.01)
    assert ground.slope_deg == pytest.approx(np.degrees(np.arctan(np.hypot(0.1, 0.05))), abs=0.3)


@pytest.mark.parametrize("slope_deg", [25.0, 35.0, 39.0])
@pytest.mark.parametrize("bumps", [0.0, 0.2])
def test_the_ground_of_a_steep_slope_is_not_its_cells_lower_border(slope_deg: float, bumps: float) -> None:
    slope = float(np.tan(np.radians(slope_deg)) / np.hypot(1.0, 0.5))  # the terrain rises half as much along y
    ground = find_ground(_ground(slope=slope, bumps=bumps, count=60_000))
    error = ground.height_at(_grid()) - terrain(_grid(), slope, bumps)
    assert abs(error.mean()) < 0.01
    assert np.abs(error).max() < (0.02 if bumps == 0 else 0.06)


@pytest.mark.parametrize("bumps", [0.0, 0.2])
def test_ground_that_is_moved_is_the_same_elsewhere(bumps: float) -> None:
    ground, by = find_ground(_ground(slope=0.3, bumps=bumps)), np.array([1000.0, -50.0])
    moved, places = ground.moved(by), np.random.default_rng(2).uniform(0, 10, (50, 2))
    assert moved.height_at(places + by) == pytest.approx(ground.height_at(places), abs=1e-9)
    assert ground.cells is not None
    assert moved.cells is not None
    assert moved.cells == pytest.approx(ground.cells + np.array([*by, 0.0]))


def test_bumps_bring_the_raster() -> None:
    ground = find_ground(_ground(slope=0.2, bumps=0.4))
    assert ground.method == "plane + raster"
    error = ground.height_at(_grid()) - terrain(_grid(), 0.2, 0.4)
    assert np.abs(error).max() < 0.06
    assert abs(error.mean()) < 0.01


def test_stems_shrubs_and_strays_below_do_not_move_the_ground() -> None:
    plot = stem_plot(seed=1, trees=16, spacing_m=0.02, sigma_m=0.01, slope=0.1, bumps_m=0.2, shrubs=15, flyers=2000)
    ground = find_ground(plot.points)
    inner = _grid()[(_grid() < 8.5).all(axis=1)]
    error = ground.height_at(inner) - terrain(inner, 0.1, 0.2)
    assert np.sqrt(np.mean(error**2)) < 0.04


def test_tolerance_follows_the_noise_within_the_paper_bounds() -> None:
    fine, rough = find_ground(_ground(noise=0.004)), find_ground(_ground(noise=0.04))
    assert fine.tolerance_m == pytest.approx(0.02)
    assert rough.tolerance_m == pytest.approx(0.05)
    assert fine.noise_m < 0.006 < rough.noise_m


def test_a_random_block_has_no_ground() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(CloudError, match="ground"):
        find_ground(rng.uniform([0, 0, 0], [12, 12, 12], (3000, 3)))
