"""Hidden and hazy sides, shared errors and run-together walls: what keeps an interval honest."""

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.trees.cylinder.axis import AxisFit, axis_coordinates, fit_axis
from fsinfer.trees.diameter.double_wall import blurred_gap
from fsinfer.trees.diameter.sides import NOISE_SECTORS, noise_sector, relative_noise, seen_side
from fsinfer.trees.diameter.spread import fit_spread
from tests.support.stem_clouds import wall

START = np.array([0.0, 0.0, 0.0, 0.0, 0.15, 0.0])


def _stem(
    rng: np.random.Generator, *, sigma_m: float = 0.006, spacing_m: float = 0.012, **kwargs: float
) -> NDArray[np.float64]:
    points = wall(rng, radius=0.15, spacing_m=spacing_m, **kwargs)
    points = points[np.abs(points[:, 2] - 1.3) < 0.4]
    return points + rng.normal(0.0, sigma_m, points.shape)


def _fit(points: NDArray[np.float64]) -> tuple[AxisFit, NDArray[np.float64], NDArray[np.float64]]:
    fit = fit_axis(points, START, 1.3, sigma_m=0.01, order=4)
    offset, foot = axis_coordinates(points, fit.parameters, 1.3)
    return fit, offset, foot


def test_independent_noise_shares_nothing() -> None:
    fit, offset, foot = _fit(_stem(np.random.default_rng(0)))
    spread = fit_spread(fit, offset, foot)
    assert spread.tau_m < 0.0006
    assert np.sqrt(spread.covariance[4, 4]) == pytest.approx(np.sqrt(fit.covariance[4, 4]), rel=0.5)


def test_what_patches_share_is_found_and_does_not_average_away() -> None:
    rng = np.random.default_rng(1)
    points = _stem(rng, sigma_m=0.003)
    angle = np.arctan2(points[:, 1], points[:, 0])
    patch = (np.floor((angle + np.pi) / 0.27) * 100 + np.floor(points[:, 2] / 0.1)).astype(int)
    shared = rng.normal(0.0, 0.004, patch.max() + 1)[patch]
    points[:, :2] *= (1.0 + shared / np.hypot(points[:, 0], points[:, 1]))[:, None]
    fit, offset, foot = _fit(points)
    spread = fit_spread(fit, offset, foot)
    assert spread.tau_m == pytest.approx(0.004, rel=0.4)
    assert spread.covariance[4, 4] > 4.0 * fit.covariance[4, 4]
    # Some 28 blocks round the stem in 8 layers, less what the fit uses up; that is all there is to tell it from.
    assert 20.0 < spread.tau_dof < 230.0
    assert spread.tau_dof < spread.radius_dof < 2.0 * spread.tau_dof


@pytest.mark.parametrize(("rho", "holes"), [(0.0, 0.0), (0.6, 0.0), (0.6, 0.45)])
def test_blocks_that_go_with_their_neighbours_tell_less(rho: float, holes: float) -> None:
    """Errors that go on from layer to layer leave the radius off by what is said, wherever the stem is seen."""
    rng = np.random.default_rng(6)
    errors, counts_for_one = [], []
    for _ in range(60):
        layers, sectors = 8, 24
        shared = np.empty((layers, sectors))
        shared[0] = rng.normal(0.0, 1.0, sectors)
        for above in range(1, layers):
            shared[above] = rho * shared[above - 1] + np.sqrt(1 - rho**2) * rng.normal(0.0, 1.0, sectors)
        angle, height = rng.uniform(-np.pi, np.pi, 3000), rng.uniform(0.9, 1.7, 3000)
        layer = np.floor((height - 0.9) / 0.1).astype(int)
        sector = np.floor((angle + np.pi) / (2 * np.pi) * sectors).astype(int)
        radius = 0.15 - 0.006 * (height - 1.3) + 0.004 * shared[layer, sector] + rng.normal(0.0, 0.002, 3000)
        whole = rng.random((layers, sectors)) >= holes
        seen = whole[layer, sector]
        fit, offset, foot = _fit(np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])[seen])
        spread = fit_spread(fit, offset, foot)
        errors.append((fit.radius_m - 0.15) / np.sqrt(spread.covariance[4, 4]))
        counts_for_one.append((whole.sum() - len(spread.covariance)) / spread.tau_dof)
    assert 0.7 < np.sqrt(np.mean(np.square(errors))) < 1.3
    # The mean of a long row that goes on like that is as unsure as that of so many times fewer. From the few pairs that
    # holes leave, less what the fit takes up, it comes out smaller.
    fewer = (1 + rho) / (1 - rho)
    assert np.sqrt(fewer) < np.median(counts_for_one) < 1.3 * fewer


