"""``fsinfer trees`` in the folder of a run: ``plot.json`` tells of the new measurement, and of the stages before it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fsinfer.conventions.breast_height import BhRule
from fsinfer.io.cloud import PointCloud, write_cloud
from fsinfer.notices.capture import CaptureCode
from fsinfer.notices.notice import notice
from fsinfer.notices.sentences import sentence
from fsinfer.notices.stems import StemCode
from fsinfer.output.plot_json import read_plot
from fsinfer.plot_border.request import BorderRequest
from fsinfer.report import make_report
from fsinfer.scale.request import ScaleRequest
from fsinfer.trees import TreeSettings
from fsinfer.trees.outputs.table import read_trees
from fsinfer.workflow.measure_cloud import MeasureSettings, measure_cloud_file
from fsinfer.workflow.summary import warning_values
from fsinfer.workflow.tree_stage import TreeStageSettings
from tests.support.command_line import Call
from tests.support.stem_clouds import stem_plot

OF_POSES = notice(CaptureCode.one_board, number=7, length_m=0.25, given=True)
OF_TREES = notice(StemCode.corrected_by_hand, changes=(notice(StemCode.tree_deleted, tree_id=2),))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A plot of four stems as a run left it: its poses and its trees had something to say."""
    monkeypatch.setattr("fsinfer.trees.outputs.figures.write_figures", lambda *_, **__: None)
    points = stem_plot(seed=4, trees=4, spacing_m=0.02).points
    write_cloud(tmp_path / "cloud.ply", PointCloud(xyz=points))
    plot: dict[str, Any] = {
        "source": "images", "units": "m", "scale_m_per_unit": 2.0, "scale_rel_std": 0.003, "cloud_from_scene": None,
        "points": len(points), "settings": {"poses": {"threads": 2}, "trees": {"bh_m": 1.3, "bh_rule": "midpoint"}},
        "versions": {"fsinfer": "0.1.0"}, **warning_values((OF_POSES, OF_TREES)),
    }  # fmt: skip
    (tmp_path / "plot.json").write_text(json.dumps(plot), encoding="utf-8")
    return tmp_path


def measured_again(folder: Path, **stage: Any) -> dict[str, Any]:
    settings = MeasureSettings(stage=TreeStageSettings(**stage))
    measure_cloud_file(folder / "cloud.ply", folder, request=ScaleRequest(), settings=settings)
    return read_plot(folder)


def test_its_warnings_take_the_place_of_those_of_the_trees_before(folder: Path) -> None:
    """A report said that stems are as they should be, of a plot of which 42 % were seen."""
    border = BorderRequest(radius_m=5.64, center=(3.0, 3.0))
    plot = measured_again(folder, border=border)
    codes = [entry["code"] for entry in plot["warning_codes"]]
    assert codes[0] == CaptureCode.one_board
    assert "plot_partly_seen" in codes
    assert StemCode.corrected_by_hand not in codes
    assert len(plot["warnings"]) == len(codes)
    # Once more, without the border: what was said of it is gone, and nothing is said twice.
    plot = measured_again(folder)
    assert [entry["code"] for entry in plot["warning_codes"]] == [CaptureCode.one_board]


