"""Diameters up the trunk against the truth, refusals where little is seen, and the workbook that holds them."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fsinfer.io.cloud import PointCloud
from fsinfer.notices.notice import notice
from fsinfer.notices.stems import StemCode
from fsinfer.trees import PlotResult, analyse_plot
from fsinfer.trees.outputs.table import COLUMNS as TREE_COLUMNS
from fsinfer.trees.stem_curve import COLUMNS, CurveSettings, stem_curves, write_curves
from fsinfer.workflow.tree_stage import PlotCloudInput, measure_plot, no_trees
from tests.support.stem_clouds import StemPlot, stem_plot
from tests.support.workbook import read_sheets

TAPER = -0.005


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
        truth = plot.dbh_cm[plot.stem_at(tree.x_m, tree.y_m)]
        measured = [(p.height_m, p.diameter_cm) for p in curves[tree.tree_id] if p.diameter_cm is not None]
        assert [height_m for height_m, _ in measured] == pytest.approx([0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5], abs=0.01)
        for height_m, diameter_cm in measured[1:]:
            assert diameter_cm == pytest.approx(expected_cm(truth, height_m), abs=0.35)
        assert measured[-1][1] < measured[1][1]


def test_curves_tell_how_far_they_are(plot: StemPlot, result: PlotResult) -> None:
    """Those of a hectare take a minute and more."""
    told: list[tuple[int, int, str]] = []
    curves = stem_curves(plot.points, result, progress=lambda *said: told.append(said))
    assert told[-1] == (len(curves), len(curves), "measuring stem curves")


def test_the_curve_follows_what_the_photographs_say_at_breast_height(plot: StemPlot, result: PlotResult) -> None:
    def told(dbh_m: float, std_m: float) -> dict[float, float]:
        sections = tuple(
            replace(section, dbh_m=dbh_m, sd_m=std_m, dof=float("inf"), parts_m=section.parts_m | {"scale": 0.001})
            if number == 0
            else section
            for number, section in enumerate(result.sections)
        )
        curve = stem_curves(plot.points, replace(result, sections=sections))[result.trees[0].tree_id]
        assert all(point.std_cm is None or point.std_cm > 100.0 * 2.0 * 0.001 * 0.8 for point in curve)
        return {point.height_m: point.diameter_cm for point in curve if point.diameter_cm is not None}

    points_m = result.sections[0].dbh_m
    assert points_m is not None
    alone, surer, unsure = told(points_m, 0.002), told(points_m + 0.01, 0.0025), told(points_m + 0.01, 0.03)
    for height in (1.0, 1.5):
        assert 0.1 < surer[height] - alone[height] < 1.0
        assert abs(unsure[height] - alone[height]) < 0.15


def test_an_error_of_the_scale_makes_a_stem_unsure_and_moves_no_height_of_it(
    plot: StemPlot, result: PlotResult
) -> None:
    number, first = result.trees[0].tree_id, result.sections[0]
    assert first.dbh_m is not None
    # Photographs that say another diameter than the points: how far they move the curve is by how sure they are.
    sure = replace(first, dbh_m=first.dbh_m + 0.01, sd_m=0.003, dof=float("inf"), parts_m={"scale": 0.0})
    rel_std = 0.02
    part_m = rel_std * 0.5 * (first.dbh_m + 0.01)
    scaled = replace(sure, sd_m=float(np.hypot(0.003, 2 * part_m)), parts_m={"scale": part_m})
    exact, unsure = (
        stem_curves(plot.points, replace(result, sections=(section, *result.sections[1:])))[number]
        for section in (sure, scaled)
    )
    assert [p.diameter_cm for p in unsure] == pytest.approx([p.diameter_cm for p in exact])
    for one, other in zip(exact, unsure, strict=True):
        assert (one.std_cm is None) == (other.std_cm is None)
        if one.std_cm is not None and one.diameter_cm is not None:
            assert other.std_cm == pytest.approx(np.hypot(one.std_cm, rel_std * one.diameter_cm))


def test_a_diameter_that_was_measured_elsewhere_counts_there(plot: StemPlot, result: PlotResult) -> None:
    first = result.sections[0]
    lower = replace(first, by_taper_m=-0.01, sd_m=0.0025, dof=float("inf"))
    usual = stem_curves(plot.points, replace(result, sections=(replace(lower, by_taper_m=0.0), *result.sections[1:])))
    moved = stem_curves(plot.points, replace(result, sections=(lower, *result.sections[1:])))
    number = result.trees[0].tree_id
    at = {point.height_m: point.diameter_cm or 0.0 for point in usual[number]}
    assert all(0.1 < (p.diameter_cm or 0.0) - at[p.height_m] < 2.0 for p in moved[number] if p.height_m in (1.0, 1.5))


def test_diameters_that_are_not_sure_or_do_not_follow_the_stem_are_refused(plot: StemPlot, result: PlotResult) -> None:
    unsure = stem_curves(plot.points, result, settings=CurveSettings(max_std=1e-4))
    assert {p.why.code for curve in unsure.values() for p in curve if p.why is not None} == {
        StemCode.uncertain_at_height
    }
    assert not any(p.diameter_cm for curve in unsure.values() for p in curve)
    tree = result.trees[0]
    points = plot.points.copy()
    away = points[:, :2] - [tree.x_m, tree.y_m]
    height = points[:, 2] - tree.z_ground_m
    burl = (np.hypot(*away.T) < 0.8) & (np.abs(height - 3.0) < 0.25)
    middle = np.median(points[burl, :2], axis=0)
    points[burl, :2] = middle + 1.25 * (points[burl, :2] - middle)
    curve = {p.height_m: p for p in stem_curves(points, result)[tree.tree_id]}
    why = curve[3.0].why
    assert why is not None
    assert why.code == StemCode.curvature_differs


def test_where_too_little_is_seen_there_is_a_reason(plot: StemPlot, result: PlotResult) -> None:
    tree = result.trees[0]
    away = plot.points[:, :2] - [tree.x_m, tree.y_m]
    high = (plot.points[:, 2] - tree.z_ground_m > 2.2) & (np.hypot(*away.T) < 0.5)
    # Of the upper trunk a sliver is left.
    cut = plot.points[~high | (np.abs(np.arctan2(away[:, 1], away[:, 0])) < 0.4)]
    curve = stem_curves(cut, result)[tree.tree_id]
    assert [p.height_m for p in curve if p.diameter_cm is not None][-1] <= 2.5
    assert curve[-1].diameter_cm is None
    assert curve[-1].why is not None
    assert curve[-1].why.code in {StemCode.little_seen, StemCode.few_at_height, StemCode.few_on_bark_at_height}


def test_curves_far_from_the_origin_are_the_same(plot: StemPlot, result: PlotResult) -> None:
    shift = np.array([4.5e5, 5.2e6, 300.0])
    moved = stem_curves(plot.points + shift, analyse_plot(plot.points + shift))
    for number, curve in stem_curves(plot.points, result).items():
        assert [p.diameter_cm for p in moved[number]] == pytest.approx([p.diameter_cm for p in curve], abs=0.1)


@pytest.mark.parametrize("stray", [(0.0, 0.0, 0.0), (452_000.0, 5_352_000.0, 300.0), (452_150.0, 5_412_000.0, 300.0)])
def test_a_point_far_away_changes_no_curve(plot: StemPlot, stray: tuple[float, float, float]) -> None:
    points = plot.points + np.array([452_000.0, 5_412_000.0, 300.0])
    result = analyse_plot(points)
    expected = stem_curves(points, result)
    assert expected
    assert stem_curves(np.vstack([points[:100], [stray], points[100:]]), result) == expected


def test_csv_has_a_row_a_height(plot: StemPlot, result: PlotResult, tmp_path: Path) -> None:
    curves = stem_curves(plot.points, result)
    write_curves(tmp_path / "stem_curve.csv", curves.values())
    with (tmp_path / "stem_curve.csv").open(encoding="utf-8", newline="") as handle:
        rows = list(csv.DictReader(handle))
    assert tuple(rows[0]) == COLUMNS
    assert len(rows) == sum(map(len, curves.values()))
    first = curves[1][0]
    assert float(rows[0]["diameter_cm"]) == pytest.approx(first.diameter_cm, abs=0.006)


def test_the_tree_stage_writes_curve_workbook_and_figure(plot: StemPlot, tmp_path: Path) -> None:
    measure_plot(PlotCloudInput(cloud=PointCloud(xyz=plot.points)), tmp_path)
    trees, stand, _ = read_sheets(tmp_path / "trees.xlsx")
    assert trees.rows()[0] == list(TREE_COLUMNS)
    assert trees.values["A5"] == 4
    assert "quadratic_mean_dbh_cm" in stand.values.values()
    assert (tmp_path / "stem_curve.csv").stat().st_size > 300
    no_trees(tmp_path, reason=notice(StemCode.nothing_measured, error="for the test"))
    assert not (tmp_path / "trees.xlsx").exists()
    assert not (tmp_path / "stem_curve.csv").exists()
