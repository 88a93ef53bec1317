"""Many axes fitted at once against the same axes fitted one by one."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.trees.cylinder.axis import _densities, fit_axis
from fsinfer.trees.cylinder.batch import fit_axes, fit_sections
from fsinfer.trees.cylinder.kernels import blocked, sums_of_sets, tail_density
from tests.support.stem_clouds import wall

# Single precision in the distances, times what a short arc leaves open.
TOLERANCE_M = 2e-5


def _candidates(rng: np.random.Generator) -> tuple[list[NDArray[np.float64]], NDArray[np.float64]]:
    """Stems of all sizes with noise and a tail, among them hopeless ones; more than one chunk, of unlike sizes."""
    points, starts = [], []
    for number in range(60):
        radius = rng.uniform(0.03, 0.4)
        stem = wall(rng, radius=radius, arc_deg=rng.uniform(60.0, 360.0), spacing_m=rng.uniform(0.02, 0.05))
        stem = stem[np.abs(stem[:, 2] - 1.3) < 0.5][:600]
        stem += rng.normal(0.0, rng.uniform(0.003, 0.02), stem.shape)
        away = rng.random(len(stem)) < 0.1
        stem[away, :2] *= 1.0 + rng.exponential(0.03, away.sum())[:, None] / radius
        if number % 7 == 0:
            stem = rng.uniform([-0.4, -0.4, 0.9], [0.4, 0.4, 1.7], (rng.integers(8, 80), 3))
        points.append(stem)
        starts.append([*rng.normal(0.0, 0.02, 2), 0.0, 0.0, radius + rng.normal(0.0, 0.02), 0.0])
    return points, np.array(starts)


@pytest.mark.parametrize("iterations", [7, 40])
def test_a_batch_equals_one_by_one(iterations: int) -> None:
    points, starts = _candidates(np.random.default_rng(0))
    heights = np.full(len(points), 1.3)
    batch = fit_axes(points, starts, heights, steps=iterations)
    for axis, own, start in zip(batch, points, starts, strict=True):
        alone = fit_axis(own, start, 1.3, steps=iterations)
        np.testing.assert_allclose(axis.parameters, alone.parameters, atol=TOLERANCE_M)
        assert axis.sigma_m == pytest.approx(alone.sigma_m, abs=TOLERANCE_M)


def test_a_candidate_does_not_depend_on_its_company() -> None:
    points, starts = _candidates(np.random.default_rng(1))
    heights = np.full(len(points), 1.3)
    together = fit_axes(points, starts, heights)
    half = fit_axes(points[::2], starts[::2], heights[::2])
    for axis, again in zip(together[::2], half, strict=True):
        np.testing.assert_allclose(axis.parameters, again.parameters, atol=TOLERANCE_M)


@pytest.mark.parametrize("hazy", [False, True])
def test_sections_of_a_batch_equal_those_fitted_one_by_one(hazy: bool) -> None:
    rng = np.random.default_rng(3)
    points, starts = _candidates(rng)
    points = [own if k % 5 else np.concatenate([own] * 20) for k, own in enumerate(points)]
    relative = [1.0 + 3.0 * rng.random(len(own)) for own in points] if hazy else None
    worth = [rng.uniform(0.01, 1.0, len(own)) for own in points] if hazy else None
    heights, sigma = np.full(len(points), 1.3), rng.uniform(0.005, 0.03, len(points))
    batch = fit_sections(points, starts, heights, sigma_m=sigma, order=4, relative=relative, worth=worth)
    for k, fit in enumerate(batch):
        own, word = (None if of is None else of[k] for of in (relative, worth))
        alone = fit_axis(points[k], starts[k], 1.3, sigma_m=float(sigma[k]), order=4, relative=own, worth=word)
        np.testing.assert_allclose(fit.parameters, alone.parameters, atol=TOLERANCE_M)
        np.testing.assert_allclose(fit.shape_m, alone.shape_m, atol=TOLERANCE_M)
        np.testing.assert_allclose(fit.residuals_m, alone.residuals_m, atol=2.0 * TOLERANCE_M)
        np.testing.assert_allclose(fit.noise_m, alone.noise_m, atol=4.0 * TOLERANCE_M)
        np.testing.assert_allclose(fit.core, alone.core, atol=1e-2)  # as the noise settles
        np.testing.assert_allclose(fit.jacobian, alone.jacobian, atol=1e-3)
        if alone.core.sum() > 3.0:  # else there was no step to speak of
            np.testing.assert_allclose(fit.prior_information, alone.prior_information, rtol=1e-3)
            np.testing.assert_allclose(fit.covariance.diagonal(), alone.covariance.diagonal(), rtol=1e-2)


def test_the_tail_is_that_of_one_fit() -> None:
    rng = np.random.default_rng(2)
    residual = rng.uniform(-0.12, 0.12, (2, 4000))
    sigma, tail = np.array([0.0015, 0.03]), np.array([0.06, 0.01])
    scaled = residual / sigma[:, None]
    single = [a.astype(np.float32) for a in (scaled, np.exp(-0.5 * scaled**2), (sigma / tail)[:, None])]
    fast = tail_density(*single) * (0.5 / tail)[:, None]
    for row in range(2):
        exact = _densities(residual[row], np.full(4000, sigma[row]), tail[row])[1]
        # A thousandth of the background, which is some four per metre, is nothing to the mixture.
        np.testing.assert_allclose(fast[row], exact, rtol=1e-5, atol=4e-3)


@pytest.mark.parametrize("count", [1, 100, 513, 1700])
def test_sums_in_blocks_are_those_of_the_whole(count: int) -> None:
    rng = np.random.default_rng(count)
    length = blocked(count)
    assert count <= length < count + 4
    a, b = (rng.normal(0.0, 1.0, (rows, 3, length)).astype(np.float32) for rows in (6, 8))
    np.testing.assert_allclose(sums_of_sets(a, b), np.einsum("pkn,qkn->kpq", a, b), rtol=1e-4, atol=1e-3)


def test_nothing_gives_nothing() -> None:
    none = np.zeros((0, 6))
    assert fit_axes([], none, np.zeros(0)) == []
    assert fit_sections([], none, np.zeros(0), sigma_m=np.zeros(0), order=4) == []