def test_corrections_written_for_another_map_are_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file left in a folder had taken out whatever tree had the number in the next cloud, without a word."""
    monkeypatch.setattr("fsinfer.trees.outputs.figures.write_figures", lambda *_, **__: None)
    cloud, out = tmp_path / "scan.ply", tmp_path / "out"
    points = stem_plot(seed=4, trees=4, spacing_m=0.02).points + np.array([50.0, 0.0, 0.0])
    write_cloud(cloud, PointCloud(xyz=points))

    def measured(factor: float | None = None) -> tuple[set[int], list[str]]:
        trees = measure_cloud_file(cloud, out, request=ScaleRequest(factor=factor)).result.trees
        numbers = {row.tree_id for row in read_trees(out / "trees.csv")}
        return numbers, [sentence(told) for told in trees.warnings if told.code == StemCode.edits_left_out]

    assert measured() == ({1, 2, 3, 4}, [])
    rows = "action,tree_id,x_m,y_m\ndelete,2,,\n"
    (out / "edits.csv").write_text(rows, encoding="utf-8")
    assert measured() == ({1, 3, 4}, [])
    # The same trees, of which each stands ten metres farther from the origin.
    assert measured(1.2) == ({1, 3, 4}, [])
    write_cloud(cloud, PointCloud(xyz=points + np.array([3.0, 0.0, 0.0])))
    numbers, (told,) = measured()
    assert numbers == {1, 2, 3, 4}
    assert "(rows 2)" in told
    assert "trees of these numbers (2) stood elsewhere" in told
    # The way out: the row tells where its tree stands.
    tree = next(row for row in read_trees(out / "trees.csv") if row.tree_id == 2)
    (out / "edits.csv").write_text(f"{rows.splitlines()[0]}\ndelete,2,{tree.x_m},{tree.y_m}\n", encoding="utf-8")
    assert measured() == ({1, 3, 4}, [])
    write_cloud(cloud, PointCloud(xyz=points))
    assert measured()[0] == {1, 2, 3, 4}


@pytest.mark.parametrize(("factor", "moved_m", "left"), [(1.0, 3.0, {1, 2, 3, 4}), (1.2, 0.0, {1, 3, 4})])
def test_corrections_of_a_map_of_an_earlier_version_are_known_by_its_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, factor: float, moved_m: float, left: set[int]
) -> None:
    """It noted no places; the next one numbered the trees anew, and another than the tree that was meant was gone."""
    monkeypatch.setattr("fsinfer.trees.outputs.figures.write_figures", lambda *_, **__: None)
    cloud, out = tmp_path / "scan.ply", tmp_path / "out"
    points = stem_plot(seed=4, trees=4, spacing_m=0.02).points + np.array([50.0, 0.0, 0.0])
    write_cloud(cloud, PointCloud(xyz=points / 1.1))
    measure_cloud_file(cloud, out, request=ScaleRequest(factor=1.1))
    (out / ".fsinfer" / "edited_trees.json").unlink()
    (out / "edits.csv").write_text("action,tree_id\ndelete,2\n", encoding="utf-8")
    write_cloud(cloud, PointCloud(xyz=(points + np.array([moved_m, 0.0, 0.0])) / 1.1))
    trees = measure_cloud_file(cloud, out, request=ScaleRequest(factor=1.1 * factor)).result.trees
    assert {row.tree_id for row in read_trees(out / "trees.csv")} == left
    assert (StemCode.edits_left_out in [told.code for told in trees.warnings]) == (2 in left)


@pytest.mark.parametrize("name", ["trees.json", "trees.gpkg", "trees.laz", "trees.xlsx", "stem_curve.csv"])
def test_a_table_that_was_deleted_is_made_again(folder: Path, name: str) -> None:
    measured_again(folder)
    (folder / name).unlink()
    measured_again(folder)
    assert (folder / name).is_file()


def test_its_settings_stand_beside_those_of_the_stages_before(folder: Path) -> None:
    plot = measured_again(folder, trees=TreeSettings(bh_m=1.37, bh_rule=BhRule.uphill))
    assert plot["settings"]["trees"]["bh_m"] == 1.37
    assert plot["settings"]["trees"]["bh_rule"] == "uphill"
    assert plot["settings"]["poses"] == {"threads": 2}


def test_parts_of_the_walk_that_a_run_had_joined_stand_alone_again(folder: Path) -> None:
    """The report said that stems of a part had been put into a table that had none of them any more."""
    part = {"folder": "part-2", "photos": 20, "registered": 20, "trees": 7, "trees_with_dbh": 6, "error": ""}
    joined = {"name": "part-2", "common": 5, "new": 2}
    told = read_plot(folder) | {"photos": 60, "registered": 40, "parts": [part | {"joined": joined}]}
    (folder / "plot.json").write_text(json.dumps(told), encoding="utf-8")
    assert measured_again(folder)["parts"] == [part | {"joined": None}]
    page = make_report(folder).read_text(encoding="utf-8")
    assert "7 trees, 6 with a DBH, in a frame of their own" in page
    assert "put into this plot" not in page


def test_a_measurement_that_is_refused_leaves_the_one_before(folder: Path, call: Call) -> None:
    """The report said of whole tables that a measurement had been stopped while it wrote them."""
    first = measured_again(folder)
    table = (folder / "trees.csv").read_bytes()
    (folder / "edits.csv").write_text("action,tree_id\ndelete,99\n", encoding="utf-8")
    code, _, error = call("trees", folder / "cloud.ply", folder)
    assert (code, "which is not there" in error) == (2, True)
    assert (folder / "trees.csv").read_bytes() == table
    code, _, error = call("report", folder)
    assert (code, error) == (0, "")
    (folder / "edits.csv").unlink()
    settings = MeasureSettings(stage=TreeStageSettings())
    again = measure_cloud_file(folder / "cloud.ply", folder, request=ScaleRequest(), settings=settings)
    assert not again.ran
    assert read_plot(folder)["trees"] == first["trees"]
