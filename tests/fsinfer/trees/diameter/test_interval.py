"""The 95 % interval, term by term: stems whose one error is known, drawn a few dozen times (seeds 44000 to 44099).

Each test makes the error that one term of the interval stands for, and no other, and counts errors in units of the
standard deviation that is given. Their root mean square is 1 where the term is as large as the error that it stands
for; the bounds leave out a term half as large, which gives 2, and one twice as large, which gives 0.5.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.trees.cylinder.axis import AxisSettings, fit_axis
from fsinfer.trees.diameter.dbh import measure_together
from fsinfer.trees.diameter.dbh_settings import DbhSettings
from fsinfer.trees.diameter.section import Section
from tests.support.bark import BH, bark, stem_of, tape

Floats = NDArray[np.float64]
#: All terms but that of the fit are off: a test switches on the one that it is about, as it is by default.
FIT_ALONE = DbhSettings(
    local_std=0.0,
    bark_std=0.0,
    hidden_std=0.0,
    common_share=0.0,
    noise_share=0.0,
    taper_std=0.0,
    ground_std_m=0.0,
    max_interval=9.0,
)
DEFAULT = DbhSettings()


def measure(
    points: Sequence[Floats],
    radii: Sequence[float],
    settings: DbhSettings,
    *,
    ground_noise_m: float = 0.0,
    scale_rel_std: float = 0.0,
) -> list[Section]:
    sections = measure_together(
        points,
        [stem_of(radius) for radius in radii],
        ground_noise_m=ground_noise_m,
        scale_rel_std=scale_rel_std,
        settings=settings,
    )
    assert all(found.dbh_m is not None for found in sections), [found.reasons for found in sections]
    return sections


def in_its_own_units(sections: Sequence[Section], truth: Sequence[float] | Floats) -> Floats:
    """Errors of radii (N,) over the standard deviations that are given for them."""
    radii = np.array([found.dbh_m or np.nan for found in sections]) / 2.0
    return np.asarray((radii - np.array(truth)) / (np.array([found.sd_m for found in sections]) / 2.0))


def rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


def inside(values: Floats) -> float:
    """Share of errors that the 95 % interval holds."""
    return float((np.abs(values) <= 1.96).mean())


def test_the_fit_of_stems_as_unround_as_its_priors_say() -> None:
    rng = np.random.default_rng(44000)
    prior = AxisSettings()
    clouds, radii, truth = [], [], []
    for _ in range(40):
        radius = rng.uniform(0.08, 0.3)
        shape = [(k, *rng.normal(0.0, std, 2)) for k, std in zip((2, 3, 4), prior.shape_std, strict=True)]
        clouds.append(
            bark(
                rng,
                radius,
                taper=rng.normal(prior.taper_mean, prior.taper_std),
                arc_deg=rng.uniform(130.0, 300.0),
                sigma_m=0.004,
                shape=shape,
                slope=(rng.normal(0.0, 0.03), rng.normal(0.0, 0.03)),
            )
        )
        radii.append(radius)
        truth.append(tape(radius, shape))
    errors = in_its_own_units(measure(clouds, radii, FIT_ALONE), truth)
    assert 0.65 < rms(errors) < 1.25


def test_a_swelling_where_no_points_are() -> None:
    rng = np.random.default_rng(44001)
    radius = 0.25
    clouds, truth = [], []
    for _ in range(40):
        points = bark(rng, radius)
        clouds.append(points[np.abs(points[:, 2] - BH) > 0.12])
        truth.append(radius * (1.0 + rng.normal(0.0, 0.0035)))
    errors = in_its_own_units(measure(clouds, [radius] * 40, replace(FIT_ALONE, local_std=DEFAULT.local_std)), truth)
    assert 0.65 < rms(errors) < 1.3


def test_a_swelling_that_the_slice_shows_is_measured() -> None:
    rng = np.random.default_rng(44002)
    radius = 0.25
    clouds, truth = [], []
    for _ in range(40):
        points = bark(rng, radius, count=5000)
        swelling = rng.normal(0.0, 0.0035)
        here = np.abs(points[:, 2] - BH) < 0.05
        points[here, :2] *= 1.0 + swelling
        clouds.append(points)
        truth.append(radius * (1.0 + swelling))
    sections = measure(clouds, [radius] * 40, replace(FIT_ALONE, local_std=DEFAULT.local_std))
    off = np.array([found.dbh_m or np.nan for found in sections]) / 2.0 - truth
    assert rms(np.asarray(off)) < 0.5 * 0.0035 * radius
    errors = in_its_own_units(sections, truth)
    assert 0.6 < rms(errors) < 1.4


def test_a_tape_over_ridges_of_bark() -> None:
    rng = np.random.default_rng(44003)
    radius = 0.3
    clouds, truth = [], []
    for _ in range(20):
        # Narrow ridges of two millimetres, by which the girth grows by half a hundredth: what the term is good for.
        shape = [(k, *rng.normal(0.0, 0.0018, 2)) for k in range(16, 24)]
        clouds.append(bark(rng, radius, shape=shape, count=4000, sigma_m=0.001, taper=0.0))
        truth.append(tape(radius, shape))
    sections = measure(clouds, [radius] * 20, replace(FIT_ALONE, bark_std=DEFAULT.bark_std))
    errors = in_its_own_units(sections, truth)
    assert 0.7 < rms(errors) < 1.35


def test_what_fattens_blocks_of_bark_fattens_the_whole() -> None:
    rng = np.random.default_rng(44004)
    radius, uneven = 0.15, 0.006 * 0.15
    clouds = []
    for _ in range(40):
        points = bark(rng, radius, sigma_m=0.002, count=1800)
        angle = np.arctan2(points[:, 1], points[:, 0])
        block = (np.floor((angle + np.pi) / (2 * np.pi) * 24) * 100 + np.floor(points[:, 2] / 0.1)).astype(int)
        points[:, :2] *= (1.0 + rng.normal(0.0, 0.004, block.max() + 1)[block] / radius)[:, None]
        clouds.append(points)
    settings = replace(FIT_ALONE, common_share=DEFAULT.common_share)
    sections = measure(clouds, [radius] * 40, settings)
    # Of what blocks are found to share 0.6 % of the radius is bark's own; the rest has a cause that moves all of them.
    cause = np.sqrt(np.array([found.tau_m for found in sections]) ** 2 - uneven**2)
    errors = in_its_own_units(sections, radius + rng.normal(0.0, 1.5 * cause))
    assert 0.75 < rms(errors) < 1.3
    even = measure([bark(rng, radius, sigma_m=0.004)], [radius], settings)[0]
    assert even.tau_m < uneven
    assert even.parts_m["common"] == 0.0
    np.testing.assert_allclose([found.parts_m["common"] for found in sections], 1.5 * cause, rtol=0.02)


@pytest.mark.parametrize("ground_noise_m", [0.0, 0.03])
def test_ground_that_is_not_where_it_was_found(ground_noise_m: float) -> None:
    rng = np.random.default_rng(44005)
    radius, taper = 0.2, -0.05
    clouds = []
    for _ in range(40):
        points = bark(rng, radius, taper=taper)
        points[:, 2] += rng.normal(0.0, np.hypot(0.02, ground_noise_m))
        clouds.append(points)
    settings = replace(FIT_ALONE, taper_std=DEFAULT.taper_std, ground_std_m=DEFAULT.ground_std_m)
    errors = in_its_own_units(measure(clouds, [radius] * 40, settings, ground_noise_m=ground_noise_m), [radius] * 40)
    assert 0.75 < rms(errors) < 1.3


def test_a_cloud_of_the_wrong_size() -> None:
    rng = np.random.default_rng(44006)
    truth = rng.uniform(0.06, 0.3, 40)
    clouds = [bark(rng, radius, count=1500) * (1.0 + rng.normal(0.0, 0.02)) for radius in truth]
    for cloud in clouds:
        cloud[:, 2] += BH - cloud[:, 2].mean()
    errors = in_its_own_units(measure(clouds, list(truth), FIT_ALONE, scale_rel_std=0.02), truth)
    assert 0.75 < rms(errors) < 1.3
    assert 0.88 <= inside(errors) <= 0.99


def test_all_terms_make_the_interval_as_independent_errors_do() -> None:
    rng = np.random.default_rng(44007)
    radius, sigma = 0.2, 0.006
    (found,) = measure(
        [bark(rng, radius, sigma_m=sigma, arc_deg=200.0, taper=0.0)], [radius], DEFAULT, scale_rel_std=0.01
    )
    parts = found.parts_m
    assert found.sd_m == pytest.approx(2.0 * np.sqrt(sum(part**2 for part in parts.values())))
    assert parts["scale"] == pytest.approx(0.01 * radius, rel=0.03)
    assert parts["bark"] == pytest.approx(0.005 * radius, rel=0.03)
    assert parts["noise"] == pytest.approx(0.1 * sigma, rel=0.1)
    # What the taper near breast height may differ by, and where the ground is.
    assert parts["level"] == pytest.approx((abs(found.taper) + 0.002) * 0.02)


def test_an_oval_stem_has_more_girth_than_the_circle_of_its_mean_radius() -> None:
    rng = np.random.default_rng(44008)
    radius, shape = 0.2, [(2, 0.05, 0.0), (3, 0.0, 0.03)]
    excess = tape(radius, shape) - radius
    assert excess == pytest.approx(radius * (4 * 0.05**2 + 9 * 0.03**2) / 4, rel=0.05)
    sections = measure([bark(rng, radius, shape=shape, count=4000) for _ in range(12)], [radius] * 12, DEFAULT)
    off = np.array([found.dbh_m or np.nan for found in sections]) / 2.0 - radius
    assert off.mean() == pytest.approx(excess, rel=0.2)


def test_noise_does_not_thicken_a_stem() -> None:
    # A geometric fit to points with noise sigma finds the radius sigma^2 / 2R too large: 0.9 mm here.
    rng = np.random.default_rng(44009)
    radius, sigma = 0.05, 0.01
    clouds = []
    for _ in range(40):
        points = bark(rng, radius, sigma_m=0.0, count=1500)
        clouds.append(points + rng.normal(0.0, sigma, points.shape) * [1.0, 1.0, 0.0])
    sections = measure(clouds, [radius] * 40, DEFAULT)
    off = np.array([found.dbh_m or np.nan for found in sections]) / 2.0 - radius
    assert abs(off.mean()) < 0.3 * sigma**2 / (2 * radius)


def test_a_radius_above_a_narrow_ring_is_as_unsure_as_the_taper_of_stems() -> None:
    rng = np.random.default_rng(44010)
    prior = AxisSettings()
    errors = []
    for _ in range(40):
        radius, taper = 0.15, rng.normal(-0.006, 0.008)
        points = bark(rng, radius, taper=taper)
        ring = points[np.abs(points[:, 2] - BH - 0.4) < 0.01]
        start = np.array([0.0, 0.0, 0.0, 0.0, radius, prior.taper_mean])
        fit = fit_axis(ring, start, BH, sigma_m=0.004)
        errors.append((fit.radius_m - radius) / np.sqrt(fit.covariance[4, 4]))
    assert 0.75 < rms(np.array(errors)) < 1.25
    assert abs(np.mean(errors)) < 0.2


def test_a_stem_known_by_a_few_blocks_of_bark_has_an_interval_of_student() -> None:
    points = bark(np.random.default_rng(7), 0.15, arc_deg=240.0, count=40_000, sigma_m=0.02, taper=0.0)
    disc = points[np.abs(points[:, 2] - BH) < 0.04]
    few, many = measure([disc, points], [0.15, 0.15], DEFAULT)
    # Half of the variance is estimated from a dozen blocks or so.
    assert few.parts_m["common"] > 0.6 * few.sd_m / 2
    assert few.dof < 60.0 < 10_000.0 < many.dof
    assert few.half95_m > 2.0 * few.sd_m > 1.98 * many.sd_m
    assert many.half95_m == pytest.approx(1.96 * many.sd_m, rel=1e-4)
