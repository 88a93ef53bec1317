"""Which plots tell of the forest, how they are put together over strata, and what is said of those that do not."""

from __future__ import annotations

import math
from typing import Any

import pytest

from fsinfer.batch.estimates import ForestEstimates, ForestFigures, Method, Scope, forest_estimates
from fsinfer.batch.estimates_table import ESTIMATE_COLUMNS, estimate_rows, estimates_json
from fsinfer.batch.estimator import Estimate
from fsinfer.batch.outcome import State
from fsinfer.batch.rows import PlotRow
from fsinfer.notices.notice import Notice


def plot(name: str, stems_per_ha: float | None, **figures: Any) -> PlotRow:
    """Of 500 m² within its border; 0.05 m² of basal area a stem, and a mean DBH of 24 cm, unless told otherwise."""
    known: dict[str, Any] = {"state": State.done, "has_border": True, "area_m2": 500.0, "units": "m"}
    if stems_per_ha is not None:
        known |= {"stems_per_ha": stems_per_ha, "basal_area_m2_per_ha": 0.05 * stems_per_ha, "mean_dbh_cm": 24.0}
    return PlotRow(**known | {"plot": name} | figures)


def estimated(estimate: Estimate | None) -> tuple[Any, ...]:
    assert estimate is not None
    return estimate.plots, estimate.value, estimate.std_error


def codes(estimates: ForestEstimates) -> list[str]:
    return [given.code for given in estimates.notices]


def names(given: Notice) -> Any:
    return given.values["names"]


def test_the_mean_of_equal_plots() -> None:
    estimates = forest_estimates([plot("a", 400.0), plot("b", 500.0, state=State.outdated), plot("c", 600.0)])
    (row,) = estimates.rows
    assert (row.scope, row.method, row.plots, row.sampled_m2, row.area_ha) == (Scope.all, Method.mean, 3, 1500.0, None)
    assert estimated(row.stems_per_ha) == pytest.approx((3, 500.0, 100.0 / math.sqrt(3.0)))
    assert estimated(row.basal_area_m2_per_ha) == pytest.approx((3, 25.0, 5.0 / math.sqrt(3.0)))
    # Each stem has 0.05 m²: the diameters are alike everywhere.
    assert estimated(row.quadratic_mean_dbh_cm) == pytest.approx((3, 200.0 * math.sqrt(0.05 / math.pi), 0.0))
    assert estimated(row.mean_dbh_cm) == pytest.approx((3, 24.0, 0.0), abs=1e-9)
    assert (row.stems, row.basal_area_m2) == (None, None)
    assert estimates.notices == ()


def test_plots_of_different_areas_count_by_their_area() -> None:
    rows = [plot("a", 400.0), plot("b", 600.0), plot("c", 500.0, area_m2=1000.0)]
    (row,) = forest_estimates(rows).rows
    assert row.method is Method.ratio
    assert estimated(row.stems_per_ha) == pytest.approx((3, 500.0, math.sqrt(75.0) / 0.2))


def test_diameters_are_those_of_the_mean_stem_not_of_the_mean_plot() -> None:
    rows = [
        plot("dense", 1800.0, basal_area_m2_per_ha=1800.0 * 0.01, mean_dbh_cm=10.0),
        plot("thin", 200.0, basal_area_m2_per_ha=200.0 * 0.11, mean_dbh_cm=30.0),
        plot("empty", 0.0, basal_area_m2_per_ha=0.0, mean_dbh_cm=None),
    ]
    (row,) = forest_estimates(rows).rows
    # 90 stems and 10, of 100: 0.9 * 0.01 + 0.1 * 0.11 = 0.02 m² each.
    assert row.quadratic_mean_dbh_cm is not None
    assert row.quadratic_mean_dbh_cm.value == pytest.approx(200.0 * math.sqrt(0.02 / math.pi))
    assert row.mean_dbh_cm is not None
    assert row.mean_dbh_cm.value == pytest.approx(12.0)
    assert row.mean_dbh_cm.plots == row.quadratic_mean_dbh_cm.plots == 2  # not the empty one


