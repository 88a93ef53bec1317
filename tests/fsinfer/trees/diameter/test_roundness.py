"""Harmonics of a section without the prior that held them, and what a section far from round says of its diameter."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.trees.cylinder.axis import AxisFit, AxisSettings, axis_coordinates, fit_axis
from fsinfer.trees.diameter.roundness import Harmonic, Roundness, misfit_std, roundness
from fsinfer.trees.diameter.spread import fit_spread
from tests.support.bark import BH, bark

Floats = NDArray[np.float64]
RADIUS = 0.15
USUAL = AxisSettings().shape_std


def fitted(points: Floats) -> tuple[AxisFit, Roundness]:
    start = np.array([0.0, 0.0, 0.0, 0.0, RADIUS, -0.006])
    fit = fit_axis(points, start, BH, sigma_m=0.01, order=4)
    offset, foot = axis_coordinates(points, fit.parameters, BH)
    return fit, roundness(fit, fit_spread(fit, offset, foot))


def shaped(
    rng: np.random.Generator,
    shape: Sequence[tuple[int, float, float]],
    *,
    arc_deg: float = 360.0,
    count: int = 2500,
    sigma_m: float = 0.002,
) -> Roundness:
    return fitted(bark(rng, RADIUS, shape=shape, arc_deg=arc_deg, count=count, sigma_m=sigma_m))[1]


def flat(square: float) -> Harmonic:
    """A harmonic known exactly, of so many usual standard deviations, squared."""
    return Harmonic(amplitude=np.array([np.sqrt(square), 0.0]), covariance=np.zeros((2, 2)))


def test_harmonics_come_back_in_usual_standard_deviations() -> None:
    """The 2nd three, the 3rd two of them, in the directions that were drawn; the 4th none."""
    found = shaped(np.random.default_rng(0), [(2, 0.0, 3 * USUAL[0]), (3, -2 * USUAL[1], 0.0)])
    second, third, fourth = found.harmonics
    assert second is not None
    assert third is not None
    assert fourth is not None
    assert all(one.known for one in (second, third, fourth))
    np.testing.assert_allclose(second.amplitude, [0.0, 3.0], atol=0.15)
    np.testing.assert_allclose(third.amplitude, [-2.0, 0.0], atol=0.25)
    np.testing.assert_allclose(fourth.amplitude, [0.0, 0.0], atol=0.4)


def test_what_the_prior_held_back_is_given_back() -> None:
    """Few points with much noise: the fit's own harmonic is shrunk, the one given here is right in the mean."""
    rng = np.random.default_rng(1)
    fits = [shaped(rng, [(2, 3 * USUAL[0], 0.0)], count=120, sigma_m=0.008).harmonics[0] for _ in range(60)]
    known = [one for one in fits if one is not None]
    amplitude = np.array([one.amplitude for one in known])
    error = amplitude.std(axis=0) / np.sqrt(len(known))
    assert abs(amplitude[:, 0].mean() - 3.0) < 3 * error[0]
    assert abs(amplitude[:, 1].mean()) < 3 * error[1]
    # Its errors are as large as is said.
    said = np.sqrt(np.mean([np.trace(one.covariance) / 2 for one in known]))
    assert amplitude.std() / said == pytest.approx(np.sqrt(1.0 + 2.25 / said**2), rel=0.5)
    assert 0.7 < amplitude[:, 1].std() / said < 1.5
    # A square without what noise adds to it.
    assert np.mean([one.square for one in known]) == pytest.approx(9.0, rel=0.25)


def test_half_a_stem_leaves_its_radius_open_and_its_shape_unknown() -> None:
    rng = np.random.default_rng(2)
    whole, half = shaped(rng, ()), shaped(rng, (), arc_deg=150.0)
    assert half.left_open_m > 20 * whole.left_open_m
    assert half.left_open_m > 0.01 * RADIUS
    second = half.harmonics[0]
    assert second is None or not second.known


def test_stems_as_usual_say_nothing_and_beyond_it_grows() -> None:
    def of_second(square: float) -> float:
        return misfit_std(Roundness(harmonics=(flat(square), flat(1.0), None), left_open_m=0.0))

    assert of_second(5.9) == 0.0
    # Amplitudes of 4, and of 8 usual standard deviations, less the 2.45 that are no news.
    assert of_second(16.0) == pytest.approx(0.016 * np.sqrt(10.0))
    assert of_second(64.0) == pytest.approx(0.016 * np.sqrt(58.0))


def test_each_harmonic_adds_to_it() -> None:
    def parts(*squares: float) -> float:
        return misfit_std(Roundness(harmonics=tuple(flat(square) for square in squares), left_open_m=0.0))

    assert parts(0.0, 16.0, 0.0) == pytest.approx(0.011 * np.sqrt(10.0))
    assert parts(16.0, 16.0, 16.0) == pytest.approx(np.sqrt(parts(16.0, 0, 0) ** 2 + 2 * parts(0, 16.0, 0) ** 2))


def test_what_is_not_known_is_not_counted() -> None:
    """An amplitude of ten with an error of two usual standard deviations may be what half a stem makes of noise."""
    unsure = Harmonic(amplitude=np.array([10.0, 0.0]), covariance=4.0 * np.eye(2))
    assert misfit_std(Roundness(harmonics=(unsure, None, None), left_open_m=0.0)) == 0.0


def test_halves_that_are_apart_are_held_by_it() -> None:
    """Two halves some 3 cm off each other, cut anywhere: most errors are held with it, next to none without it.

    Pulled apart by a centimetre a stem is as round as many are; there it has nothing to say.
    """
    rng = np.random.default_rng(3)
    errors, said = [], []
    for _ in range(40):
        points = bark(rng, RADIUS, sigma_m=0.003)
        cut, shift = rng.uniform(0.0, 2.0 * np.pi), rng.normal(0.0, 0.02, 2)
        side = np.cos(np.arctan2(points[:, 1], points[:, 0]) - cut) > 0.0
        points[side, :2] += shift
        fit, shape = fitted(points)
        errors.append(abs(fit.radius_m - RADIUS) / RADIUS)
        said.append(misfit_std(shape))
    # Bark and the local correction would be a hundredth of the radius in any case.
    held = np.array(errors) <= 1.96 * np.hypot(0.01, said)
    assert held.mean() > 0.75
    assert np.mean(np.array(errors) <= 1.96 * 0.01) < 0.45
    # Nor is it far more than need be.
    assert np.mean(said) < 2.5 * np.mean(errors)
