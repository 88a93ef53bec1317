"""Figures a hectare hold what stands on the plot as often as they say, and no oftener than they must."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.plot_border.hectare import (
    AT_BORDER,
    COUNTING,
    DIAMETERS,
    NOT_MEASURED,
    SCALE,
    UNSEEN,
    UPRIGHT,
    PlotStems,
    basal_area_per_ha,
    count_interval,
    poisson_interval,
    stems_per_ha,
)

AREA_M2 = 500.0


def stems_of(
    dbh_m: NDArray[np.float64],
    *,
    inside: NDArray[np.bool_] | None = None,
    chance: NDArray[np.float64] | None = None,
    std_m: float = 0.0,
) -> PlotStems:
    within = np.ones(len(dbh_m), dtype=bool) if inside is None else inside
    return PlotStems(
        inside=within,
        chance=within.astype(np.float64) if chance is None else chance,
        dbh_m=dbh_m,
        std_m=np.full(len(dbh_m), std_m),
    )


def test_a_plot_that_was_seen_whole_is_what_was_counted() -> None:
    figure = stems_per_ha(stems_of(np.full(24, 0.3)), area_m2=AREA_M2, share=1.0, scale_rel_std=0.0)
    assert (figure.value, figure.lo95, figure.hi95) == pytest.approx((480, 480, 480))
    # As a sample of the stand 24 is 15.4 to 35.7 (Garwood's table).
    assert (figure.stand_lo95, figure.stand_hi95) == pytest.approx((307.5, 714.2), abs=0.5)
    basal = basal_area_per_ha(stems_of(np.full(24, 0.3)), area_m2=AREA_M2, share=1.0)
    assert basal is not None
    assert (basal.value, basal.lo95, basal.hi95) == pytest.approx((33.93, 33.93, 33.93), abs=0.01)


def test_of_the_stand_half_a_plot_tells_what_a_plot_of_half_the_size_does() -> None:
    stems = stems_of(np.random.default_rng(2).uniform(0.1, 0.5, 24))
    half_seen, half = (
        (
            stems_per_ha(stems, area_m2=area_m2, share=share, scale_rel_std=0.0),
            basal_area_per_ha(stems, area_m2=area_m2, share=share),
        )
        for area_m2, share in ((AREA_M2, 0.5), (AREA_M2 / 2, 1.0))
    )
    for one, other in zip(half_seen, half, strict=True):
        assert one is not None
        assert other is not None
        assert (one.value, one.stand_lo95, one.stand_hi95) == pytest.approx(
            (other.value, other.stand_lo95, other.stand_hi95)
        )
        assert one.hi95 > other.hi95


def test_exact_counts() -> None:
    # 19 of how many, of which each was seen with probability 0.95? At most 23: P(X <= 19 | 24) is 0.03, of 25 0.007 ...
    low, high = count_interval(19, 0.95)
    assert low == 19
    from scipy.stats import binom

    assert binom.cdf(19, high, 0.95) > 0.025 >= binom.cdf(19, high + 1, 0.95)
    low, high = count_interval(10, 0.4)
    assert binom.sf(9, low, 0.4) > 0.025 >= binom.sf(9, low - 1, 0.4)
    assert binom.cdf(10, high, 0.4) > 0.025 >= binom.cdf(10, high + 1, 0.4)
    # Nothing seen on half of it: up to five may stand on the other.
    assert count_interval(0, 0.5) == (0.0, 5.0)
    assert poisson_interval(0) == pytest.approx((0.0, 3.689), abs=1e-3)
    assert poisson_interval(10) == pytest.approx((4.795, 18.390), abs=1e-3)


def test_the_stems_behind_what_was_not_seen_are_in_the_interval() -> None:
    # Three plots of five are seen to 70 %: 30 stems stand on each, anywhere.
    rng = np.random.default_rng(43000)
    inside = width = 0.0
    for _ in range(2000):
        seen = int(rng.binomial(30, 0.7))
        figure = stems_per_ha(stems_of(np.full(seen, 0.3)), area_m2=AREA_M2, share=0.7, scale_rel_std=0.0)
        inside += figure.lo95 <= 600.0 <= figure.hi95
        width += (figure.hi95 - figure.lo95) / 2000
    assert 0.945 <= inside / 2000 <= 0.985
    # Half of it, or twice as much, is not what the binomial distribution has: 2 x 1.96 x sqrt(30 x 0.7 x 0.3) / 0.7.
    assert width == pytest.approx(280, rel=0.15)


def test_basal_area_holds_diameters_unseen_ground_and_stems_without_a_dbh() -> None:
    rng = np.random.default_rng(43001)
    inside = {"dbh": 0, "unseen": 0, "missing": 0}
    rounds = 1500
    for _ in range(rounds):
        true = rng.uniform(0.1, 0.5, 40)
        total = float((np.pi / 4 * true**2).sum()) / 0.05
        measured = true + rng.normal(0, 0.02, 40)
        seen = rng.random(40) < 0.75
        unmeasured = np.where(rng.random(40) < 0.25, np.nan, true)
        for name, stems, share in (
            ("dbh", stems_of(measured, std_m=0.02), 1.0),
            ("unseen", stems_of(true[seen]), 0.75),
            ("missing", stems_of(unmeasured), 1.0),
        ):
            figure = basal_area_per_ha(stems, area_m2=AREA_M2, share=share)
            assert figure is not None
            inside[name] += figure.lo95 <= total <= figure.hi95
    # With a standard deviation half or twice as large these would be 67 or 99.99 %.
    assert {name: 0.925 <= count / rounds <= 0.985 for name, count in inside.items()} == dict.fromkeys(inside, True)


def test_the_stand_is_in_the_wider_interval() -> None:
    rng = np.random.default_rng(43002)
    of_stems = of_basal = 0
    rounds = 1500
    mean_section = np.pi / 4 * np.mean(np.linspace(0.1, 0.5, 2001) ** 2)
    for _ in range(rounds):
        # 500 a hectare, seen on nine tenths of 500 m².
        dbh = rng.uniform(0.1, 0.5, rng.poisson(500 * 0.05 * 0.9))
        stems = stems_of(dbh)
        count = stems_per_ha(stems, area_m2=AREA_M2, share=0.9, scale_rel_std=0.0)
        basal = basal_area_per_ha(stems, area_m2=AREA_M2, share=0.9)
        assert basal is not None
        of_stems += int(count.stand_lo95 <= 500 <= count.stand_hi95)
        of_basal += int(basal.stand_lo95 <= 500 * mean_section <= basal.stand_hi95)
    assert 0.945 <= of_stems / rounds <= 0.98
    assert 0.93 <= of_basal / rounds <= 0.98


def test_parts_are_named_and_of_the_right_size() -> None:
    inside = np.array([True] * 20 + [False] * 2)
    chance = inside.astype(np.float64)
    chance[[0, 21]] = [0.8, 0.3]
    stems = stems_of(np.full(22, 0.4), inside=inside, chance=chance, std_m=0.01)
    count = stems_per_ha(stems, area_m2=AREA_M2, share=1.0, scale_rel_std=0.01)
    assert count.value == pytest.approx(400)
    assert count.parts[AT_BORDER] == pytest.approx(20 * 1.96 * np.sqrt(0.8 * 0.2 + 0.3 * 0.7))
    # A scale that is 1 % off makes the plot 2 % larger or smaller.
    assert count.parts[SCALE] == pytest.approx(1.96 * 0.02 * 400)
    assert count.parts[UNSEEN] == 0
    assert count.parts[COUNTING] > count.parts[AT_BORDER]
    assert count.hi95 - count.value == pytest.approx(np.hypot(count.parts[AT_BORDER], count.parts[SCALE]))
    basal = basal_area_per_ha(stems, area_m2=AREA_M2, share=1.0)
    assert basal is not None
    # Square metres a square metre do not know how long a metre is.
    assert set(basal.parts) == {UNSEEN, AT_BORDER, UPRIGHT, DIAMETERS, NOT_MEASURED, COUNTING}
    assert basal.parts[DIAMETERS] == pytest.approx(20 * 1.96 * np.pi / 2 * 0.4 * 0.01 * np.sqrt(20))
    assert basal.parts[AT_BORDER] == pytest.approx(count.parts[AT_BORDER] * np.pi / 4 * 0.16)


def test_saplings_count_as_what_is_known_of_them() -> None:
    dbh = np.r_[np.full(20, 0.4), np.full(10, np.nan)]
    given = stems_of(dbh)
    by_mean = basal_area_per_ha(given, area_m2=AREA_M2, share=1.0)
    rough = np.r_[np.full(20, np.nan), np.full(9, 0.06), np.nan]
    known = replace(given, rough_m=rough, rough_std_m=np.where(np.isfinite(rough), 0.01, np.nan))
    by_rough = basal_area_per_ha(known, area_m2=AREA_M2, share=1.0)
    assert by_mean is not None
    assert by_rough is not None
    section = np.pi / 4 * np.array([0.16, 0.0036])
    assert by_mean.value == pytest.approx(30 * section[0] / 0.05)
    assert by_rough.value == pytest.approx((21 * section[0] + 9 * section[1]) / 0.05)
    # All measured stems are alike: of the one without anything known nothing is uncertain, of the saplings a little.
    assert by_mean.parts[NOT_MEASURED] == pytest.approx(0.0, abs=1e-9)
    assert by_rough.parts[NOT_MEASURED] == pytest.approx(1.96 * 3 * np.pi / 2 * 0.06 * 0.01 / 0.05)
    # A stand of so many and such stems: the sum of so many squares (compound Poisson), not of as many mean trees.
    thin = np.r_[np.full(10, 0.3), np.full(90, np.nan)]
    saplings = stems_of(thin)
    nan = np.full(10, np.nan)
    saplings = replace(saplings, rough_m=np.r_[nan, np.full(90, 0.06)], rough_std_m=np.r_[nan, np.full(90, 1e-6)])
    figure = basal_area_per_ha(saplings, area_m2=AREA_M2, share=1.0)
    assert figure is not None
    squares = (np.pi / 4) ** 2 * (10 * 0.3**4 + 90 * 0.06**4)
    assert figure.value - figure.stand_lo95 == pytest.approx(1.96 * np.sqrt(squares) / 0.05, rel=0.15)
    # With no mean at all they count all the same.
    one = replace(given, dbh_m=dbh[19:29], inside=given.inside[:10], chance=given.chance[:10], std_m=given.std_m[:10])
    assert basal_area_per_ha(one, area_m2=AREA_M2, share=1.0) is None
    told = replace(one, rough_m=rough[19:29], rough_std_m=np.full(10, 0.01))
    assert basal_area_per_ha(told, area_m2=AREA_M2, share=1.0) is not None


def test_what_all_stems_share_does_not_average_out() -> None:
    rng = np.random.default_rng(43004)
    inside = {"shared": 0, "own": 0}
    rounds = 1500
    for _ in range(rounds):
        true = rng.uniform(0.1, 0.5, 40)
        total = float((np.pi / 4 * true**2).sum()) / 0.05
        # Bark that a curve does not follow is a quarter of each variance, and the same in all stems.
        measured = true + 0.01 * rng.normal() + 0.01 * np.sqrt(3) * rng.normal(size=40)
        given = stems_of(measured, std_m=0.02)
        for name, stems in (("shared", replace(given, shared_m=np.full(40, 0.01))), ("own", given)):
            figure = basal_area_per_ha(stems, area_m2=AREA_M2, share=1.0)
            assert figure is not None
            inside[name] += figure.lo95 <= total <= figure.hi95
    assert 0.93 <= inside["shared"] / rounds <= 0.97
    assert inside["own"] / rounds < 0.75
    # More than all of it cannot be shared.
    most = basal_area_per_ha(replace(given, shared_m=np.full(40, 0.5)), area_m2=AREA_M2, share=1.0)
    assert most is not None
    assert most.parts[DIAMETERS] == pytest.approx(1.96 * 20 * (np.pi / 2 * measured * 0.02).sum(), rel=1e-3)


def test_where_nothing_can_be_said_of_basal_area() -> None:
    nothing = np.full(3, np.nan)
    assert basal_area_per_ha(stems_of(nothing), area_m2=AREA_M2, share=1.0) is None
    assert basal_area_per_ha(stems_of(nothing[:0]), area_m2=AREA_M2, share=1.0) is None
    assert basal_area_per_ha(stems_of(np.array([0.3, np.nan])), area_m2=AREA_M2, share=1.0) is None
    one = basal_area_per_ha(stems_of(np.array([0.3])), area_m2=AREA_M2, share=1.0)
    assert one is not None
    assert one.value == pytest.approx(np.pi / 4 * 0.09 / 0.05)
    empty = stems_per_ha(stems_of(nothing[:0]), area_m2=AREA_M2, share=0.8, scale_rel_std=0.0)
    assert (empty.value, empty.lo95) == (0, 0)
    assert empty.hi95 == pytest.approx(20 * count_interval(0, 0.8)[1])


def test_stems_on_unseen_ground_count_once() -> None:
    # 30 stems of 0.3 m stand on the plot and all were found; 12 of them on the 40 % that count as seen.
    seen = np.arange(30) < 12
    stems = replace(stems_of(np.full(30, 0.3)), seen=seen)
    count = stems_per_ha(stems, area_m2=AREA_M2, share=0.4, scale_rel_std=0.0)
    assert (count.value, count.lo95) == pytest.approx((600, 600))
    assert 700 < count.hi95 < 1000
    basal = basal_area_per_ha(stems, area_m2=AREA_M2, share=0.4)
    assert basal is not None
    assert (basal.value, basal.lo95) == pytest.approx((600 * np.pi / 4 * 0.09,) * 2)
    assert basal.hi95 / basal.value == pytest.approx(count.hi95 / count.value, rel=0.01)
    # Ten more on the seen part stand for fifteen on the rest, of which it has some already.
    more = replace(stems_of(np.full(30, 0.3)), seen=np.arange(30) < 22)
    assert stems_per_ha(more, area_m2=AREA_M2, share=0.4, scale_rel_std=0.0).value == pytest.approx(22 / 0.4 / 0.05)
    # Thick stems on unseen ground are the plot's own, and no others are like them.
    thick = replace(stems_of(np.where(seen, 0.2, 0.6)), seen=seen)
    basal = basal_area_per_ha(thick, area_m2=AREA_M2, share=0.4)
    assert basal is not None
    assert basal.value == pytest.approx(np.pi / 4 * (12 * 0.04 + 18 * 0.36) / 0.05)
    assert basal.lo95 == pytest.approx(basal.value)
    assert basal.hi95 > basal.value
    # Where most of what was found stands on unseen ground, more of it may.
    dense = replace(stems_of(np.full(30, 0.3)), seen=np.arange(30) < 2)
    assert stems_per_ha(dense, area_m2=AREA_M2, share=0.5, scale_rel_std=0.0).hi95 > 600


def test_intervals_hold_where_stems_on_unseen_ground_are_found() -> None:
    rng = np.random.default_rng(43003)
    rounds = 1000
    inside = {"stems": 0, "basal": 0, "stand": 0}
    for _ in range(rounds):
        true = rng.uniform(0.1, 0.5, rng.poisson(30))
        seen = rng.random(len(true)) < 0.6
        found = seen | (rng.random(len(true)) < 0.5)
        stems = replace(stems_of(true[found]), seen=seen[found])
        count = stems_per_ha(stems, area_m2=AREA_M2, share=0.6, scale_rel_std=0.0)
        basal = basal_area_per_ha(stems, area_m2=AREA_M2, share=0.6)
        assert basal is not None
        inside["stems"] += count.lo95 <= len(true) / 0.05 <= count.hi95
        inside["basal"] += basal.lo95 <= np.pi / 4 * (true**2).sum() / 0.05 <= basal.hi95
        inside["stand"] += count.stand_lo95 <= 600 <= count.stand_hi95
    # All that were found stand there for certain: the lower end misses less often than its 2.5 %.
    assert {name: number / rounds >= 0.94 for name, number in inside.items()} == dict.fromkeys(inside, True), inside
