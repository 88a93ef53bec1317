"""Trees measured at a scale that the cloud's file does not have: what plot.json and the report say of it."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fsinfer.errors import CloudError
from fsinfer.io.cloud import PointCloud, read_cloud, write_cloud
from fsinfer.notices.capture import CaptureCode
from fsinfer.notices.notice import notice
from fsinfer.output.plot_json import read_plot
from fsinfer.plot_border.request import BorderRequest
from fsinfer.report import make_report
from fsinfer.scale.find import FoundScale
from fsinfer.scale.request import ScaleRequest
from fsinfer.scene import read_scene
from fsinfer.trees import TreeSettings
from fsinfer.trees.sanity import SanitySettings
from fsinfer.workflow import cloud_origin
from fsinfer.workflow.measure_cloud import MeasureSettings, measure_cloud_file
from fsinfer.workflow.single_stages import fuse_scene
from fsinfer.workflow.summary import update_plot, warning_values
from fsinfer.workflow.tree_stage import TreeStageSettings
from tests.support.boards import board, scale_of_boards
from tests.support.synthetic_plot import M_PER_UNIT, STEMS, write_depth_folder, write_scene_folder

FACTOR = ScaleRequest(factor=M_PER_UNIT)


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """A cloud in model units, by single commands."""
    write_scene_folder(tmp_path / "scene")
    (tmp_path / "scene" / "poses.json").write_text("{}", encoding="utf-8")  # of fsinfer poses: its unit means nothing
    write_depth_folder(read_scene(tmp_path / "scene"), tmp_path / "out")
    fuse_scene(tmp_path / "scene", tmp_path / "out", level=True)
    return tmp_path / "out"


def scale_told(plot: dict[str, Any]) -> tuple[Any, ...]:
    return plot["units"], plot["scale_m_per_unit"], plot["scale_source"]


def codes(plot: dict[str, Any]) -> set[str]:
    return {str(told["code"]) for told in plot["warning_codes"]}


def test_plot_json_and_report_tell_the_scale_that_the_trees_have(out: Path) -> None:
    measure_cloud_file(out / "cloud.ply", out, request=FACTOR)
    plot = read_plot(out)
    assert scale_told(plot) == ("m", M_PER_UNIT, "factor")
    assert plot["trees_with_dbh"] == len(STEMS)
    assert plot["density_per_m2"] > 100
    assert "scale_error_unknown" in codes(plot)
    make_report(out)
    report = (out / "report.html").read_text(encoding="utf-8")
    assert "No scale is known" not in report
    assert "model units" not in report.replace("per model unit", "")


def test_the_unit_of_the_file_is_not_forgotten(out: Path) -> None:
    before = read_plot(out)
    measure_cloud_file(out / "cloud.ply", out, request=FACTOR)
    at_scale = (out / "trees.csv").read_bytes()
    # The same cloud once more, and at no scale: it is in model units as before.
    assert not fuse_scene(out.parent / "scene", out, level=True).ran
    assert scale_told(read_plot(out)) == ("m", M_PER_UNIT, "factor")
    measure_cloud_file(out / "cloud.ply", out, request=ScaleRequest())
    plot = read_plot(out)
    assert scale_told(plot) == scale_told(before) == ("model units", None, "none")
    assert (plot["trees_with_dbh"], plot["cloud"]) == (0, None)
    assert "no_scale_given" in codes(plot)
    assert "scale_error_unknown" not in codes(plot)
    # And back: the factor is of the file, not of what the trees had last.
    for _ in range(2):
        measure_cloud_file(out / "cloud.ply", out, request=FACTOR)
        plot = read_plot(out)
        assert scale_told(plot) == ("m", M_PER_UNIT, "factor")
        assert "no_scale_given" not in codes(plot)
    assert (out / "trees.csv").read_bytes() == at_scale


def test_a_cloud_of_other_origin_has_the_scale_that_was_given(out: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    measure_cloud_file(out / "cloud.ply", other, request=FACTOR)
    assert scale_told(read_plot(other)) == ("m", M_PER_UNIT, "factor")
    # Nothing was given: it is taken to be in metres, and the report does not call them model units.
    (tmp_path / "apart").mkdir()
    (out / "cloud.ply").rename(tmp_path / "apart" / "mine.ply")
    measure_cloud_file(tmp_path / "apart" / "mine.ply", other, request=ScaleRequest())
    assert scale_told(read_plot(other)) == ("m", None, "none")
    make_report(other)
    # In its own folder, twice.
    for settings in (MeasureSettings(), MeasureSettings(stage=TreeStageSettings(trees=TreeSettings(bh_m=1.37)))):
        measure_cloud_file(
            tmp_path / "apart" / "mine.ply", tmp_path / "apart", request=ScaleRequest(factor=2.0), settings=settings
        )
        assert scale_told(read_plot(tmp_path / "apart")) == ("m", 2.0, "factor")
    assert "model units" not in (other / "report.html").read_text(encoding="utf-8")


def test_what_was_said_of_a_scale_of_their_own_is_not_kept_of_the_cloud(out: Path, tmp_path: Path) -> None:
    """That a factor has no known error was told of trees without any scale, by way of another cloud."""
    measure_cloud_file(out / "cloud.ply", out, request=FACTOR)
    assert codes(read_plot(out)) == {"scale_error_unknown"}
    write_cloud(tmp_path / "scan.ply", PointCloud(xyz=M_PER_UNIT * read_cloud(out / "cloud.ply").xyz))
    measure_cloud_file(tmp_path / "scan.ply", out, request=ScaleRequest())
    measure_cloud_file(out / "cloud.ply", out, request=ScaleRequest())
    assert codes(read_plot(out)) == {"no_scale_given"}


@pytest.mark.parametrize("links", [1, 2])
def test_a_link_to_a_run_s_cloud_has_the_unit_of_that(out: Path, tmp_path: Path, links: int) -> None:
    """By absolute and relative links, under other names, into a folder that knows nothing of it."""
    link, other = tmp_path / "links" / "my.ply", tmp_path / "other"
    link.parent.mkdir()
    link.symlink_to(out / "cloud.ply")
    if links == 2:
        (tmp_path / "again.ply").symlink_to(Path("links") / "my.ply")
        link = tmp_path / "again.ply"
    measured = measure_cloud_file(link, other, request=ScaleRequest()).result
    assert not measured.metric
    assert read_plot(other)["units"] == "model units"
    direct = measure_cloud_file(out / "cloud.ply", tmp_path / "direct", request=ScaleRequest()).result
    assert measured.trees.warnings == direct.trees.warnings


def test_a_run_s_cloud_that_was_moved_and_linked_keeps_its_unit(out: Path, tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    # Stores name files by what is in them.
    (out / "cloud.ply").rename(tmp_path / "disk" / "3f29c1")
    (out / "cloud.ply").symlink_to(tmp_path / "disk" / "3f29c1")
    assert not measure_cloud_file(out / "cloud.ply", tmp_path / "other", request=ScaleRequest()).result.metric


def test_trees_of_another_cloud_are_not_looked_up_in_the_photographs_of_the_folder(out: Path, tmp_path: Path) -> None:
    """The report drew the walk on its map, and crops of photographs, for trees that stand elsewhere."""
    before = read_plot(out)
    assert before["cloud_from_scene"] is not None
    shutil.copytree(out.parent / "scene", out / "scene")
    measure_cloud_file(out / "cloud.ply", out, request=FACTOR)
    assert "photo taken here" in make_report(out).read_text(encoding="utf-8")
    (tmp_path / "scan").mkdir()
    # The same stems by a scanner, which has x and y of its own.
    xyz = M_PER_UNIT * read_cloud(out / "cloud.ply").xyz
    write_cloud(tmp_path / "scan" / "scan.ply", PointCloud(xyz=xyz + np.array([0.4, -0.3, 0.0])))
    measure_cloud_file(tmp_path / "scan" / "scan.ply", out, request=ScaleRequest())
    assert "photo taken here" not in make_report(out).read_text(encoding="utf-8")
    # The folder's own cloud is where it was.
    measure_cloud_file(out / "cloud.ply", out, request=FACTOR)
    after = read_plot(out)
    assert all(after[key] == before[key] for key in ("cloud_from_scene", "camera_height"))


def test_trees_of_another_cloud_are_not_told_to_be_of_the_folder_s_photographs(out: Path, tmp_path: Path) -> None:
    shutil.copytree(out.parent / "scene", out / "scene")
    of_run = {
        "source": "walk", "photos_given": 42, "rejected": [{"name": "a", "reason": "blur"}], "photos": 40,
        "registered": 20, "left_out": ["b"], "depth_vs_sfm_median_rel": 0.002, "model": "cascade",
        "parts": [{"folder": "part-1", "photos": 12, "trees": 3, "trees_with_dbh": 2, "joined": None}],
    }  # fmt: skip
    warned = warning_values([notice(CaptureCode.part_apart, names=("b",), photos=1)])
    update_plot(out, source="", stage="poses", seconds=1.0, values=of_run | warned)
    measure_cloud_file(out / "cloud.ply", out, request=FACTOR)
    before = read_plot(out)
    assert codes(before) >= {"part_apart", "scale_error_unknown"}
    xyz = M_PER_UNIT * read_cloud(out / "cloud.ply").xyz
    for name in ("scan.ply", "other scan.ply"):
        (tmp_path / name).unlink(missing_ok=True)
        write_cloud(tmp_path / name, PointCloud(xyz=xyz + np.array([0.4, -0.3, 0.0])))
        measure_cloud_file(tmp_path / name, out, request=ScaleRequest())
        plot = read_plot(out)
        assert plot["source"] == name
        assert [plot[key] for key in of_run if key != "source"] == [None] * (len(of_run) - 1)
        assert "part_apart" not in codes(plot)
        page = make_report(out).read_text(encoding="utf-8")
        assert "Trees measured in a point cloud" in page
        for words in ("photos used", "could be placed", "Photos from", "from photographs", "part-1"):
            assert words not in page
    # The folder's own cloud is of the photographs as before.
    measure_cloud_file(out / "cloud.ply", out, request=FACTOR)
    after = read_plot(out)
    assert {key: after[key] for key in of_run} == of_run
    assert codes(after) == codes(before)
    assert after["cloud"] == before["cloud"]
    page = make_report(out).read_text(encoding="utf-8")
    assert "Trees measured from photographs" in page
    assert "20 of 40" in page
    # And where the cloud is fused of the scene anew.
    measure_cloud_file(tmp_path / "scan.ply", out, request=ScaleRequest())
    (out / "cloud.ply").unlink()
    fuse_scene(out.parent / "scene", out, level=True)
    plot = read_plot(out)
    assert {key: plot[key] for key in of_run} == of_run


def test_a_cloud_that_a_link_in_the_folder_leads_to_is_the_folder_s_own(out: Path, tmp_path: Path) -> None:
    before = read_plot(out)
    (tmp_path / "disk").mkdir()
    (out / "cloud.ply").rename(tmp_path / "disk" / "cloud.ply")
    (out / "cloud.ply").symlink_to(tmp_path / "disk" / "cloud.ply")
    measure_cloud_file(out / "cloud.ply", out, request=ScaleRequest())
    plot = read_plot(out)
    told = ("units", "cloud_from_scene", "camera_height", "scale_source")
    assert [plot[key] for key in told] == [before[key] for key in told]


def test_a_link_to_what_was_fused_is_refused_as_that_is(out: Path, tmp_path: Path) -> None:
    (out / "fused").mkdir(exist_ok=True)
    (out / "cloud.ply").rename(out / "fused" / "cloud.ply")
    (tmp_path / "my.ply").symlink_to(out / "fused" / "cloud.ply")
    with pytest.raises(CloudError, match="before it knew what is up and how long a metre is"):
        measure_cloud_file(tmp_path / "my.ply", tmp_path / "other", request=ScaleRequest())


def test_links_that_lead_round_are_told(tmp_path: Path) -> None:
    (tmp_path / "a.ply").symlink_to(tmp_path / "b.ply")
    (tmp_path / "b.ply").symlink_to(tmp_path / "a.ply")
    with pytest.raises(CloudError, match=r"a\.ply"):
        measure_cloud_file(tmp_path / "a.ply", tmp_path / "other", request=ScaleRequest())


def test_boards_that_give_the_scale_now_are_those_of_the_plot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A run, or a scene of another program, that had no scale; then ``trees`` is told the length of its boards."""
    write_scene_folder(tmp_path / "scene")
    scene = read_scene(tmp_path / "scene")
    write_depth_folder(scene, tmp_path)
    fuse_scene(tmp_path / "scene", tmp_path, level=True)
    cloud_from_scene = np.array(read_plot(tmp_path)["cloud_from_scene"])
    centers = [tuple(view.camera.center.tolist()) for view in scene.views[:3]]
    found = scale_of_boards([board(n, place, ["a"]) for n, place in enumerate(centers)], m_per_unit=M_PER_UNIT)
    monkeypatch.setattr(cloud_origin, "find_scale", lambda *_, **__: FoundScale(scale=found))
    border = MeasureSettings(stage=TreeStageSettings(border=BorderRequest(radius_m=1.0, marker=2)))
    measure_cloud_file(tmp_path / "cloud.ply", tmp_path, request=ScaleRequest(aruco_length_m=0.25), settings=border)
    plot = read_plot(tmp_path)
    assert scale_told(plot) == ("m", pytest.approx(M_PER_UNIT), "aruco")
    place = M_PER_UNIT * (cloud_from_scene @ [*centers[2], 1.0])[:2]
    assert plot["plot_border"]["center"] == pytest.approx(place.tolist(), abs=1e-6)


@pytest.mark.parametrize(("times", "told"), [(1.0, False), (1 / 0.3048, True)])
def test_the_height_of_the_cameras_is_at_the_scale_of_the_trees(out: Path, times: float, told: bool) -> None:
    """It is noted in units of the file, and vouches for the metre by which the trees are measured."""
    request = ScaleRequest(factor=times * M_PER_UNIT)
    thick = SanitySettings(thick_trees=len(STEMS), thick_cm=10.0)
    settings = MeasureSettings(stage=TreeStageSettings(trees=TreeSettings(sanity=thick)))
    measure_cloud_file(out / "cloud.ply", out, request=request, settings=settings)
    assert ("all_thick" in codes(read_plot(out))) == told