def test_what_does_not_count_is_named() -> None:
    rows = [
        plot("a", 400.0),
        plot("b", 500.0),
        PlotRow(plot="broken", state=State.failed),
        PlotRow(plot="late", state=State.waiting),
        plot("seen", 300.0, has_border=False, per_hectare_of="seen ground only"),
        plot("unscaled", None, has_border=False, units="model units"),
        plot("hidden", None),
        plot("thick", 450.0, basal_area_m2_per_ha=None, mean_dbh_cm=None),
    ]
    estimates = forest_estimates(rows)
    left, unknown = estimates.notices
    assert (left.code, left.values["plots"], left.values["of"]) == ("plots_left_out", 5, 8)
    why = left.values["why"]
    assert isinstance(why, tuple)
    assert [(given.code, names(given)) for given in why if isinstance(given, Notice)] == [
        ("left_failed", ("broken",)),
        ("left_waiting", ("late",)),
        ("left_without_scale", ("unscaled",)),
        ("left_without_border", ("seen",)),
        ("left_hardly_seen", ("hidden",)),
    ]
    assert (unknown.code, names(unknown)) == ("basal_area_unknown", ("thick",))
    (row,) = estimates.rows
    assert estimated(row.stems_per_ha)[:2] == (3, pytest.approx(450.0))
    assert estimated(row.basal_area_m2_per_ha)[:2] == (2, pytest.approx(22.5))


def test_many_names_are_cut_short() -> None:
    rows = [plot("a", 1.0), *(PlotRow(plot=str(number), state=State.failed) for number in range(40))]
    why = forest_estimates(rows).notices[0].values["why"]
    assert isinstance(why, tuple)
    assert isinstance(why[0], Notice)
    assert names(why[0])[-2:] == ("11", "and 28 more")


@pytest.mark.parametrize(
    ("rows", "code"),
    [
        ([plot("a", 77.0, has_border=False), PlotRow(plot="b", state=State.failed)], "no_borders"),
        ([plot("a", None, has_border=False, units="model units"), plot("b", 77.0, has_border=False)], "no_plot_counts"),
        ([PlotRow(plot="a", state=State.waiting)], "no_plot_counts"),
        ([plot("a", None)], "no_plot_counts"),
        ([plot("a", 400.0, area_m2=0.0)], "no_plot_counts"),
    ],
)
def test_without_a_plot_that_counts_there_is_nothing_but_the_reason(rows: list[PlotRow], code: str) -> None:
    estimates = forest_estimates(rows)
    assert (estimates.rows, codes(estimates)) == ((), [code])
    assert estimate_rows(estimates) == []


def test_one_plot_says_that_it_is_one() -> None:
    estimates = forest_estimates([plot("a", 400.0)])
    assert codes(estimates) == ["one_plot"]
    assert estimates.rows[0].stems_per_ha == Estimate(plots=1, value=400.0)


def test_plots_without_any_stem_say_so() -> None:
    empty = [plot(name, 0.0, mean_dbh_cm=None) for name in "ab"]
    estimates = forest_estimates(empty)
    assert codes(estimates) == ["no_stems"]
    (row,) = estimates.rows
    assert (row.quadratic_mean_dbh_cm, row.mean_dbh_cm) == (None, None)
    assert estimated(row.basal_area_m2_per_ha) == (2, 0.0, 0.0)


BEECH: dict[str, Any] = {"stratum": "beech", "stratum_ha": 30.0}
SPRUCE: dict[str, Any] = {"stratum": "spruce", "stratum_ha": 10.0}


def by_stratum(estimates: ForestEstimates) -> dict[str, ForestFigures]:
    return {row.stratum: row for row in estimates.rows if row.scope is Scope.stratum}


def strata() -> list[PlotRow]:
    return [
        plot("b1", 400.0, **BEECH), plot("s1", 200.0, **SPRUCE), plot("b2", 500.0, **BEECH),
        plot("s2", 300.0, **SPRUCE), plot("b3", 600.0, **BEECH),
    ]  # fmt: skip


def test_strata_count_by_their_area() -> None:
    estimates = forest_estimates(strata())
    of_all = estimates.rows[0]
    assert (of_all.scope, of_all.method, of_all.area_ha) == (Scope.all, Method.stratified, 40.0)
    assert estimated(of_all.stems_per_ha) == pytest.approx((5, 437.5, 45.06939))
    assert of_all.stems_per_ha is not None
    assert of_all.stems_per_ha.df == pytest.approx(2.315068)
    assert estimated(of_all.stems) == pytest.approx((5, 17500.0, 1802.776))
    assert estimated(of_all.basal_area_m2) == pytest.approx((5, 875.0, 90.13878))
    own = by_stratum(estimates)
    assert list(own) == ["beech", "spruce"]
    assert estimated(own["beech"].stems_per_ha) == pytest.approx((3, 500.0, 57.73503))
    assert estimated(own["spruce"].stems) == pytest.approx((2, 2500.0, 500.0))
    assert estimates.notices == ()


