"""The row of a plot in the summary, by what its folder holds."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

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
    if bordered:  # hardly seen
        plot["plot_border"] |= {"stems_per_ha": None}
        (tmp_path / PLOT_FILE).write_text(json.dumps(plot), encoding="utf-8")
        row, _ = plot_row(Plot(name="a", photos=tmp_path), tmp_path, Outcome(state=State.done))
        assert row.basal_area_m2_per_ha is None
