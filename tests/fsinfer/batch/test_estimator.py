"""Ratios over plots: against examples by hand, against the mean of plots, and by how often their intervals hold."""

from __future__ import annotations

import math
from dataclasses import astuple
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from fsinfer.batch.estimator import Estimate, estimate_ratio

Floats = NDArray[np.float64]


def estimate(amounts: Any, others: Any, areas: Any = None, **strata: Any) -> Estimate:
    found = estimate_ratio(
        np.array(amounts, dtype=np.float64),
        np.array(others, dtype=np.float64),
        np.array(others if areas is None else areas, dtype=np.float64),
        **strata,
    )
    assert found is not None
    return found


def close(*values: float | None) -> Any:
    return pytest.approx(values, rel=1e-4)


def test_plots_of_equal_area_by_hand() -> None:
    # 400, 500, 600 and 700 stems/ha on 0.05 ha each: mean 550, s = sqrt(50000 / 3) = 129.10, s / 2 = 64.55;
    # t(3) = 3.18245, half an interval 205.43.
    found = estimate([20, 25, 30, 35], [0.05] * 4)
    assert astuple(found) == close(4, 550.0, 64.5497, 3.0, 344.575, 755.425, 23.4727, 37.3500)


def test_plots_of_different_areas_by_hand() -> None:
    # 100 stems on 0.2 ha; residuals 20 - 25, 30 - 25, 50 - 50: sqrt(3 / 2 * 50) / 0.2 = 43.30; t(2) = 4.30265.
    found = estimate([20, 30, 50], [0.05, 0.05, 0.10])
    assert astuple(found) == close(3, 500.0, 43.3013, 2.0, 313.690, 686.310, 15.0, 37.2621)


def test_means_over_stems_have_their_numbers_below_the_line() -> None:
    # Plots of 2, 4 and 6 stems with mean DBH 30, 20 and 25 cm: 290 / 12 = 24.1667; residuals 35/3, -50/3, 5:
    # sqrt(3 / 2 * (1225 + 2500 + 225) / 9) / 12 = 2.13817. The plots' areas have no say.
    found = estimate([60, 80, 150], [2, 4, 6], [0.05, 0.02, 0.1])
    assert (found.value, found.std_error, found.df) == close(24.16667, 2.138169, 2.0)
    assert astuple(found) == close(*astuple(estimate([60, 80, 150], [2, 4, 6])))


def test_strata_by_hand() -> None:
    # 30 ha with 400, 500, 600 and 10 ha with 200, 300 stems/ha: 0.75 * 500 + 0.25 * 250 = 437.5; variances
    # 0.5625 * 10000 / 3 = 1875 and 0.0625 * 5000 / 2 = 156.25; df = 2031.25² / (1875² / 2 + 156.25²) = 2.31507.
    strata: dict[str, Any] = {"stratum": np.array([0, 1, 0, 1, 0]), "stratum_areas": np.array([30.0, 10.0])}
    found = estimate([20, 10, 25, 15, 30], [0.05] * 5, **strata)
    assert (found.plots, found.value, found.std_error, found.df) == close(5, 437.5, 45.0694, 2.31507)
    assert found.cv_percent is None
    # To 40 ha: 17500 +- 1802.8 stems.
    total = found.times(40.0)
    assert (total.value, total.std_error) == close(17500.0, 1802.78)
    assert (total.df, total.sampling_error_percent) == (found.df, found.sampling_error_percent)


def test_means_over_stems_of_strata_by_hand() -> None:
    # 0.1 ha each. Stratum of 3 ha: 4 and 6 stems, sums of DBH 100 and 140; of 1 ha: 2 and 2 stems, 40 and 60.
    # Totals: DBH 3 * 1200 + 500 = 4100, stems 3 * 50 + 20 = 170: 24.1176. Residuals y - R x: 3.5294, -4.7059 (mean
    # -0.5882) and -8.2353, 11.7647 (mean 1.7647), about their means 4.1176 and 10.
    # Variances: (3 / 0.2)² * 2 * 2 * 4.1176² = 15259.5, (1 / 0.2)² * 2 * 200 = 10000; root / 170 = 0.93490.
    strata: dict[str, Any] = {"stratum": np.array([0, 0, 1, 1]), "stratum_areas": np.array([3.0, 1.0])}
    found = estimate([100, 140, 40, 60], [4, 6, 2, 2], [0.1] * 4, **strata)
    assert (found.value, found.std_error) == close(24.11765, 0.934900)
    assert found.df == pytest.approx(25259.5**2 / (15259.5**2 + 10000.0**2), rel=1e-4)


