"""How far from round a stem's section is, and what that says of its diameter.

A section's 2nd harmonic makes it oval, the 3rd triangular, the 4th square. A fit holds each by what is usual of stems
(:class:`fsinfer.trees.cylinder.axis.AxisSettings`), which leaves an error of two kinds:

- Of a side that was not seen the shape is a guess. What it leaves open in the radius is in the fit's covariance as far
  as stems are as round as is usual; where those of a plot are not, it is more (:mod:`fsinfer.trees.common_shape`).
- A section much farther from round than stems are is often none: halves of a cloud that do not fit, or a side in a
  haze. Two halves that were pulled apart by d have a mean radius that is d / pi too large, one that was pushed has it
  too small, and their 2nd harmonic has an amplitude of 2 d / (3 pi).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsinfer.trees.cylinder.axis import AxisFit, AxisSettings
from fsinfer.trees.diameter.spread import Spread

Floats = NDArray[np.float64]
#: Coefficients of one harmonic: cosine and sine. Source: mathematics.
PAIR = 2
#: A harmonic is not known of which the points tell less than one part in so many of the prior. Source: numerics.
FAINTEST = 10.0
#: An amplitude is none of its errors where its square is so many times their greatest variance. Source: statistics, ten
#: standard deviations; stems of two real scans and a rendered walk, where it is not known, have up to nine.
CLEAR = 100.0


@dataclass(frozen=True, kw_only=True)
class RoundnessSettings:
    """Constants of :func:`misfit_std`.

    Attributes
    ----------
    usual: square of a harmonic's amplitude, in its usual standard deviations, that 95 % of stems have less of.
        Source: statistics, chi-squared with two degrees of freedom.
    per_excess: part of the radius by which it may be off for each such standard deviation beyond that, of the 2nd, 3rd
        and 4th harmonic. Source: torn walks of the second generator, seeds 43000 to 43011 of both kinds.
    """

    usual: float = 6.0
    per_excess: tuple[float, ...] = (0.016, 0.011, 0.011)


@dataclass(frozen=True, kw_only=True)
class Harmonic:
    """One harmonic of a section as its points alone have it, without the prior that held the fit.

    ``amplitude`` (2,) are its cosine and sine coefficients over their usual standard deviation, ``covariance`` (2, 2)
    that of their errors in the same unit.
    """

    amplitude: Floats
    covariance: Floats

    @property
    def known(self) -> bool:
        """Whether the points tell more of it than that stems are usually round."""
        return self._greatest_variance < 1.0

    @property
    def told(self) -> bool:
        """Whether it is :attr:`known`, or so large that it is none of its errors: a square post's."""
        return self.known or float(self.amplitude @ self.amplitude) > CLEAR * self._greatest_variance

    @property
    def _greatest_variance(self) -> float:
        return float(np.linalg.eigvalsh(self.covariance)[-1])

    @property
    def square(self) -> float:
        """Of the amplitude, without what its errors add to it; never negative."""
        return max(float(self.amplitude @ self.amplitude) - float(np.trace(self.covariance)), 0.0)


@dataclass(frozen=True, kw_only=True)
class Roundness:
    """The 2nd, 3rd and 4th harmonic of a section, None where nothing is known of one, and what they leave open.

    ``left_open_m`` is the standard deviation of the radius, metres, by what sides that were not seen may be like, were
    the stem as round as is usual.
    """

    harmonics: tuple[Harmonic | None, ...]
    left_open_m: float


def roundness(fit: AxisFit, spread: Spread) -> Roundness:
    """The roundness of a fit with harmonics, and of the ``spread`` of its parameters."""
    prior = fit.prior_information
    first = len(prior) - len(fit.shape_m)
    return Roundness(
        harmonics=tuple(
            _alone(fit, spread, slice(own, own + PAIR), fit.shape_m[own - first : own - first + PAIR])
            for own in range(first, len(prior), PAIR)
        ),
        left_open_m=left_open(fit.covariance[4, first:], prior[first:]),
    )


def _alone(fit: AxisFit, spread: Spread, own: slice, found_m: Floats) -> Harmonic | None:
    """A harmonic whose prior is taken off: the information of the points is that of both less the prior's."""
    both = np.linalg.inv(fit.covariance[own, own])
    prior = fit.prior_information[own]
    points = both - np.diag(prior)
    if np.linalg.eigvalsh(points)[0] <= prior.max() / FAINTEST:
        return None
    back = np.linalg.solve(points, both)
    unit = np.sqrt(prior)
    return Harmonic(
        amplitude=back @ found_m * unit,
        covariance=back @ spread.covariance[own, own] @ back.T * np.outer(unit, unit),
    )


def left_open(covariance: Floats, prior: Floats) -> float:
    """Standard deviation of a radius by its ``covariance`` (K,) with coefficients of the shape whose priors have the
    precision ``prior`` (K,): what is left of the priors' own errors in it.
    """
    return float(np.sqrt(covariance**2 @ prior))


def oval_factor(shape: Roundness | None, settings: RoundnessSettings | None = None) -> float:
    """By how much the section is more oval than usual; 1 where it is no more so than 95 % of stems, or not known."""
    s = settings or RoundnessSettings()
    oval = _known_oval(shape)
    if oval is None or oval.square <= s.usual:
        return 1.0
    return float(np.sqrt(oval.square / PAIR))


def oval_share(shape: Roundness | None) -> float:
    """Amplitude of the section's 2nd harmonic, part of the radius; 0 where it is not known."""
    oval = _known_oval(shape)
    return 0.0 if oval is None else float(np.sqrt(oval.square)) * AxisSettings().shape_std[0]


def _known_oval(shape: Roundness | None) -> Harmonic | None:
    """The section's 2nd harmonic, where the points tell it."""
    oval = None if shape is None else shape.harmonics[0]
    return oval if oval is not None and oval.known else None


def misfit_std(shape: Roundness, settings: RoundnessSettings | None = None) -> float:
    """What a radius may be off because its section is farther from round than stems are; part of the radius."""
    s = settings or RoundnessSettings()
    excess = [
        share**2 * max(harmonic.square - s.usual, 0.0)
        for harmonic, share in zip(shape.harmonics, s.per_excess, strict=False)
        if harmonic is not None and harmonic.told
    ]
    return float(np.sqrt(sum(excess)))
