"""The summary of a batch: tables of all plots, of all trees and of the forest, the same as a workbook, and in JSON."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from fsinfer._version import __version__
from fsinfer.batch.estimates import forest_estimates
from fsinfer.batch.estimates_table import ESTIMATE_COLUMNS, estimate_rows, estimates_json
from fsinfer.batch.outcome import State
from fsinfer.batch.rows import PLOT_COLUMNS, TREE_COLUMNS, PlotRow, PlotTrees, cells
from fsinfer.io.csv_text import write_table
from fsinfer.io.files import remove_old, write_text
from fsinfer.output.json_values import as_json
from fsinfer.output.plot_json import finite
from fsinfer.trees.outputs.workbook import Sheet, write_workbook

SUMMARY_CSV = "summary.csv"
SUMMARY_XLSX = "summary.xlsx"
SUMMARY_JSON = "summary.json"
ESTIMATES_CSV = "estimates.csv"
TREES_FILE = "trees.csv"
#: Rows of a sheet, its header among them. Source: format; XLSX.
MOST_ROWS = 1_048_576


@dataclass(frozen=True, kw_only=True)
class Counts:
    """How many plots stand where, and how many trees they have."""

    plots: int
    done: int
    outdated: int
    failed: int
    waiting: int
    trees: int
    trees_with_dbh: int


def count(rows: Sequence[PlotRow]) -> Counts:
    """Of all rows."""
    of = {state: sum(row.state is state for row in rows) for state in State}
    return Counts(
        plots=len(rows),
        done=of[State.done],
        outdated=of[State.outdated],
        failed=of[State.failed],
        waiting=of[State.waiting],
        trees=sum(row.trees or 0 for row in rows),
        trees_with_dbh=sum(row.trees_with_dbh or 0 for row in rows),
    )


def write_plots(out: Path, rows: Sequence[PlotRow]) -> None:
    """Write the tables of plots and of the forest, and the same in JSON, each atomically.

    Without estimates there is no table of them, and one of before is taken away.
    """
    write_table(out / SUMMARY_CSV, PLOT_COLUMNS, map(cells, rows))
    estimates = forest_estimates(rows)
    if estimates.rows:
        write_table(out / ESTIMATES_CSV, ESTIMATE_COLUMNS, estimate_rows(estimates))
    elif (out / ESTIMATES_CSV).exists():
        remove_old(out / ESTIMATES_CSV, way_out="close the program that shows it, and run the same command again")
    told = {"made_by": __version__, **as_json(count(rows)), "estimates": estimates_json(estimates)}
    told |= {"rows": as_json(rows)}
    write_text(out / SUMMARY_JSON, json.dumps(finite(told), indent=1, ensure_ascii=False, allow_nan=False) + "\n")


def write_trees_and_workbook(out: Path, rows: Sequence[PlotRow], trees: Sequence[PlotTrees]) -> None:
    """Write the table of all trees, and all tables as sheets of a workbook, each atomically.

    Where a sheet cannot hold all trees, the workbook has none of them: ``trees.csv`` has.
    """
    write_table(out / TREES_FILE, TREE_COLUMNS, (tree for plot in trees for tree in plot.text))
    sheets = [Sheet(name="plots", columns=PLOT_COLUMNS, rows=map(cells, rows))]
    if sum(len(plot.values) for plot in trees) < MOST_ROWS:
        values = (tree for plot in trees for tree in plot.values)
        sheets.append(Sheet(name="trees", columns=TREE_COLUMNS, rows=values))
    estimates = forest_estimates(rows)
    if estimates.rows:
        sheets.append(Sheet(name="estimates", columns=ESTIMATE_COLUMNS, rows=estimate_rows(estimates)))
    write_workbook(out / SUMMARY_XLSX, sheets, title="Plots")
