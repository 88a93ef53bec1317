"""Stems of a plot that are all farther from round than is usual: what half a stem does not show, the others tell.

How far from round stems are differs from stand to stand. Where a stem is seen from one side, what its hidden side adds
to the radius is a guess from what is usual. Stems of the same plot that were seen all round tell by how much more than
usual to allow for (empirical Bayes: Efron & Morris 1975): the factor that makes their 2nd harmonics likely, no less
than 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsinfer.trees.diameter.roundness import Harmonic

Floats = NDArray[np.float64]
#: Factors that are looked at, each so many times the one before. Source: numerics.
FINEST = 1.05


@dataclass(frozen=True, kw_only=True)
class CommonShapeSettings:
    """Constants of :func:`common_shape`.

    Attributes
    ----------
    min_coverage: share of the circumference seen, from which a stem tells of the others. Source: chosen on simulated
        walks.
    spread_log: standard deviation of the logarithm of the factor between stands. Source: judgement; half as far again
        from round than usual is common, twice as far is not, three times is rare.
    factors: least and greatest. Source: judgement, sections six times as far from round as usual are no stems.
    odd: share of stems that are as they are for reasons of their own, and how far from round those are, in usual
        standard deviations: one such stem makes no odd plot. Source: judgement.
    """

    min_coverage: float = 0.7
    spread_log: float = 0.4
    factors: tuple[float, float] = (0.3, 6.0)
    odd: tuple[float, float] = (0.05, 8.0)


def common_shape(ovals: Sequence[Harmonic], *, settings: CommonShapeSettings | None = None) -> float:
    """By what factor the stems with these 2nd harmonics are farther from round than is usual; 1 or more.

    The root of the mean square over what the stems leave open; a little above 1 where there are none.
    """
    s = settings or CommonShapeSettings()
    least, most = np.log(s.factors) / np.log(FINEST)
    factors = FINEST ** np.arange(np.ceil(least), most)
    odds = -0.5 * (np.log(factors) / s.spread_log) ** 2
    for oval in ovals:
        share, far = s.odd
        density = np.array([_density(oval, factor) for factor in factors])
        odds += np.log((1.0 - share) * density + share * _density(oval, far))
    chance = np.exp(odds - odds.max())
    return max(float(np.sqrt((chance * factors**2).sum() / chance.sum())), 1.0)


def _density(oval: Harmonic, factor: float) -> float:
    """Of the amplitude that was found, about 0, with a usual standard deviation of ``factor`` and its own errors."""
    covariance = factor**2 * np.eye(len(oval.amplitude)) + oval.covariance
    square = float(oval.amplitude @ np.linalg.solve(covariance, oval.amplitude))
    return float(np.exp(-0.5 * square) / np.sqrt(np.linalg.det(covariance)))
