"""The row of a plot in the summary, by what its folder holds."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from fsinfer.batch.estimates import forest_estimates
from fsinfer.batch.outcome import Outcome, State
from fsinfer.batch.plots_table import Plot
from fsinfer.batch.rows import plot_row
from fsinfer.output.json_values import as_json
from fsinfer.output.layout import PLOT_FILE, TREES_CSV
from fsinfer.plot_border.border import Border
from fsinfer.plot_border.plot import plot_of
from fsinfer.plot_border.sight import SeenShare
from fsinfer.trees.outputs.table import write_trees
from fsinfer.trees.stand import stand_of_diameters
from tests.support.stem_maps import tree_of

LEFT_OUT = "875 points far outside the plot were left out"
ONE_BOARD = "the scale rests on one board"


@pytest.mark.parametrize(
    ("coded", "expected"),
    [
        ([(LEFT_OUT, True)], ()),
        ([(LEFT_OUT, True), (ONE_BOARD, False)], (ONE_BOARD,)),
        # An earlier version wrote sentences only.
        (None, (LEFT_OUT, ONE_BOARD)),
    ],
)
def test_remarks_are_no_warnings(
    tmp_path: Path, coded: list[tuple[str, bool]] | None, expected: tuple[str, ...]
) -> None:
    """Nearly every plot has one: each of them counted as a plot with warnings, whose own report said "Nothing"."""
    plot: dict[str, Any] = {"trees": 0, "trees_with_dbh": 0, "warnings": [LEFT_OUT, ONE_BOARD]}
    if coded is not None:
        plot["warning_codes"] = [{"code": "x", "values": {}, "text": text, "remark": remark} for text, remark in coded]
    (tmp_path / PLOT_FILE).write_text(json.dumps(plot), encoding="utf-8")
    write_trees(tmp_path / TREES_CSV, [])
    row, _ = plot_row(Plot(name="a", photos=tmp_path), tmp_path, Outcome(state=State.done))
    assert (row.warnings, row.warning_text) == (len(expected), "; ".join(expected))


@pytest.mark.parametrize("bordered", [True, False])
def test_a_plot_without_stems_is_one_of_the_sample(tmp_path: Path, *, bordered: bool) -> None:
    """Its basal area was an empty cell: the mean of the column was that of the other plots alone."""
    stand = as_json(stand_of_diameters([], 500.0))
    plot: dict[str, Any] = {"trees": 0, "trees_with_dbh": 0, "stand": stand, "plot_area_m2": 500.0}
    if bordered:
        circle = Border(center=(0.0, 0.0), radius_m=12.62, origin="walk", moves_along=True)
        plot["plot_border"] = as_json(plot_of([], circle, SeenShare(share=0.9, method="by eye"), slope_deg=0.0).figures)
    (tmp_path / PLOT_FILE).write_text(json.dumps(plot), encoding="utf-8")
    write_trees(tmp_path / TREES_CSV, [])
    row, _ = plot_row(Plot(name="a", photos=tmp_path), tmp_path, Outcome(state=State.done))
    assert (row.stems_per_ha, row.basal_area_m2_per_ha, row.basal_area_hi95_m2_per_ha) == (0.0, 0.0, None)
    assert row.has_border is bordered
    if bordered:  # hardly seen
        plot["plot_border"] |= {"stems_per_ha": None}
        (tmp_path / PLOT_FILE).write_text(json.dumps(plot), encoding="utf-8")
        row, _ = plot_row(Plot(name="a", photos=tmp_path), tmp_path, Outcome(state=State.done))
        assert row.basal_area_m2_per_ha is None


@pytest.mark.parametrize("bordered", [True, False])
def test_the_mean_diameter_is_that_of_the_stems_on_the_ground_that_counts(tmp_path: Path, *, bordered: bool) -> None:
    stems = [
        tree_of(number, (10.0 * number - 10.0, 0, 0), dbh_cm) for number, dbh_cm in ((1, 20.0), (2, 30.0), (3, 80.0))
    ]
    stand = as_json(stand_of_diameters([20.0, 30.0], 500.0))
    plot: dict[str, Any] = {"trees": 3, "trees_with_dbh": 3, "stand": stand, "plot_area_m2": 500.0}
    if bordered:
        circle = Border(center=(0.0, 0.0), radius_m=12.62, origin="walk", moves_along=True)
        within = plot_of(stems, circle, SeenShare(share=1.0, method="by eye"), slope_deg=0.0)
        plot["plot_border"] = as_json(within.figures)
    (tmp_path / PLOT_FILE).write_text(json.dumps(plot), encoding="utf-8")
    write_trees(tmp_path / TREES_CSV, [])
    oak = Plot(name="a", photos=tmp_path, stratum="oak", stratum_ha=12.5)
    row, _ = plot_row(oak, tmp_path, Outcome(state=State.done))
    assert row.mean_dbh_cm == pytest.approx(25.0)
    assert row.has_border is bordered
    assert (row.stratum, row.stratum_ha) == ("oak", 12.5)
    estimates = forest_estimates([row]).rows
    assert bool(estimates) is bordered
    for estimate in estimates:
        assert estimate.stems_per_ha is not None
        assert estimate.stems_per_ha.value == pytest.approx(2 / (math.pi * 12.62**2) * 1e4)
        assert estimate.quadratic_mean_dbh_cm is not None
        assert estimate.quadratic_mean_dbh_cm.value == pytest.approx(row.quadratic_mean_dbh_cm)
