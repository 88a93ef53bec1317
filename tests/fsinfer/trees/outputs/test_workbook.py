"""The workbook of a plot: the same figures as the CSV files, and no text that a spreadsheet would run."""

from __future__ import annotations

import tempfile
import zipfile
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fsinfer.errors import OutputError
from fsinfer.io.csv_text import write_table
from fsinfer.trees.measure import PlotResult, analyse_plot
from fsinfer.trees.outputs.table import COLUMNS, read_trees, table_row
from fsinfer.trees.outputs.workbook import Sheet, write_tables, write_workbook
from fsinfer.trees.stand import StandTable
from fsinfer.trees.stem_curve import COLUMNS as CURVE_COLUMNS
from tests.support.workbook import read_sheets

Plot = Callable[..., PlotResult]
DANGEROUS = ('=HYPERLINK("http://a.example","see")', "+1+1", "-1+1", "@SUM(A1)", "http://a.example", "{=1+1}", "12")


@pytest.fixture(scope="module")
def found() -> PlotResult:
    """A plot without trees."""
    rng = np.random.default_rng(0)
    return analyse_plot(np.column_stack([rng.uniform(0, 6, (8000, 2)), rng.normal(0, 0.01, 8000)]))


@pytest.fixture
def plot(found: PlotResult, tmp_path: Path) -> Plot:
    """Make a plot of trees with these reasons, the second of them not measured."""

    def make(*reasons: str) -> PlotResult:
        rows = []
        for number, reason in enumerate(reasons, start=1):
            dbh = (None, None, None) if number == 2 else (23.456, 22.1, 24.9)
            place = (number, -12.3456, 4.5, 0.1254)
            rest = (None, None, None, 1.3, 0.75, 1234, None, 2.345, None)
            border = (True, 1.25, False)
            rows.append((*place, *dbh, *rest, "unmeasured" if number == 2 else "ok", reason, *border))
        write_table(tmp_path / "rows.csv", COLUMNS, rows)
        trees = read_trees(tmp_path / "rows.csv")
        (tmp_path / "rows.csv").unlink()
        # Noise of the bark that came out as no number must not get into a workbook.
        trees = [replace(tree, residual_cm=float("nan")) for tree in trees]
        return replace(found, trees=tuple(trees), plot_area_m2=400.0, seen_ground=None)

    return make


def point(height_m: float, diameter_cm: float | None, reason: str = "") -> Any:
    std_cm = None if diameter_cm is None else 0.123
    return SimpleNamespace(
        tree_id=1, height_m=height_m, diameter_cm=diameter_cm, std_cm=std_cm, arc_coverage=0.5, points=50, reason=reason
    )


CURVES: dict[int, Any] = {1: (point(1.0, 24.512), point(2.0, None, "=1+1"))}


def test_sheets_hold_what_the_csv_files_hold(plot: Plot, tmp_path: Path) -> None:
    path = tmp_path / "trees.xlsx"
    result = plot("", 'a < b & "c" ä')
    write_tables(path, result, CURVES)
    trees, stand, curve = read_sheets(path)
    assert [sheet.name for sheet in (trees, stand, curve)] == ["trees", "stand", "stem curve"]
    rows = trees.rows()
    assert tuple(rows[0]) == COLUMNS
    for row, expected in zip(rows[1:], map(table_row, result.trees), strict=True):
        # NaN and empty texts are empty cells.
        assert row == [None if value in (None, "") or value != value else value for value in expected]
    assert trees.values["E2"] == 23.46
    assert "N2" not in trees.values
    assert "E3" not in trees.values
    assert stand.rows()[0][1] == "value"
    assert [row[0] for row in stand.rows()] == ["figure", *(field.name for field in fields(StandTable))]
    assert {row[0]: row[1] for row in stand.rows()[1:]}["stems_per_ha"] == pytest.approx(50.0)
    assert curve.rows() == [
        list(CURVE_COLUMNS), [1, 1.0, 24.51, 0.12, 0.5, 50, None], [1, 2.0, None, None, 0.5, 50, "=1+1"],
    ]  # fmt: skip


def test_a_plot_with_a_border_has_a_sheet(plot: Plot, tmp_path: Path) -> None:
    figures: tuple[tuple[str, str | float], ...] = (
        ("radius_m", 12.62),
        ("stems_per_ha", 480.4),
        ("basal_area_m2_lo95_per_ha", 31.42),
        ("border_round", "marker 7"),
    )
    write_tables(tmp_path / "trees.xlsx", plot(""), CURVES, plot=figures)
    trees, stand, sheet, _ = read_sheets(tmp_path / "trees.xlsx")
    # Both have stems a hectare, and a forester has to see which are whose.
    assert (stand.name, stand.rows()[0]) == ("stand", ["figure", "of the seen ground"])
    assert sheet.rows()[0] == ["figure", "of the plot within its border"]
    assert (sheet.name, sheet.rows()[1:]) == ("plot", [list(row) for row in figures])
    assert (sheet.formats["B2"], sheet.formats["B3"], sheet.formats["B4"]) == ("0.00", "0", "0.0")
    assert trees.rows()[1][-4:-1] == [True, 1.25, False]


