"""Stems and basal area a hectare of a plot with a border, each with an interval whose parts are named.

Two questions have two intervals. *What stands on this plot?* is uncertain by what was not seen, by stems at the border,
by diameters and by the scale. *What stands in the stand around it, of which this plot is one sample?* is uncertain by
counting as well, which is more than all of these on a plot of a few dozen stems.

What was seen stands for the whole plot; stems that were found on the rest are no part of that sum. They stand there all
the same: the plot holds no less than what was found on it.

Intervals of independent causes are joined about the figure by the squares of their distances to either side (Zou and
Donner, Statistics in Medicine 27 (2008) 1693-1702: the MOVER).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import betainc, gammaincinv

from fsinfer.trees.points.sums import Z95
from fsinfer.trees.stand import mean_section

Floats = NDArray[np.float64]
#: Square metres of a hectare. Source: format; its definition.
M2_PER_HA = 10_000.0
#: Probability on either side of an interval. Source: convention, 95 %.
TAIL = 0.025
#: Less of a plot than this share says nothing of the rest. Source: judgement; the rest would be more than what was seen
#: twice over.
LEAST_SHARE = 1.0 / 3.0
# Names of the parts of an interval.
UNSEEN, AT_BORDER, SCALE, UPRIGHT, DIAMETERS, NOT_MEASURED, COUNTING = (
    "unseen ground", "stems at the border", "scale", "which way is up", "diameters", "stems without a DBH", "counting",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class HectareFigure:
    """A figure a hectare of horizontal ground.

    Attributes
    ----------
    value: what was found on the seen part of the plot, the rest taken to be like it, or all that was found if that is
        more.
    lo95, hi95: 95 % interval of what stands on this plot.
    parts: half the width that each cause would give alone, the larger side, by its name.
    stand_lo95, stand_hi95: 95 % interval of the stand, of which the plot is one sample.
    """

    value: float
    lo95: float
    hi95: float
    parts: dict[str, float]
    stand_lo95: float
    stand_hi95: float


@dataclass(frozen=True, kw_only=True)
class PlotStems:
    """The stems that count for a plot.

    Attributes
    ----------
    inside: (T,) whether each is in, by its centre at breast height.
    chance: (T,) probability that it is, given the error of its place.
    dbh_m: (T,) NaN where it was not measured; std_m: (T,) its standard deviation, without that of the scale.
    shared_m: (T,) the part of ``std_m`` that has one cause in all stems (their bark, the camera, the depth maps): it
        errs the same way in each and does not average out. None where there is none.
    rough_m, rough_std_m: (T,) what is known of those that were not measured, with its standard deviation, NaN where
        that is nothing (:func:`fsinfer.trees.rough_dbh.rough_dbh_cm`). None where it is nothing of all.
    seen: (T,) whether the ground that each stands on counts as seen; None where nobody knows: then all of it does.
    """

    inside: NDArray[np.bool_]
    chance: Floats
    dbh_m: Floats
    std_m: Floats
    seen: NDArray[np.bool_] | None = None
    shared_m: Floats | None = None
    rough_m: Floats | None = None
    rough_std_m: Floats | None = None

    @property
    def sections_m2(self) -> Floats:
        """(T,) of the stems at breast height, NaN where it was not measured."""
        return np.asarray(np.pi / 4.0 * self.dbh_m**2)

    @property
    def rough_sections_m2(self) -> tuple[Floats, Floats]:
        """(T,) of those that were not measured, NaN where nothing is known of them, and their standard deviations."""
        if self.rough_m is None or self.rough_std_m is None:
            nothing = np.full(len(self.dbh_m), np.nan)
            return nothing, nothing
        return np.pi / 4.0 * self.rough_m**2, np.pi / 2.0 * self.rough_m * self.rough_std_m

    @property
    def on_seen(self) -> NDArray[np.bool_]:
        """(T,) :attr:`seen`, whether known or not."""
        return np.ones(len(self.inside), dtype=bool) if self.seen is None else self.seen


def stems_per_ha(
    stems: PlotStems, *, area_m2: float, share: float, scale_rel_std: float, level_rel_std: float = 0.0
) -> HectareFigure:
    """Stems a hectare on ``area_m2`` of which ``share`` was seen.

    ``level_rel_std`` is the relative error that not knowing exactly which way is up makes in the area.
    """
    found = int(stems.inside.sum())
    count = int((stems.inside & stems.on_seen).sum())
    total = max(count / share, float(found))
    low, high = count_interval(count, share, least=found)
    weight = _weights(stems, share)
    known = {
        AT_BORDER: _both(Z95 * float(np.sqrt((stems.chance * (1.0 - stems.chance) * weight**2).sum()))),
        # A metre that is 1 % short makes the plot 2 % small.
        SCALE: _both(Z95 * 2.0 * scale_rel_std * total),
        UPRIGHT: _both(Z95 * level_rel_std * total),
    }
    unseen = {UNSEEN: (total - low, high - total), **known}
    (fewest, by_seen), by_all = poisson_interval(count), poisson_interval(found)[1]
    most = max(by_seen / share, by_all)
    sampled = {COUNTING: (total - fewest / share, most - total), **known}
    return _figure(total, unseen, sampled, hectares=area_m2 / M2_PER_HA)


def basal_area_per_ha(
    stems: PlotStems, *, area_m2: float, share: float, level_rel_std: float = 0.0
) -> HectareFigure | None:
    """Square metres of stem section at breast height a hectare; None where that cannot be said.

    Stems without a DBH count with what is roughly known of them, or else with the mean of the measured ones; there is
    none without a stem that was measured, or with one such and some of which nothing is known.
    An error of the scale changes diameters and the plot alike, and drops out. ``level_rel_std`` is as in
    :func:`stems_per_ha`.
    """
    measured = stems.inside & np.isfinite(stems.dbh_m)
    sections = stems.sections_m2[measured]
    found = int(stems.inside.sum())
    rough, rough_std = stems.rough_sections_m2
    by_rough = stems.inside & ~measured & np.isfinite(rough)
    without = stems.inside & ~measured & ~by_rough
    mean = mean_section(sections, lacking=bool(without.any()))
    if mean is None:
        return None
    spread = _deviation(sections, mean)
    known_sections = np.where(np.isfinite(stems.dbh_m), stems.sections_m2, rough)
    all_sections = np.where(np.isfinite(known_sections), known_sections, mean)
    # What varies from stem to stem, and what one more would be: those that are roughly known belong to it.
    varied = known_sections[stems.inside & np.isfinite(known_sections)]
    usual, variation = float(all_sections[stems.inside].mean()), _deviation(varied, mean)
    seen = stems.inside & stems.on_seen
    count = int(seen.sum())
    stands = float(all_sections[stems.inside].sum())
    by_seen = float(all_sections[seen].sum()) / share
    total = max(by_seen, stands)
    number = count / share
    low, high = count_interval(count, share)[0], count_interval(count, share, least=found)[1]
    variety = Z95 * variation * float(np.sqrt(number - count))
    # What was found stands there: nothing unseen makes it less.
    lowest = max(by_seen - float(np.hypot((number - low) * usual, variety)), stands)
    highest = max(by_seen + float(np.hypot((high - number) * usual, variety)), stands + (high - found) * usual)
    weight = _weights(stems, share)
    border = (stems.chance * (1.0 - stems.chance) * (all_sections * weight) ** 2).sum()
    missing = spread**2 * ((weight[without] ** 2).sum() + weight[without].sum() ** 2 / len(sections))
    missing += ((weight * rough_std)[by_rough] ** 2).sum()
    known = {
        AT_BORDER: _both(Z95 * float(np.sqrt(border))),
        UPRIGHT: _both(Z95 * level_rel_std * total),
        DIAMETERS: _both(Z95 * _diameters_std(stems, measured, weight)),
        NOT_MEASURED: _both(Z95 * float(np.sqrt(missing))),
    }
    unseen = {UNSEEN: (total - lowest, highest - total), **known}
    # A sum over a random number of stems varies as its number and its sections do together.
    both = float(np.sqrt(usual**2 + variation**2))
    (poisson_low, poisson_high), high_of_all = poisson_interval(count), poisson_interval(found)[1]
    fewest = by_seen - (count - poisson_low) * both / share
    most = max(by_seen + (poisson_high - count) * both / share, stands + (high_of_all - found) * both)
    sampled = {COUNTING: (total - fewest, most - total), **known}
    return _figure(total, unseen, sampled, hectares=area_m2 / M2_PER_HA)


def _deviation(sections_m2: Floats, mean_m2: float) -> float:
    """Standard deviation; of a single stem nobody knows, and it may be as much as the mean."""
    return float(sections_m2.std(ddof=1)) if len(sections_m2) > 1 else mean_m2


def part_per_ha(amounts: Floats, on_seen: NDArray[np.bool_], *, area_m2: float, share: float) -> float:
    """A sum over some stems of the plot (T,) a hectare, counted as the whole plot is: never more than its figure."""
    return float(max(amounts[on_seen].sum() / share, amounts.sum())) * M2_PER_HA / area_m2


def count_interval(count: int, share: float, *, least: int = 0) -> tuple[float, float]:
    """95 % interval of how many there are, of which each was seen with probability ``share`` and ``count`` were.

    ``least`` are known to be there. Exact, of the binomial distribution by its tails (Clopper and Pearson's way, for
    the number of trials); the upper tail among the numbers that are no less than ``least``.
    """
    least = max(least, count)
    if share >= 1.0:
        return float(least), float(least)
    # Beyond ten standard deviations nothing is left of a tail.
    most = int(max(count / share, least) + (10.0 * np.sqrt(least * (1.0 - share)) + 20.0) / share) + 1
    totals = np.arange(count, most + 1, dtype=np.float64)
    # The tails of the binomial distribution as incomplete beta functions: P(X >= count), P(X <= count).
    so_many = betainc(count, totals - count + 1.0, share) if count else np.ones(len(totals))
    so_few = np.r_[1.0, betainc(totals[1:] - count, count + 1.0, 1.0 - share)]
    low, within = totals[so_many > TAIL][0], totals[so_few > TAIL * so_few[least - count]]
    # A tail that is smaller than any number leaves nothing.
    return max(float(low), float(least)), float(within.max(initial=least))


def poisson_interval(count: int) -> tuple[float, float]:
    """95 % interval of the expected number of which ``count`` came (Garwood 1936, exact)."""
    low = float(gammaincinv(count, TAIL)) if count else 0.0
    return low, float(gammaincinv(count + 1.0, 1.0 - TAIL))


def _diameters_std(stems: PlotStems, measured: NDArray[np.bool_], weight: Floats) -> float:
    """Standard deviation, square metres, of the sum of the sections of stems ``measured`` (T,) by ``weight`` (T,)."""
    per_m = (np.pi / 2.0 * stems.dbh_m * weight)[measured]
    std_m = stems.std_m[measured]
    shared_m = np.zeros(len(std_m)) if stems.shared_m is None else np.minimum(stems.shared_m[measured], std_m)
    return float(np.hypot(np.sqrt((per_m**2 * (std_m**2 - shared_m**2)).sum()), (per_m * shared_m).sum()))


def _weights(stems: PlotStems, share: float) -> Floats:
    """How much the plot's total would lose at most with each stem (T,): one on seen ground stands for unseen ones."""
    return np.where(stems.on_seen, 1.0 / share, 1.0)


def _both(half_width: float) -> tuple[float, float]:
    return half_width, half_width


def _figure(
    total: float,
    parts: Mapping[str, tuple[float, float]],
    sampled: Mapping[str, tuple[float, float]],
    *,
    hectares: float,
) -> HectareFigure:
    """Of a plot's total and the distances to either end by cause, to the hectare."""
    (low, high), (stand_low, stand_high) = (_ends(total, given) for given in (parts, sampled))
    named = {name: max(sides) / hectares for name, sides in parts.items()}
    return HectareFigure(
        value=total / hectares,
        lo95=low / hectares,
        hi95=high / hectares,
        parts=named | {COUNTING: max(sampled[COUNTING]) / hectares},
        stand_lo95=stand_low / hectares,
        stand_hi95=stand_high / hectares,
    )


def _ends(total: float, parts: Mapping[str, tuple[float, float]]) -> tuple[float, float]:
    below, above = (float(np.sqrt(sum(sides[side] ** 2 for sides in parts.values()))) for side in range(2))
    return max(total - below, 0.0), total + above
