"""Diameters up the trunk against the truth, refusals where little is seen, and the workbook that holds them."""

from __future__ import annotations

import csv
import xml.etree.ElementTree as ElementTree
import zipfile
from pathlib import Path

import numpy as np
import pytest

from fsinfer.io.cloud import PointCloud
from fsinfer.io.workbook import write_workbook
from fsinfer.trees import PlotResult, TreeSettings, analyse_plot
from fsinfer.trees.outputs.table import COLUMNS as TREE_COLUMNS
from fsinfer.trees.stem_curve import COLUMNS, stem_curves, write_curves
from fsinfer.workflow.tree_stage import write_no_trees, write_tree_outputs
from tests.support.stem_clouds import StemPlot, stem_plot

TAPER = -0.005
SPACE = {"m": "http://schemas.openxmlformats.org/spreadsheetml/2006/main"}


@pytest.fixture(scope="module")
def plot() -> StemPlot:
    return stem_plot(trees=4, seed=8, slope=0.1, lean_deg=4.0)


@pytest.fixture(scope="module")
def result(plot: StemPlot) -> PlotResult:
    return analyse_plot(plot.points)


def expected_cm(dbh_cm: float, height_m: float) -> float:
    return dbh_cm + 200.0 * (TAPER * (height_m - 1.3) + 0.03 * float(np.exp(-height_m / 0.25)))


def test_the_curve_follows_taper_and_swell(plot: StemPlot, result: PlotResult) -> None:
    curves = stem_curves(plot.points + 0.0, result)
    assert list(curves) == [1, 2, 3, 4]
    for tree in result.trees:
        truth = plot.dbh_cm[np.argmin(np.hypot(*(plot.xy - [tree.x_m, tree.y_m]).T))]
        measured = [point for point in curves[tree.tree_id] if point.diameter_cm is not None]
        assert [p.height_m for p in measured] == pytest.approx([0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5], abs=0.01)
        for point in measured[1:]:
            assert point.diameter_cm == pytest.approx(expected_cm(truth, point.height_m), abs=0.35)
        assert measured[-1].diameter_cm < measured[1].diameter_cm


def test_where_too_little_is_seen_there_is_a_reason(plot: StemPlot, result: PlotResult) -> None:
    tree = result.trees[0]
    away = plot.points[:, :2] - [tree.x_m, tree.y_m]
    high = (plot.points[:, 2] - tree.z_ground_m > 2.2) & (np.hypot(*away.T) < 0.5)
    # Of the upper trunk a sliver is left.
    cut = plot.points[~high | (np.abs(np.arctan2(away[:, 1], away[:, 0])) < 0.4)]
    curve = stem_curves(cut, result)[tree.tree_id]
    assert [p.height_m for p in curve if p.diameter_cm is not None][-1] <= 2.5
    assert curve[-1].diameter_cm is None
    assert "degrees" in curve[-1].reason or "too few" in curve[-1].reason


def test_curves_far_from_the_origin_are_the_same(plot: StemPlot, result: PlotResult) -> None:
    shift = np.array([4.5e5, 5.2e6, 300.0])
    moved = stem_curves(plot.points + shift, analyse_plot(plot.points + shift))
    for number, curve in stem_curves(plot.points, result).items():
        assert [p.diameter_cm for p in moved[number]] == pytest.approx([p.diameter_cm for p in curve], abs=0.1)


def test_csv_has_a_row_a_height(plot: StemPlot, result: PlotResult, tmp_path: Path) -> None:
    curves = stem_curves(plot.points, result)
    write_curves(tmp_path / "stem_curve.csv", curves.values())
    with (tmp_path / "stem_curve.csv").open(encoding="utf-8", newline="") as handle:
        rows = list(csv.DictReader(handle))
    assert tuple(rows[0]) == COLUMNS
    assert len(rows) == sum(map(len, curves.values()))
    first = curves[1][0]
    assert float(rows[0]["diameter_cm"]) == pytest.approx(first.diameter_cm, abs=0.006)


def cells(path: Path, sheet: int) -> dict[str, str]:
    with zipfile.ZipFile(path) as archive:
        root = ElementTree.fromstring(archive.read(f"xl/worksheets/sheet{sheet}.xml"))
    return {c.attrib["r"]: "".join(c.itertext()) for c in root.iterfind(".//m:c", SPACE)}


def test_workbook_keeps_numbers_text_and_gaps(tmp_path: Path) -> None:
    row = [1, 2.5, 'a < b & "c" \x07ä', None, float("nan"), True]
    write_workbook(tmp_path / "a.xlsx", {"one & two": [["h"] * 30, row], "empty": []})
    with zipfile.ZipFile(tmp_path / "a.xlsx") as archive:
        assert archive.testzip() is None
        for name in archive.namelist():
            ElementTree.fromstring(archive.read(name))
        workbook = ElementTree.fromstring(archive.read("xl/workbook.xml"))
    assert [s.attrib["name"] for s in workbook.iterfind(".//m:sheet", SPACE)] == ["one & two", "empty"]
    found = cells(tmp_path / "a.xlsx", 1)
    assert (found["A2"], found["B2"], found["C2"], found["F2"]) == ("1", "2.5", 'a < b & "c" ä', "1")
    assert "D2" not in found
    assert "E2" not in found
    assert found["AD1"] == "h"


def test_the_tree_stage_writes_curve_workbook_and_figure(plot: StemPlot, tmp_path: Path) -> None:
    write_tree_outputs(PointCloud(xyz=plot.points), tmp_path, settings=TreeSettings())
    trees = cells(tmp_path / "trees.xlsx", 1)
    assert [trees[f"{letter}1"] for letter in "ABCDE"] == list(TREE_COLUMNS[:5])
    assert trees["A5"] == "4"
    assert "quadratic_mean_dbh_cm" in cells(tmp_path / "trees.xlsx", 2).values()
    assert (tmp_path / "stem_curve.csv").stat().st_size > 300
    write_no_trees(tmp_path, reason="for the test")
    assert not (tmp_path / "trees.xlsx").exists()
    assert not (tmp_path / "stem_curve.csv").exists()