def test_one_plot_has_no_standard_error() -> None:
    assert estimate([20], [0.05]) == Estimate(plots=1, value=400.0)
    strata: dict[str, Any] = {"stratum": np.array([0, 0, 1]), "stratum_areas": np.array([1.0, 1.0])}
    assert estimate([20, 30, 10], [0.05] * 3, **strata) == Estimate(plots=3, value=350.0)


def test_nothing_to_divide_by() -> None:
    nothing = np.zeros(0)
    assert estimate_ratio(nothing, nothing, nothing) is None
    assert estimate_ratio(np.zeros(2), np.zeros(2), np.ones(2)) is None


def test_plots_without_stems_are_alike() -> None:
    assert astuple(estimate([0, 0, 0], [1, 1, 1])) == (3, 0.0, 0.0, 2.0, 0.0, 0.0, None, None)


def test_no_amount_is_less_than_nothing() -> None:
    found = estimate([0, 0, 30], [1, 1, 1])
    assert found.lo95 == 0.0
    # The sampling error is that of the interval before it was cut.
    assert found.sampling_error_percent is not None
    assert found.sampling_error_percent == pytest.approx(430.265, rel=1e-4)


def test_a_root_has_half_of_the_relative_error() -> None:
    # Sections of 0.04 and 0.06 m²: 0.05 +- 0.01 is 20 %, of the diameter 10 %.
    found = estimate([0.04, 0.06], [1, 1]).root()
    assert (found.value, found.std_error, found.cv_percent) == close(math.sqrt(0.05), math.sqrt(0.05) / 10, 14.1421)
    assert estimate([4.0], [1.0]).root() == Estimate(plots=1, value=2.0)


AMOUNT = st.floats(min_value=0.0, max_value=1e4)
AREA = st.floats(min_value=1e-3, max_value=10.0)
PLOTS = st.lists(st.tuples(AMOUNT, AREA), min_size=2, max_size=12).map(lambda rows: np.array(rows).T)


def figures(found: Estimate) -> list[float]:
    """All but the interval's lower end, which may be cut, and shares of nothing."""
    assert found.std_error is not None
    assert found.df is not None
    assert found.hi95 is not None
    return [found.value, found.std_error, found.df, found.hi95]


@given(plots=PLOTS, units=st.floats(min_value=1e-3, max_value=1e3), area_units=st.floats(min_value=1e-3, max_value=1e3))
def test_units_only_change_units(plots: Floats, units: float, area_units: float) -> None:
    amounts, areas = plots
    found = estimate(amounts, areas)
    again = estimate(units * amounts, area_units * areas)
    tolerance = 1e-9 * units / area_units * float(amounts.max(initial=1.0) / areas.min())
    assert figures(again.times(area_units / units)) == pytest.approx(
        figures(found), rel=1e-6, abs=tolerance * area_units / units
    )


@given(amounts=st.lists(AMOUNT, min_size=2, max_size=12).map(np.array), area=st.floats(min_value=1e-3, max_value=10.0))
def test_plots_of_equal_area_have_the_mean_and_s_by_the_root_of_n(amounts: Floats, area: float) -> None:
    found = estimate(amounts, np.full(len(amounts), area))
    a_hectare = amounts / area
    std_error = float(a_hectare.std(ddof=1)) / math.sqrt(len(amounts))
    tolerance = 1e-9 * float(a_hectare.max(initial=1.0))
    assert found.value == pytest.approx(float(a_hectare.mean()), rel=1e-9)
    assert found.std_error == pytest.approx(std_error, rel=1e-6, abs=tolerance)
    assert found.df == len(amounts) - 1


@given(data=st.data(), plots=PLOTS)
def test_order_does_not_matter(data: st.DataObject, plots: Floats) -> None:
    order = data.draw(st.permutations(range(plots.shape[1])))
    stratum = np.arange(plots.shape[1]) % 2 if plots.shape[1] > 3 else np.zeros(plots.shape[1], dtype=np.intp)
    areas = np.array([7.0, 2.0])[: int(stratum.max()) + 1]
    first = estimate(*plots, stratum=stratum, stratum_areas=areas)
    second = estimate(*plots[:, order], stratum=stratum[order], stratum_areas=areas)
    tolerance = 1e-9 * float(plots[0].max(initial=1.0) / plots[1].min())
    if first.std_error is not None and first.std_error <= 1e3 * tolerance:
        return  # degrees of freedom of rounding errors
    assert figures(second) == pytest.approx(figures(first), rel=1e-6, abs=tolerance)


@given(plots=PLOTS, factor=st.floats(min_value=1e-3, max_value=1e3))
def test_one_stratum_is_none(plots: Floats, factor: float) -> None:
    one = estimate(*plots, stratum=np.zeros(plots.shape[1], dtype=np.intp), stratum_areas=np.array([factor]))
    assert figures(one) == pytest.approx(figures(estimate(*plots)), rel=1e-9)