def test_strata_without_an_area_are_left_aside_in_all() -> None:
    rows = [*strata(), plot("c", 400.0)]
    estimates = forest_estimates(rows)
    (told,) = [given for given in estimates.notices if given.code == "strata_without_area"]
    assert names(told) == ("plots without a stratum",)
    of_all = estimates.rows[0]
    assert (of_all.method, of_all.area_ha, of_all.stems) == (Method.mean, None, None)
    assert estimated(of_all.stems_per_ha)[:2] == (6, pytest.approx(400.0))
    # What is known of each stratum stands there all the same.
    own = by_stratum(estimates)
    assert list(own) == ["beech", "spruce", ""]
    assert own["beech"].stems is not None
    # Its one plot is no stratum of one plot: the sentence named a stratum without a name.
    assert codes(estimates) == ["strata_without_area"]


def test_a_stratum_without_a_plot_that_counts_is_no_part_of_all() -> None:
    lost = plot("p", 100.0, stratum="pine", stratum_ha=5.0, state=State.failed, has_border=None)
    estimates = forest_estimates([*strata(), lost])
    assert estimates.rows[0].area_ha == 40.0
    assert codes(estimates) == ["plots_left_out", "strata_without_plots"]
    assert names(estimates.notices[1]) == ("pine",)
    assert "pine" not in by_stratum(estimates)


def test_a_stratum_with_one_plot_has_no_standard_error_nor_has_all() -> None:
    estimates = forest_estimates([*strata(), plot("p", 100.0, stratum="pine", stratum_ha=5.0)])
    assert codes(estimates) == ["strata_of_one_plot"]
    of_all = estimates.rows[0]
    assert estimated(of_all.stems_per_ha) == (6, pytest.approx((30 * 500 + 10 * 250 + 5 * 100) / 45), None)


def test_a_stratum_without_basal_area_leaves_all_without_one() -> None:
    bare = {"stratum": "pine", "stratum_ha": 5.0, "basal_area_m2_per_ha": None, "mean_dbh_cm": None}
    estimates = forest_estimates([*strata(), *(plot(name, 100.0, **bare) for name in ("p", "q"))])
    assert codes(estimates) == ["basal_area_unknown", "strata_without_basal_area"]
    of_all = estimates.rows[0]
    assert of_all.stems_per_ha is not None
    assert (of_all.basal_area_m2_per_ha, of_all.quadratic_mean_dbh_cm, of_all.basal_area_m2) == (None, None, None)


def test_one_stratum_with_its_area_gives_totals() -> None:
    estimates = forest_estimates([row for row in strata() if row.stratum == "beech"])
    of_all, beech = estimates.rows
    assert (of_all.method, of_all.area_ha) == (Method.mean, 30.0)
    assert of_all.stems == beech.stems
    assert estimated(of_all.stems) == pytest.approx((3, 15000.0, 1732.051))


def test_an_area_in_another_unit_is_told() -> None:
    rows = [plot(name, 400.0, stratum="beech", stratum_ha=0.03) for name in "ab"]
    assert codes(forest_estimates(rows)) == ["strata_smaller_than_plots"]


def test_the_table_has_a_row_for_all_and_one_a_stratum() -> None:
    estimates = forest_estimates([*strata(), PlotRow(plot="x", state=State.failed, **SPRUCE)])
    of_all, beech, _ = (dict(zip(ESTIMATE_COLUMNS, row, strict=True)) for row in estimate_rows(estimates))
    assert len(set(ESTIMATE_COLUMNS)) == len(ESTIMATE_COLUMNS)
    assert (of_all["scope"], of_all["stratum"], of_all["method"], of_all["area_ha"]) == ("all", "", "stratified", 40.0)
    assert (of_all["stems_per_ha"], of_all["stems_per_ha_se"], of_all["stems_df"]) == (437.5, 45.1, 2.32)
    assert (of_all["stems"], of_all["stems_se"], of_all["basal_area_m2"]) == (17500.0, 1803.0, 875.0)
    assert (beech["scope"], beech["stratum"], beech["plots"], beech["sampled_m2"]) == ("stratum", "beech", 3, 1500.0)
    # 25 +- t(2) 2.8868: 12.421, half of them 49.68 %.
    assert (beech["basal_area_lo95_m2_per_ha"], beech["basal_area_hi95_m2_per_ha"]) == (12.579, 37.421)
    assert (beech["basal_area_cv_percent"], beech["basal_area_sampling_error_percent"]) == (20.0, 49.68)
    assert "left out: 1 of 6 plots (1 failed: x)" in str(of_all["remarks"])
    assert beech["remarks"] == ""
    told = estimates_json(estimates)
    assert told["rows"][1]["stems_per_ha"]["value"] == pytest.approx(500.0)
    assert told["notices"][0]["code"] == "plots_left_out"
    assert "1 failed: x" in told["notices"][0]["text"]
