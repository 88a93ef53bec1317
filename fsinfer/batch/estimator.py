"""What plots that sample a forest say of the forest: ratios of sums over plots, with their standard errors.

One formula for all: the sum of an amount over the sum of another one, each put together over strata by their areas
(the combined ratio, Cochran, Sampling Techniques, 3rd edition 1977, section 6.11). With the plots' own areas as the
other amount, and one stratum, it is the ratio of means (sections 6.2 to 6.4), which for plots of equal areas is the
mean of plots with s / sqrt(n) (chapter 2); with several strata it is the stratified estimate (sections 5.3 and 5.4,
within each a ratio of means, section 6.10). There is no finite population correction: plots cover next to nothing of a
forest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from fsinfer.plot_border.hectare import TAIL

Floats = NDArray[np.float64]
Whole = NDArray[np.intp]


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """A figure of the forest, in units of its amounts.

    Attributes
    ----------
    plots: how many it rests on; of a mean over stems those that have some.
    value: the estimate. std_error: its standard error; None where it rests on a single plot of a stratum.
    df: degrees of freedom of Student's t; None without a standard error.
    lo95, hi95: 95 % interval, whose lower end is no less than 0, as no amount is; None without a standard error.
    cv_percent: the coefficient of variation between plots, per cent; None without a standard error, and over several
        strata, where each has its own.
    sampling_error_percent: half of the 95 % interval (uncut), per cent of the estimate; None without a standard error,
        or of nothing.
    """

    plots: int
    value: float
    std_error: float | None = None
    df: float | None = None
    lo95: float | None = None
    hi95: float | None = None
    cv_percent: float | None = None
    sampling_error_percent: float | None = None

    def times(self, factor: float) -> Estimate:
        """The same in another unit, or to another area; ``factor`` above 0 counts as known without error."""
        std_error = None if self.std_error is None else factor * self.std_error
        low, high = (None if end is None else factor * end for end in (self.lo95, self.hi95))
        return replace(self, value=factor * self.value, std_error=std_error, lo95=low, hi95=high)

    def root(self) -> Estimate:
        """Its square root, with half of the relative error (the error's first order); ``value`` is above 0."""
        value = math.sqrt(self.value)
        if self.std_error is None or self.df is None:
            return replace(self, value=value)
        of_squares = None if self.cv_percent is None else self.cv_percent / 100.0
        return _estimate(
            self.plots,
            value,
            self.std_error / (2.0 * value),
            self.df,
            variation=None if of_squares is None else of_squares / 2.0,
        )


def estimate_ratio(
    amounts: Floats,
    others: Floats,
    areas: Floats,
    *,
    stratum: Whole | None = None,
    stratum_areas: Floats | None = None,
) -> Estimate | None:
    """The ratio of the forest's total of ``amounts`` to that of ``others``.

    Amounts a hectare have the plots' areas in hectares as ``others``; means over stems have their numbers of stems.

    Parameters
    ----------
    amounts, others: (n,) sums over each plot, no less than 0.
    areas: (n,) of the plots, above 0, all in one unit.
    stratum: (n,) number of the stratum of each plot, 0 to H-1, none of them without a plot; None for a single one.
    stratum_areas: (H,) their areas, above 0, all in one unit; None for a single stratum, whose area does not matter.

    Returns
    -------
    None without plots, and where ``others`` are nothing everywhere.

    Notes
    -----
    With A_h the strata's areas, a the plots', and totals T_h(y) = A_h sum(y) / sum(a): R = sum T_h(y) / sum T_h(x).
    Its variance is that of sum T_h(z) of the residuals z = y - R x (Cochran 1977, section 6.11), in each stratum by
    the residuals of z from its own ratio to the area: v_h = A_h² n_h / (n_h - 1) sum(e²) / sum(a)² (section 6.4; its
    mean of areas is that of the sample). Degrees of freedom are Satterthwaite's (eq. 5.16); in one stratum, n - 1. Of
    plots n and n_h count those whose x is above 0: a mean over stems has nothing from empty ones, which would only
    make its error small.
    """
    if not len(amounts):
        return None
    stratum = np.zeros(len(amounts), dtype=np.intp) if stratum is None else stratum
    # Of a mean over stems a plot without any tells nothing: of one plot with stems among empty ones it has no error.
    telling = np.bincount(stratum, others > 0.0).astype(np.intp)
    weight = np.ones(len(telling)) if stratum_areas is None else stratum_areas
    # How much of its stratum each plot's area stands for.
    raised = weight / _sums(stratum, areas)
    of_others = float((raised * _sums(stratum, others)).sum())
    if of_others <= 0.0:
        return None
    ratio = float((raised * _sums(stratum, amounts)).sum()) / of_others
    plots = int(telling.sum())
    if (telling == 1).any():
        return Estimate(plots=plots, value=ratio)
    # Strata in which none tells anything have no part in either sum, nor in the error.
    number = np.maximum(telling, 2)
    residuals = amounts - ratio * others
    own_ratio = _sums(stratum, residuals) / _sums(stratum, areas)
    squares = _sums(stratum, (residuals - own_ratio[stratum] * areas) ** 2)
    variances = (raised / of_others) ** 2 * number / (number - 1.0) * squares
    std_error = math.sqrt(float(variances.sum()))
    alone = len(number) == 1
    variation = math.sqrt(plots) * std_error / ratio if alone and ratio > 0.0 else None
    return _estimate(plots, ratio, std_error, _degrees_of_freedom(variances, number), variation=variation)


def _sums(stratum: Whole, values: Floats) -> Floats:
    """Of values (n,) in each stratum (H,)."""
    return np.asarray(np.bincount(stratum, values), dtype=np.float64)


def _degrees_of_freedom(variances: Floats, number: Whole) -> float:
    """Satterthwaite's (Cochran 1977, eq. 5.16), of variances (H,) of the strata's parts by numbers (H,) of plots."""
    largest = float(variances.max())
    if largest == 0.0:
        return float((number - 1).sum())
    # Relative to the largest, whose square may be no number any more.
    parts = variances / largest
    return float(parts.sum() ** 2 / (parts**2 / (number - 1.0)).sum())


def _estimate(plots: int, value: float, std_error: float, df: float, *, variation: float | None) -> Estimate:
    half = float(stdtrit(df, 1.0 - TAIL)) * std_error
    return Estimate(
        plots=plots,
        value=value,
        std_error=std_error,
        df=df,
        lo95=max(value - half, 0.0),
        hi95=value + half,
        cv_percent=None if variation is None else 100.0 * variation,
        sampling_error_percent=100.0 * half / value if value > 0.0 else None,
    )