def drawn(random: np.random.Generator, number: int, *, density: float, alike: bool) -> tuple[Floats, Floats]:
    """Stems on plots in a wood whose density differs from place to place, and the plots' areas in hectares."""
    areas = np.full(number, 0.05) if alike else random.uniform(0.02, 0.08, number)
    here = density * random.gamma(12.0, 1.0 / 12.0, number)
    return random.poisson(here * areas).astype(np.float64), areas


@pytest.mark.parametrize("alike", [True, False])
def test_95_of_100_intervals_hold(*, alike: bool) -> None:
    random = np.random.default_rng(5)
    held = 0
    for _ in range(1500):
        found = estimate(*drawn(random, 9, density=600.0, alike=alike))
        assert found.lo95 is not None
        assert found.hi95 is not None
        held += found.lo95 <= 600.0 <= found.hi95
    # Without the root of n all of them would, with n in its place half of them; six in a thousand is chance.
    assert 0.92 < held / 1500 < 0.97


def test_95_of_100_intervals_over_strata_hold() -> None:
    random = np.random.default_rng(6)
    truth, held = (30.0 * 400.0 + 10.0 * 1500.0) / 40.0, 0
    for _ in range(1500):
        dense, thin = drawn(random, 5, density=1500.0, alike=False), drawn(random, 7, density=400.0, alike=True)
        amounts, areas = (np.concatenate(both) for both in zip(thin, dense, strict=True))
        strata: dict[str, Any] = {"stratum": np.repeat([0, 1], [7, 5]), "stratum_areas": np.array([30.0, 10.0])}
        found = estimate(amounts, areas, **strata)
        assert found.lo95 is not None
        assert found.hi95 is not None
        held += found.lo95 <= truth <= found.hi95
    assert 0.92 < held / 1500 < 0.97


def test_the_standard_error_of_a_ratio_over_strata_is_that_of_the_jackknife() -> None:
    random = np.random.default_rng(0)
    stratum, strata_ha = np.repeat([0, 1], [40, 60]), np.array([30.0, 10.0])
    areas = random.uniform(0.03, 0.08, 100)
    stems = random.poisson(areas * np.where(stratum, 1500.0, 400.0) * random.gamma(12.0, 1.0 / 12.0, 100))
    basal_area = stems * random.normal(np.where(stratum, 0.03, 0.11), 0.015)
    found = estimate(basal_area, stems, areas, stratum=stratum, stratum_areas=strata_ha)
    variance = 0.0
    for one in range(2):
        without = []
        for left_out in np.flatnonzero(stratum == one):
            rest = np.arange(100) != left_out
            of_rest = (basal_area[rest], stems[rest], areas[rest])
            without.append(estimate(*of_rest, stratum=stratum[rest], stratum_areas=strata_ha).value)
        variance += (len(without) - 1) * float(np.var(without))
    # They differ by what is left out of a first order; without the strata it were 0.0030, not 0.0023.
    assert found.std_error == pytest.approx(math.sqrt(variance), rel=0.02)


def test_intervals_of_means_over_stems_hold_where_most_plots_are_empty() -> None:
    """Empty plots counted as if they told of diameters: an interval of 95 % held in 59 % of such forests."""
    rng = np.random.default_rng(0)
    held = []
    for _ in range(2000):
        stems = rng.integers(5, 30, 8) * (rng.random(8) < 0.3)
        found = estimate_ratio(stems * rng.normal(20.0, 4.0, 8), stems.astype(np.float64), np.full(8, 0.05))
        if found is not None and found.lo95 is not None and found.hi95 is not None:
            held.append(found.lo95 <= 20.0 <= found.hi95)
    assert len(held) > 1000
    assert np.mean(held) > 0.92


def test_one_plot_with_stems_among_empty_ones_has_no_standard_error() -> None:
    found = estimate([440.0, 0.0, 0.0], [20.0, 0.0, 0.0], [0.05] * 3)
    assert (found.plots, found.value, found.std_error, found.lo95) == (1, 22.0, None, None)


def test_a_stratum_without_any_stem_does_not_touch_means_over_stems() -> None:
    sums, stems = [400.0, 480.0, 500.0], [20.0, 22.0, 26.0]
    alone = estimate(sums, stems, [0.05] * 3)
    strata = {"stratum": np.array([0, 0, 0, 1, 1]), "stratum_areas": np.array([30.0, 10.0])}
    both = estimate([*sums, 0.0, 0.0], [*stems, 0.0, 0.0], [0.05] * 5, **strata)
    # The coefficient of variation is of one stratum only.
    assert astuple(both)[:6] == close(*astuple(alone)[:6])