def test_the_top_of_a_stem_is_no_neighbour_of_its_foot() -> None:
    """Sides that swell towards the top, or shrink: eight layers that go together, the first against the last."""
    rng = np.random.default_rng(6)
    angle, height = rng.uniform(-np.pi, np.pi, 3000), rng.uniform(0.9, 1.7, 3000)
    sign = rng.choice([-1.0, 1.0], 24)[np.floor((angle + np.pi) / (2 * np.pi) * 24).astype(int)]
    swell = 0.004 * sign * np.sin((height - 1.3) / 0.4 * np.pi / 2)
    radius = 0.15 - 0.006 * (height - 1.3) + swell + rng.normal(0.0, 0.002, 3000)
    spread = fit_spread(*_fit(np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])))
    # A ring of layers would have a correlation of 0.4 instead of 0.7 and count 70 blocks instead of 32.
    assert spread.tau_dof < 45.0


def test_of_a_few_blocks_a_third_of_the_noise_is_taken_for_shared() -> None:
    points = _stem(np.random.default_rng(7), arc_deg=200.0, spacing_m=0.006)
    fit, offset, foot = _fit(points[np.abs(points[:, 2] - 1.3) < 0.04])
    spread = fit_spread(fit, offset, foot)
    assert spread.tau_m == pytest.approx(0.3 * fit.sigma_m)
    assert spread.covariance[4, 4] > fit.covariance[4, 4]
    assert 1.0 <= spread.tau_dof < 4.0


@pytest.mark.parametrize("arc_deg", [110.0, 200.0, 360.0])
def test_where_nothing_is_shared_the_spread_is_that_of_the_fit(arc_deg: float) -> None:
    ratios = []
    for seed in range(6):
        fit, offset, foot = _fit(_stem(np.random.default_rng(seed), arc_deg=arc_deg))
        ratios.append(np.sqrt(np.diag(fit_spread(fit, offset, foot).covariance) / np.diag(fit.covariance)))
    assert np.min(ratios) > 0.97
    assert np.median(ratios) < 1.25


def test_shape_is_measured_where_seen_and_doubted_where_hidden() -> None:
    rng = np.random.default_rng(2)
    whole, *_ = _fit(_stem(rng, ovality=0.04))
    half, *_ = _fit(_stem(rng, ovality=0.04, arc_deg=170.0))
    assert np.hypot(*whole.shape_m[:2]) == pytest.approx(0.04 * 0.15, rel=0.15)
    assert whole.radius_m == pytest.approx(0.15, abs=0.0008)
    assert half.covariance[4, 4] > 20.0 * whole.covariance[4, 4]
    assert abs(half.radius_m - 0.15) < 3.0 * np.sqrt(half.covariance[4, 4])


def test_strays_do_not_make_a_side_seen() -> None:
    rng = np.random.default_rng(3)
    points = _stem(rng, arc_deg=180.0)
    strays = np.column_stack([-rng.uniform(0.12, 0.18, 12), rng.uniform(-0.1, 0.1, 12), rng.uniform(1.0, 1.6, 12)])
    both = np.concatenate([points, strays])
    seen = seen_side(both[:, :2], both[:, 2] - 1.3, np.ones(len(both)))
    assert not seen[len(points) :].any()
    assert seen[: len(points)].mean() > 0.97


def test_a_hazy_side_is_told_from_a_sharp_one() -> None:
    rng = np.random.default_rng(4)
    points = wall(rng, radius=0.15, spacing_m=0.012)
    hazy = points[:, 0] < -0.03
    noise = rng.normal(0.0, np.where(hazy, 0.03, 0.002))
    ratio = relative_noise(points[:, :2], noise)
    assert ratio.shape == (NOISE_SECTORS,)
    assert np.median(ratio[noise_sector(points[hazy, :2])]) > 2.0
    assert ratio[noise_sector(points[points[:, 0] > 0.03, :2])].max() < 1.2
    assert (relative_noise(points[:, :2], rng.normal(0.0, 0.015, len(points))) < 1.3).all()


def test_two_walls_run_together_by_noise_are_noticed_and_one_sided_noise_is_not() -> None:
    rng = np.random.default_rng(5)
    one = _stem(rng, sigma_m=0.015)
    two = np.concatenate([one, _stem(rng, sigma_m=0.015) + np.array([0.04, 0.0, 0.0])])
    for points, low, high in ((two, 0.025, 0.05), (one, 0.0, 0.0)):
        fit, offset, _ = _fit(points)
        assert low <= blurred_gap(offset, fit.residuals_m, fit.sigma_m) <= high
    angle = np.arctan2(one[:, 1], one[:, 0])
    sided = rng.normal(0.0, 0.010 + 0.006 * np.cos(angle))
    assert blurred_gap(one[:, :2], sided, 0.012) == 0.0