def test_numbers_are_shown_by_their_unit(plot: Plot, tmp_path: Path) -> None:
    write_tables(tmp_path / "trees.xlsx", plot(""), CURVES)
    trees, stand, curve = read_sheets(tmp_path / "trees.xlsx")
    shown = {column: trees.formats[f"{chr(ord('A') + index)}2"] for index, column in enumerate(COLUMNS)
             if f"{chr(ord('A') + index)}2" in trees.formats}  # fmt: skip
    assert (shown["x_m"], shown["dbh_cm"], shown["lean_deg"], shown["arc_coverage"]) == ("0.00", "0.0", "0.0", "0.00")
    assert (shown["tree_id"], shown["points"], shown["status"]) == ("General", "General", "General")
    by_figure = {row[0]: stand.formats.get(f"B{number}") for number, row in enumerate(stand.rows(), start=1)}
    assert (by_figure["stems_per_ha"], by_figure["basal_area_m2_per_ha"], by_figure["stems"]) == ("0", "0.0", "General")
    assert by_figure["plot_area_m2"] == by_figure["mean_dbh_cm"] == "0.0"
    assert (curve.formats["B2"], curve.formats["C2"]) == ("0.00", "0.0")


def test_the_header_is_bold_and_stays_and_columns_are_wide_enough(plot: Plot, tmp_path: Path) -> None:
    write_tables(tmp_path / "trees.xlsx", plot("seen from one side only, and more", 200 * "a"), {})
    for sheet in read_sheets(tmp_path / "trees.xlsx"):
        assert sheet.frozen_rows == 1
        assert sheet.bold == {place for place in sheet.values if place.lstrip("ABCDEFGHIJKLMNOPQRSTUVWXYZ") == "1"}
        header = sheet.rows()[0]
        assert len(sheet.widths) == len(header)
        assert all(width > len(str(name)) for width, name in zip(sheet.widths, header, strict=True))
        assert max(sheet.widths) < 62


@pytest.mark.parametrize("reason", DANGEROUS)
def test_no_text_becomes_a_formula_or_a_link(plot: Plot, tmp_path: Path, reason: str) -> None:
    write_tables(tmp_path / "trees.xlsx", plot(reason), {1: (point(1.0, None, reason),)})
    trees, _, curve = read_sheets(tmp_path / "trees.xlsx")
    assert trees.rows()[1][COLUMNS.index("reason")] == reason
    assert curve.rows()[1][-1] == reason
    assert "<f>" not in trees.xml + curve.xml
    assert "hyperlink" not in trees.xml + curve.xml
    with zipfile.ZipFile(tmp_path / "trees.xlsx") as archive:
        assert not any("worksheets/_rels" in name for name in archive.namelist())


def test_the_same_trees_give_the_same_bytes(plot: Plot, tmp_path: Path) -> None:
    for name in ("a.xlsx", "b.xlsx"):
        write_tables(tmp_path / name, plot("", ""), CURVES)
    assert (tmp_path / "a.xlsx").read_bytes() == (tmp_path / "b.xlsx").read_bytes()
    with zipfile.ZipFile(tmp_path / "a.xlsx") as archive:
        # Neither the parts nor the properties carry the time of writing.
        assert {entry.date_time[:3] for entry in archive.infolist()} == {(1980, 1, 1)}
        assert archive.read("docProps/core.xml").count(b"2000-01-01T00:00:00Z") == 2


def test_where_it_cannot_be_written_the_old_one_stays(
    plot: Plot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "trees.xlsx"
    write_tables(path, plot(""), {})
    before = path.read_bytes()

    def full(*_: object) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OutputError, match="the disk is full"):
        write_tables(path, plot("", ""), {})
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_a_full_folder_for_temporary_files_is_told(tmp_path: Path) -> None:
    """A summary of many plots goes through files there, and the disk of the output may have room enough."""
    resource = pytest.importorskip("resource")
    sheets = [Sheet(name="plots", columns=("plot",), rows=[(f"plot {number}",) for number in range(2000)])]
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, hard))
    try:
        with pytest.raises(OutputError, match=r"temporary files of summary\.xlsx.*TMPDIR"):
            write_workbook(tmp_path / "summary.xlsx", sheets, title="Plots")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert not list(tmp_path.iterdir())


def test_a_folder_for_temporary_files_that_is_gone_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "gone"))
    with pytest.raises(OutputError, match=r"temporary files of summary\.xlsx.*TMPDIR"):
        write_workbook(tmp_path / "summary.xlsx", [Sheet(name="plots", columns=("plot",), rows=[])], title="Plots")
