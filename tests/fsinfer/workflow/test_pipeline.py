"""The run as a whole: what it leaves, what it does not repeat, and that it goes on after a kill.

Frames, poses and depth are replaced by exact ones (they have their own tests, and ``test_demo`` runs the real ones);
everything from fusion on is real.
"""

from __future__ import annotations

import csv
import json
import shutil
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from urllib.request import Request, urlopen

import numpy as np
import pytest

import fsinfer
import fsinfer.silhouettes.looks as silhouettes
import fsinfer.workflow.cloud_stages as cloud_stages
import fsinfer.workflow.measure_cloud as measure_cloud
import fsinfer.workflow.photo_stages as photo_stages
import fsinfer.workflow.pipeline as pipeline
import fsinfer.workflow.tree_stage as tree_stage
from fsinfer.cli.remaining import STEPS, step_of
from fsinfer.depth.settings import DepthSettings
from fsinfer.depth.sfm_check import DepthCheck
from fsinfer.depth.stage import DepthResult
from fsinfer.errors import CloudError, InputError
from fsinfer.frames.select import FramesResult
from fsinfer.frames.table import FrameRow
from fsinfer.fusion.fuse import FusionSettings
from fsinfer.fusion.fuse import fuse as real_fuse
from fsinfer.io.cloud import PointCloud, read_cloud, write_cloud
from fsinfer.io.files import make_folder, write_text
from fsinfer.io.images import write_image
from fsinfer.io.photo_folders import list_images
from fsinfer.notices.capture import CaptureCode
from fsinfer.notices.notice import notice
from fsinfer.output.plot_json import read_plot, write_plot
from fsinfer.plot_border.request import BorderRequest
from fsinfer.poses.estimate import PosesResult
from fsinfer.scale.doubts import boards_at_two_places
from fsinfer.scale.find import FoundScale
from fsinfer.scale.find import find_scale as real_find_scale
from fsinfer.scale.request import ScaleRequest
from fsinfer.scale.scale import scale_from_factor
from fsinfer.scene import project, read_camera, read_scene, write_camera
from fsinfer.silhouettes.edges import find_edges
from fsinfer.silhouettes.join import measure_silhouettes
from fsinfer.trees import TreeSettings
from fsinfer.trees.outputs.figures import write_figures as real_figures
from fsinfer.trees.outputs.table import read_trees
from fsinfer.trees.pattern.match import PatternSettings
from fsinfer.workflow.clicked_scale import click_scale
from fsinfer.workflow.measure_cloud import MeasureSettings, measure_cloud_file
from fsinfer.workflow.parts import PartResult
from fsinfer.workflow.pipeline import run
from fsinfer.workflow.settings import RunSettings
from fsinfer.workflow.single_stages import depth_of
from fsinfer.workflow.summary import PLOT_KEYS
from fsinfer.workflow.tree_stage import PlotCloudInput, TreeStageSettings
from fsinfer.workflow.tree_stage import measure_plot as real_trees
from tests.support.boards import board, scale_of_boards
from tests.support.report_plot import plot_cloud
from tests.support.synthetic_plot import _TURN, M_PER_UNIT, STEMS, VIEWS, write_depth_folder, write_scene_folder

METRIC = RunSettings(scale=ScaleRequest(factor=M_PER_UNIT))
ALL = ["frames", "poses", "depth", "check", "fuse", "scale", "cloud", "trees", "report"]


class FakeManifest:
    """Of a model in float32 alone; with an int8 regularizer, its graphs have another hash."""

    int8_regularizer: str | None = None

    def sha256_of(self, *, int8: bool) -> str:
        return ("1" if int8 else "0") * 64


@dataclass
class Fakes:
    """Counts the calls of the replaced stages; ``fail_in`` makes one of them raise."""

    calls: Counter[str]
    fail_in: str = ""

    def enter(self, stage: str) -> None:
        self.calls[stage] += 1
        if self.fail_in == stage:
            raise KeyboardInterrupt


def frame_row(name: str, *, reason: str = "") -> FrameRow:
    return FrameRow(
        name=name, source=f"{name}.jpg", time_s=None, sharpness=1.0, mean_luminance=100.0, dark_share=0.0,
        bright_share=0.0, kept=not reason, reason=reason,
    )  # fmt: skip


def _report(out: Path) -> Path:
    write_text(out / "report.html", "<html>")
    return out / "report.html"


@pytest.fixture
def fakes(monkeypatch: pytest.MonkeyPatch) -> Fakes:
    fakes = Fakes(calls=Counter())

    def select_frames(source: Path, out: Path, **_: Any) -> FramesResult:
        fakes.enter("frames")
        (out / "images").mkdir(parents=True)
        copied = [Path(shutil.copy(path, out / "images" / path.name)) for path in list_images(source)]
        rows = [frame_row(path.stem) for path in copied]
        rows.append(frame_row("dark", reason="too dark"))
        warning = notice(CaptureCode.frames_not_used, frames=len(rows), rejected=("dark: too dark",))
        return FramesResult(folder=out, rows=tuple(rows), warnings=(warning,))

    def estimate_poses(images: Path, out: Path, **_: Any) -> PosesResult:
        fakes.enter("poses")
        write_scene_folder(out)
        names = [path.stem for path in list_images(images)]
        # Other photographs make another scene.
        path = next((out / "cams").glob("*"))
        camera = read_camera(path)
        write_camera(path, replace(camera, depth_max=camera.depth_max + 0.01 * len(names)))
        return PosesResult(
            scene=out,
            photos=len(names),
            registered=VIEWS,
            left_out=tuple(names[VIEWS:]),
            warnings=(notice(CaptureCode.photos_loose, photos=len(names), names=tuple(names[VIEWS:])),),
        )

    def estimate_depth(scene: Any, out: Path, *, settings: DepthSettings, **_: Any) -> DepthResult:
        fakes.enter("depth")
        write_depth_folder(scene, out)
        return DepthResult(
            depth_folder=out, views=VIEWS, model=settings.model, model_sha256="0" * 64, precision="float32"
        )

    def fuse(*args: Any, **kwargs: Any) -> Any:
        fakes.enter("fuse")
        return real_fuse(*args, **kwargs)

    def measure_plot(*args: Any, **kwargs: Any) -> Any:
        fakes.enter("trees")
        return real_trees(*args, **kwargs)

    monkeypatch.setattr(photo_stages, "select_frames", select_frames)
    monkeypatch.setattr(photo_stages, "estimate_poses_apart", estimate_poses)
    monkeypatch.setattr(cloud_stages, "estimate_depth", estimate_depth)
    monkeypatch.setattr(cloud_stages, "fuse", fuse)
    monkeypatch.setattr(pipeline, "measure_plot", measure_plot)
    monkeypatch.setattr(cloud_stages, "read_manifest", lambda _, **__: FakeManifest())
    # The fake scene has no COLMAP model to compare with.
    monkeypatch.setattr(cloud_stages, "read_sparse", lambda _: None)
    checked = DepthCheck(median_rel=0.0025, per_view_rel={}, compared=1, asked=1, relaxed=False)
    monkeypatch.setattr(cloud_stages, "check_depth", lambda *_, **__: checked)
    # Drawing takes most of the time; test_cli and the tests of the report draw.
    monkeypatch.setattr("fsinfer.report.make_report", lambda out: _report(out))
    monkeypatch.setattr("fsinfer.trees.outputs.figures.write_figures", lambda folder, *_, **__: make_folder(folder))
    return fakes


@pytest.fixture
def photos(tmp_path: Path) -> Path:
    folder = tmp_path / "photos"
    for index in range(VIEWS):
        write_image(folder / f"view_{index:02d}.jpg", np.full((8, 8, 3), index, np.uint8))
    write_image(folder / "view_99.jpg", np.full((8, 8, 3), 255, np.uint8))
    return folder


def dbh_cm(out: Path) -> list[str]:
    with (out / "trees.csv").open(encoding="utf-8", newline="") as stream:
        return [row["dbh_cm"] for row in csv.DictReader(stream)]


def ran(result: pipeline.RunResult) -> list[str]:
    return [record.name for record in result.stages if record.ran]


def test_everything_then_nothing(fakes: Fakes, photos: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    first = run(photos, out, settings=METRIC)
    assert ran(first) == ALL
    np.testing.assert_allclose(sorted(float(d) for d in dbh_cm(out)), sorted(200 * STEMS[:, 2]), atol=1.0)
    for name in ("cloud.ply", "cloud.laz", "trees.csv", "plot.json", "report.html"):
        assert (out / name).stat().st_size > 0
    written = {path: path.stat().st_mtime_ns for path in out.rglob("*") if path.is_file()}
    second = run(photos, out, settings=METRIC)
    assert ran(second) == []
    assert {path: path.stat().st_mtime_ns for path in out.rglob("*") if path.is_file()} == written
    assert second.plot == first.plot


def test_plot_json(fakes: Fakes, photos: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = run(photos, out, settings=METRIC)
    plot = json.loads((out / "plot.json").read_text(encoding="utf-8"))
    assert plot == result.plot
    assert (plot["photos"], plot["registered"], plot["left_out"]) == (VIEWS + 1, VIEWS, ["view_99"])
    assert (plot["photos_given"], plot["rejected"]) == (VIEWS + 2, [{"name": "dark", "reason": "too dark"}])
    assert [entry["code"] for entry in plot["warning_codes"]][:2] == ["frames_not_used", "photos_loose"]
    assert [entry["text"] for entry in plot["warning_codes"]] == plot["warnings"]
    assert plot["warnings"][0] == f"1 of {VIEWS + 2} frames was not used (dark: too dark)"
    assert {name: made for name, made in plot["made_by"].items() if made != fsinfer.__version__} == {}
    assert (plot["units"], plot["scale_m_per_unit"], plot["scale_source"]) == ("m", M_PER_UNIT, "factor")
    assert plot["depth_vs_sfm_median_rel"] == 0.0025
    assert plot["points"] == len(read_cloud(out / "cloud.ply"))
    assert plot["density_per_m2"] > 100
    assert plot["trees"] == plot["trees_with_dbh"] == len(STEMS)
    assert set(ALL) | {"total"} == set(plot["seconds"])
    assert tuple(plot) == PLOT_KEYS
    assert plot["peak_rss_mb"] is None or plot["peak_rss_mb"] > 10
    assert plot["model_sha256"] == "0" * 64
    assert plot["model_precision"] == "float32"
    assert plot["settings"]["trees"]["bh_m"] == 1.3
    assert plot["versions"]["numpy"] == np.__version__
    similarity = np.array(plot["cloud_from_scene"])
    assert np.cbrt(np.linalg.det(similarity[:3, :3])) == pytest.approx(M_PER_UNIT)
    assert plot["camera_height"] == pytest.approx(1.5, abs=0.02)
    # The scene's own origin lies on the ground.
    assert similarity[2, 3] == pytest.approx(0, abs=0.02)


def test_parts_that_were_measured_apart_come_into_the_plot(
    fakes: Fakes, photos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two parts: the first holds the same stems in the same frame, the second could not be measured."""
    out = tmp_path / "out"
    apart = [notice(CaptureCode.part_apart, photos=40, names=(f"part{number}",)) for number in (2, 3)]
    told = PosesResult(scene=out / "scene", photos=VIEWS, registered=VIEWS, left_out=(), warnings=tuple(apart))

    def estimate_poses(_: Path, scene: Path, **__: Any) -> PosesResult:
        write_scene_folder(scene)
        return told

    monkeypatch.setattr(photo_stages, "estimate_poses_apart", estimate_poses)

    def measure_parts(*_: Any) -> tuple[PartResult, ...]:
        folder = out / "part-2"
        if not folder.is_dir():
            cloud = plot_cloud(points_per_stem=12_000, ground=30_000)
            write_cloud(make_folder(folder) / "cloud.ply", cloud)
            write_plot(folder, {"units": "m"})
            real_trees(PlotCloudInput(cloud=cloud), folder)
        return (
            PartResult(folder="part-2", photos=12, registered=11, trees=3, trees_with_dbh=3),
            PartResult(folder="part-3", photos=12, error="too dark"),
        )

    monkeypatch.setattr(pipeline, "measure_parts", measure_parts)
    # Three stems are no evidence by themselves.
    settings = replace(METRIC, pattern=PatternSettings(by_chance=1e3, rival_share=0.9))
    plot = run(photos, out, settings=settings).plot
    first, second = plot["parts"]
    assert (first["joined"]["common"], first["joined"]["new"], second["joined"]) == (3, 0, None)
    assert plot["trees"] == len(STEMS)
    # Of the parts that nothing tied the joined one is no warning any more.
    said = [entry for entry in plot["warning_codes"] if entry["code"] == "part_apart"]
    assert [entry["values"]["names"] for entry in said] == [["part3"]]
    assert ran(run(photos, out, settings=settings)) == []
    table = (out / "part-2" / "trees.csv").read_text(encoding="utf-8")
    write_text(out / "part-2" / "trees.csv", table.replace(",ok,", ",doubtful,", 1))
    assert ran(run(photos, out, settings=settings)) == ["trees", "report"]


def test_scale_and_tree_options_repeat_nothing_dear(fakes: Fakes, photos: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    unscaled = run(photos, out)
    assert dbh_cm(out) == ["", "", ""]
    assert unscaled.plot["units"] == "model units"
    assert unscaled.plot["density_per_m2"] is None
    # Said once, though the trees stage would say it as well.
    assert [text.split(":")[0] for text in unscaled.plot["warnings"] if "no scale" in text] == ["no scale was given"]
    ends = ((-1.0, 0.0, 0.0), (1.0, 0.0, 0.0))
    scaled = run(photos, out, settings=RunSettings(scale=ScaleRequest(endpoints=ends, length_m=2 * M_PER_UNIT)))
    assert ran(scaled) == ["scale", "cloud", "trees", "report"]
    assert all(float(value) > 0 for value in dbh_cm(out))
    higher = run(photos, out, settings=replace(METRIC, trees=TreeSettings(bh_m=1.37)))
    assert ran(higher)[-2:] == ["trees", "report"]
    assert not {"frames", "poses", "depth", "fuse"} & {*ran(higher)}
    assert fakes.calls == {"frames": 1, "poses": 1, "depth": 1, "fuse": 1, "trees": 3}


def test_end_points_read_off_a_metric_cloud_are_doubted(fakes: Fakes, photos: Path, tmp_path: Path) -> None:
    def endpoints(length_units: float, length_m: float) -> RunSettings:
        ends = ((0.0, 0.0, 0.0), (length_units, 0.0, 0.0))
        return RunSettings(scale=ScaleRequest(endpoints=ends, length_m=length_m))

    out = tmp_path / "out"
    run(photos, out)
    # Off the cloud in model units, then the length corrected: nothing to doubt.
    for length_m in (1.05, 1.0):
        plot = run(photos, out, settings=endpoints(1.0 / M_PER_UNIT, length_m)).plot
        assert not [text for text in plot["warnings"] if "end points" in text or "above the ground" in text]
    # Another length, read off a copy of the cloud in model units: the phone's height tells that it is right.
    plot = run(photos, out, settings=endpoints(2.0 / M_PER_UNIT, 2.0)).plot
    assert not [text for text in plot["warnings"] if "end points" in text or "above the ground" in text]
    # In centimetres.
    plot = run(photos, out, settings=endpoints(2.0 / M_PER_UNIT, 200.0)).plot
    (height,) = [text for text in plot["warnings"] if "end points" in text or "above the ground" in text]
    assert "150 m above the ground" in height
    assert "in centimetres?" in height
    run(photos, out, settings=endpoints(1.0 / M_PER_UNIT, 1.0))
    # The same metre off the cloud that is in metres now.
    doubted = run(photos, out, settings=endpoints(1.0, 1.0)).plot
    (way_out,) = [text for text in doubted["warnings"] if "end points" in text]
    factor = float(way_out.split("--scale ")[1].split()[0])
    assert factor == pytest.approx(M_PER_UNIT, rel=1e-4)
    mended = run(photos, out, settings=RunSettings(scale=ScaleRequest(factor=factor))).plot
    assert not [text for text in mended["warnings"] if "end points" in text or "above the ground" in text]
    assert any("not in the intervals" in text for text in mended["warnings"])


def test_a_scale_that_has_the_phone_in_the_tree_tops_is_doubted(fakes: Fakes, photos: Path, tmp_path: Path) -> None:
    for factor, doubted in ((1.0, False), (6.0, True), (0.1, True)):
        settings = RunSettings(scale=ScaleRequest(factor=factor * M_PER_UNIT))
        warnings = run(photos, tmp_path / "out", settings=settings).plot["warnings"]
        assert any("above the ground (a phone" in text for text in warnings) is doubted


def test_threads_change_nothing(fakes: Fakes, photos: Path, tmp_path: Path) -> None:
    run(photos, tmp_path / "out", settings=METRIC)
    again = run(photos, tmp_path / "out", settings=replace(METRIC, depth=DepthSettings(threads=7)))
    assert not {"frames", "poses", "depth", "fuse", "cloud", "trees"} & {*ran(again)}


def test_memory_repeats_the_fusion_only_where_it_makes_the_cloud_coarser(
    fakes: Fakes, photos: Path, tmp_path: Path
) -> None:
    def fused(memory_gb: float) -> int:
        settings = replace(METRIC, fusion=FusionSettings(memory_gb=memory_gb), depth=DepthSettings(memory_gb=memory_gb))
        run(photos, tmp_path / "out", settings=settings)
        return fakes.calls["fuse"]

    assert [fused(3.0), fused(8.0), fused(0.5), fused(3.0)] == [1, 1, 2, 3]
    assert fakes.calls["depth"] == 1


def test_other_depth_settings_repeat_depth_and_what_follows(fakes: Fakes, photos: Path, tmp_path: Path) -> None:
    run(photos, tmp_path / "out", settings=METRIC)
    again = run(photos, tmp_path / "out", settings=replace(METRIC, depth=DepthSettings(source_views=2)))
    assert {"depth", "fuse", "cloud", "trees", "report"} <= {*ran(again)}
    assert not {"frames", "poses"} & {*ran(again)}


def test_depth_is_repeated_where_the_precision_in_use_changes_and_not_the_wish(
    fakes: Fakes, photos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def settings(precision: str) -> RunSettings:
        return replace(METRIC, depth=DepthSettings(precision=precision))

    monkeypatch.setattr(FakeManifest, "int8_regularizer", "int8.onnx")
    run(photos, tmp_path / "out", settings=settings("float32"))
    monkeypatch.setattr("fsinfer.depth.precision._this_machine_is_fast", lambda: False)
    assert not {"depth", "fuse"} & {*ran(run(photos, tmp_path / "out", settings=settings("auto")))}
    monkeypatch.setattr("fsinfer.depth.precision._this_machine_is_fast", lambda: True)
    assert {"depth", "fuse"} <= {*ran(run(photos, tmp_path / "out", settings=settings("auto")))}
    assert not {"depth", "fuse"} & {*ran(run(photos, tmp_path / "out", settings=settings("int8")))}
    assert {"depth", "fuse"} <= {*ran(run(photos, tmp_path / "out", settings=settings("float32")))}


def test_killed_run_goes_on(fakes: Fakes, photos: Path, tmp_path: Path) -> None:
    whole, out = tmp_path / "whole", tmp_path / "out"
    run(photos, whole, settings=METRIC)
    fakes.calls.clear()
    for stage in ("poses", "depth", "fuse", "trees"):
        fakes.fail_in = stage
        with pytest.raises(KeyboardInterrupt):
            run(photos, out, settings=METRIC)
        assert not (out / "plot.json").exists()
    fakes.fail_in = ""
    run(photos, out, settings=METRIC)
    # Each was called once in vain and once for good; none that was finished was called again.
    assert fakes.calls == {"frames": 1, "poses": 2, "depth": 2, "fuse": 2, "trees": 2}
    assert (out / "trees.csv").read_bytes() == (whole / "trees.csv").read_bytes()


def test_corrections_by_hand_repeat_only_the_trees(fakes: Fakes, photos: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    first = run(photos, out, settings=METRIC)
    trees = read_trees(out / "trees.csv")
    (out / "edits.csv").write_text("action,tree_id\ndelete,2\n", encoding="utf-8")
    edited = run(photos, out, settings=METRIC)
    assert ran(edited) == ["trees", "report"]
    assert read_trees(out / "trees.csv") == [tree for tree in trees if tree.tree_id != 2]
    assert edited.plot["trees"] == first.plot["trees"] - 1
    assert ran(run(photos, out, settings=METRIC)) == []
    # A file that is given counts instead of the one in the folder.
    (tmp_path / "mine.csv").write_text("action,tree_id\ndelete,1\ndelete,9\n", encoding="utf-8")
    with pytest.raises(InputError, match="row 3 of the edits names tree 9"):
        run(photos, out, settings=METRIC, edits=tmp_path / "mine.csv")
    (out / "edits.csv").unlink()
    run(photos, out, settings=METRIC)
    assert read_trees(out / "trees.csv") == trees


def test_new_photo_repeats_everything(fakes: Fakes, photos: Path, tmp_path: Path) -> None:
    run(photos, tmp_path / "out", settings=METRIC)
    write_image(photos / "view_98.jpg", np.zeros((8, 8, 3), np.uint8))
    assert ran(run(photos, tmp_path / "out", settings=METRIC)) == ALL


def test_deleted_result_is_made_again(fakes: Fakes, photos: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    run(photos, out, settings=METRIC)
    before = (out / "trees.csv").read_bytes()
    (out / "trees.csv").unlink()
    (out / "plot.json").unlink()
    again = run(photos, out, settings=METRIC)
    assert ran(again) == ["trees", "report"]
    assert (out / "trees.csv").read_bytes() == before
    assert (out / "plot.json").is_file()


def test_markers_not_found_keeps_everything_else(fakes: Fakes, photos: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = run(photos, out, settings=RunSettings(scale=ScaleRequest(aruco_length_m=0.25)))
    assert result.plot["scale_source"] == "none"
    assert any("ArUco" in text for text in result.plot["warnings"])
    assert (out / "report.html").is_file()
    assert dbh_cm(out) == ["", "", ""]


def test_cloud_without_a_plot_is_reported_not_lost(
    fakes: Fakes, photos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_ground(*_: Any, **__: Any) -> Any:
        raise CloudError("no ground was seen")

    monkeypatch.setattr(pipeline, "measure_plot", no_ground)
    result = run(photos, tmp_path / "out", settings=METRIC)
    assert result.plot["trees"] == 0
    assert "no trees measured: no ground was seen" in result.plot["warnings"]
    assert dbh_cm(tmp_path / "out") == []
    assert (tmp_path / "out" / "report.html").is_file()


def test_the_trees_tell_their_steps_as_they_come(
    fakes: Fakes, photos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fsinfer.trees.outputs.figures.write_figures", real_figures)
    told: list[tuple[str, float]] = []

    def progress(stage: str) -> Any:
        return lambda done, total, what: told.append((what, done / total)) if stage == "trees" else None

    run(photos, tmp_path / "out", settings=METRIC, progress=progress)
    steps = [step_of("trees", what) for what, _ in told]
    of_trees = [number for number, step in enumerate(STEPS) if step.stage == "trees"]
    # One after the other, all of them: what is left of a run is told by them.
    assert list(dict.fromkeys(steps)) == of_trees
    assert steps == sorted(steps, key=lambda step: -1 if step is None else step)
    begun = dict(reversed(told))
    assert max(begun.values()) == 0


def test_progress_names_the_stages(fakes: Fakes, photos: Path, tmp_path: Path) -> None:
    seen: list[str] = []

    def progress(stage: str) -> Any:
        seen.append(stage)
        return lambda *_: None

    run(photos, tmp_path / "out", settings=METRIC, progress=progress)
    assert [name for name in ALL if name in seen] == [name for name in ALL if name != "check"]
    seen.clear()
    run(photos, tmp_path / "out", settings=METRIC, progress=progress)
    assert seen == []


def test_folder_of_other_origin_is_refused(fakes: Fakes, photos: Path, tmp_path: Path) -> None:
    mine = tmp_path / "out" / "depth" / "measured.txt"
    mine.parent.mkdir(parents=True)
    mine.write_text("precious", encoding="utf-8")
    with pytest.raises(InputError, match="choose another output folder"):
        run(photos, tmp_path / "out", settings=METRIC)
    assert mine.read_text(encoding="utf-8") == "precious"


def test_trees_of_the_runs_own_cloud_with_and_without_its_photographs(
    fakes: Fakes, photos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    run(photos, out, settings=METRIC)
    expected = dbh_cm(out)
    looked_at, clouds = [], []

    def looking(trees: Sequence[Any], *args: Any, **kwargs: Any) -> Any:
        looked_at.append(len(trees))
        return find_edges(trees, *args, **kwargs)

    def measuring(*args: Any, **kwargs: Any) -> Any:
        clouds.append(len(kwargs["cloud_xyz"]))
        return measure_silhouettes(*args, **kwargs)

    monkeypatch.setattr(silhouettes, "find_edges", looking)
    monkeypatch.setattr(tree_stage, "measure_silhouettes", measuring)
    for gone in (None, out / "scene" / "images"):
        if gone is not None:
            shutil.rmtree(gone)
        measure_cloud_file(out / "cloud.ply", out, request=ScaleRequest())
        assert dbh_cm(out) == expected
    # The photographs were looked at the first time; without them the points have to do.
    assert looked_at == [len(STEMS)]
    assert clouds == [len(read_cloud(out / "cloud.ply").xyz)]


def test_the_cloud_of_a_run_that_was_stopped_is_measured_in_its_own_unit(
    fakes: Fakes, photos: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    fakes.fail_in = "trees"
    with pytest.raises(KeyboardInterrupt):
        run(photos, out)
    assert not (out / "plot.json").exists()
    for _ in range(2):
        found = measure_cloud_file(out / "cloud.ply", out, request=ScaleRequest()).result
        assert (found.metric, found.trees.trees_with_dbh) == (False, 0)
        assert CaptureCode.no_scale_given in [told.code for told in found.trees.warnings]
        assert read_plot(out)["units"] == "model units"
    # A factor is metres per unit of the cloud, and makes no metric cloud of it.
    scaled = measure_cloud_file(out / "cloud.ply", out, request=ScaleRequest(factor=M_PER_UNIT))
    assert (scaled.result.metric, scaled.result.trees.trees_with_dbh) == (True, len(STEMS))
    assert (read_plot(out)["units"], read_plot(out)["cloud"]["units"]) == ("m", "model units")
    assert not measure_cloud_file(out / "cloud.ply", out, request=ScaleRequest()).result.metric
    # The same folder with a scale, stopped again: the cloud is in metres now, and what the last command told is old.
    with pytest.raises(KeyboardInterrupt):
        run(photos, out, settings=METRIC)
    found = measure_cloud_file(out / "cloud.ply", out, request=ScaleRequest()).result
    assert (found.metric, found.scale.m_per_unit, found.trees.trees_with_dbh) == (True, None, len(STEMS))
    measured = dbh_cm(out)
    plot = read_plot(out)
    assert (plot["units"], plot["scale_m_per_unit"], plot["points"]) == ("m", M_PER_UNIT, found.points)
    fakes.fail_in = ""
    run(photos, out, settings=METRIC)
    assert measured == dbh_cm(out)


def test_the_cloud_of_a_run_that_was_stopped_is_known_by_the_records_of_an_earlier_version(
    fakes: Fakes, photos: Path, tmp_path: Path
) -> None:
    """What the boards told of a scale from elsewhere is new in them, and the cloud was of unknown unit without it."""
    out = tmp_path / "out"
    fakes.fail_in = "trees"
    with pytest.raises(KeyboardInterrupt):
        run(photos, out, settings=METRIC)
    record = out / ".fsinfer" / "scale.json"
    told = json.loads(record.read_text(encoding="utf-8"))
    del told["result"]["others"]
    record.write_text(json.dumps(told | {"version": 4}), encoding="utf-8")
    found = measure_cloud_file(out / "cloud.ply", out, request=ScaleRequest()).result
    assert (found.metric, found.trees.trees_with_dbh) == (True, len(STEMS))


def test_a_cloud_whose_unit_nobody_knows_is_refused(
    fakes: Fakes, photos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    run(photos, out)

    def stopped(path: Path, cloud: PointCloud) -> None:
        write_cloud(path, cloud)
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(cloud_stages, "write_cloud", stopped)
        with pytest.raises(KeyboardInterrupt):
            run(photos, out, settings=METRIC)
    # cloud.ply is in metres, cloud.laz and plot.json are in model units.
    for name in ("cloud.ply", "cloud.laz"):
        with pytest.raises(InputError, match="run the same command again"):
            measure_cloud_file(out / name, out, request=ScaleRequest())
    run(photos, out, settings=METRIC)
    assert measure_cloud_file(out / "cloud.ply", out, request=ScaleRequest()).result.metric
    # A cloud that was cut by hand keeps the unit of the run.
    cloud = read_cloud(out / "cloud.ply")
    write_cloud(out / "cloud.ply", cloud.select(np.arange(len(cloud)) % 10 > 0))
    assert measure_cloud_file(out / "cloud.ply", out, request=ScaleRequest()).result.metric


def test_depth_by_itself_finds_the_runs_maps_done_and_the_run_those_of_depth(
    fakes: Fakes, photos: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    run(photos, out, settings=METRIC)
    assert not depth_of(out / "scene", out, settings=DepthSettings()).ran
    assert depth_of(out / "scene", out, settings=DepthSettings(source_views=2)).ran
    again = run(photos, out, settings=replace(METRIC, depth=DepthSettings(source_views=2)))
    assert "depth" not in ran(again)
    assert "fuse" in ran(again)


def test_a_folder_that_was_moved_is_finished_all_the_same(fakes: Fakes, photos: Path, tmp_path: Path) -> None:
    run(photos, tmp_path / "out", settings=METRIC)
    (tmp_path / "out").rename(tmp_path / "elsewhere")
    moved = run(photos, tmp_path / "elsewhere", settings=METRIC)
    assert ran(moved) == []
    assert moved.records.cloud.result.path == tmp_path / "elsewhere" / "cloud.ply"


# A stick of a metre, upright between the stems.
STICK_M = np.array([[0.2, 0.1, 0.3], [0.2, 0.1, 1.3]])


def clicking(out: Path, *views: int) -> Callable[[str], None]:
    """What a user does on the page: both ends in these views, then "Use this scale"."""
    scene = read_scene(out / "scene")
    clicks = {}
    for index in views:
        pixels, _ = project(STICK_M @ _TURN.T / M_PER_UNIT, scene.views[index].camera)
        clicks[scene.views[index].name] = pixels.tolist()

    def show(url: str) -> None:
        body = json.dumps({"clicks": clicks}).encode()
        with urlopen(Request(url + "use", body, method="POST"), timeout=20) as answer:
            assert answer.status == 200

    return show


def test_two_clicked_points_give_the_scale_and_repeat_nothing_dear(fakes: Fakes, photos: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert run(photos, out).plot["units"] == "model units"
    result = click_scale(out, 1.0, show=clicking(out, 0, 3)).run
    assert result is not None
    assert ran(result) == ["scale", "cloud", "trees", "report"]
    assert (result.plot["units"], result.plot["scale_source"]) == ("m", "endpoints")
    assert result.plot["scale_m_per_unit"] == pytest.approx(M_PER_UNIT, rel=1e-6)
    assert result.plot["scale_details"]["views"] == ["view_00", "view_03"]
    np.testing.assert_allclose(sorted(float(d) for d in dbh_cm(out)), sorted(200 * STEMS[:, 2]), atol=1.0)
    assert result.plot == json.loads((out / "plot.json").read_text(encoding="utf-8"))
    # Later runs keep it, until an option says otherwise or the file is gone.
    assert ran(run(photos, out)) == []
    assert run(photos, out, settings=METRIC).plot["scale_source"] == "factor"
    assert run(photos, out).plot["scale_source"] == "endpoints"
    (out / "scale_clicks.json").unlink()
    assert run(photos, out).plot["units"] == "model units"


def test_clicks_before_the_first_run_has_ended_are_kept_for_it(fakes: Fakes, photos: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    fakes.fail_in = "fuse"
    with pytest.raises(KeyboardInterrupt):
        run(photos, out)
    assert click_scale(out, 1.0, show=clicking(out, 0, 3)).run is None
    fakes.fail_in = ""
    assert run(photos, out).plot["scale_m_per_unit"] == pytest.approx(M_PER_UNIT, rel=1e-6)


def test_a_clicked_scale_keeps_the_corrections_that_the_run_was_given(
    fakes: Fakes, photos: Path, tmp_path: Path
) -> None:
    out, mine = tmp_path / "out", tmp_path / "mine.csv"
    mine.write_text("action,tree_id\ndelete,2\n", encoding="utf-8")
    assert run(photos, out, edits=mine).plot["trees"] == len(STEMS) - 1
    clicked = click_scale(out, 1.0, show=clicking(out, 0, 3)).run
    assert clicked is not None
    assert (clicked.plot["units"], clicked.plot["trees"]) == ("m", len(STEMS) - 1)
    # A second time, as the last measurement was by the click.
    again = click_scale(out, 2.0, show=clicking(out, 0, 3)).run
    assert again is not None
    assert again.plot["trees"] == len(STEMS) - 1
    before = (out / "plot.json").read_bytes()
    mine.rename(tmp_path / "away.csv")
    with pytest.raises(InputError, match=r"mine\.csv, are gone; put the file back or copy it to .*edits\.csv"):
        click_scale(out, 1.0, show=lambda _: pytest.fail("the page is not to be shown"))
    assert (out / "plot.json").read_bytes() == before
    (tmp_path / "away.csv").rename(out / "edits.csv")
    found = click_scale(out, 1.0, show=clicking(out, 0, 3)).run
    assert found is not None
    assert found.plot["trees"] == len(STEMS) - 1
    # A run without corrections: there are none to keep.
    (out / "edits.csv").unlink()
    assert run(photos, out).plot["trees"] == len(STEMS)
    without = click_scale(out, 2.0, show=clicking(out, 0, 3)).run
    assert without is not None
    assert without.plot["trees"] == len(STEMS)


def test_a_clicked_scale_keeps_the_boards_that_the_run_was_told_to_look_for(
    fakes: Fakes, photos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Boards of another dictionary, without a length: the border lies round one of them."""
    others = replace(scale_of_boards([board(7, (0.0, 0.0, 0.0), "abc")], m_per_unit=M_PER_UNIT), source="none")

    def find(request: ScaleRequest, **given: Any) -> FoundScale:
        found = real_find_scale(request, **given)
        return replace(found, others=others) if request.aruco_dictionary == "5X5_50" else found

    monkeypatch.setattr(cloud_stages, "find_scale", find)
    out, border = tmp_path / "out", BorderRequest(radius_m=1.38, marker=7)
    settings = RunSettings(scale=ScaleRequest(aruco_dictionary="5X5_50"), border=border)
    run(photos, out, settings=settings)
    clicked = click_scale(out, 1.0, show=clicking(out, 0, 3)).run
    assert clicked is not None
    assert clicked.plot["plot_border"]["origin"] == "marker 7"
    assert ran(run(photos, out, settings=settings)) == []


def test_a_clicked_scale_keeps_the_corrections_of_trees_measured_alone_in_a_folder_that_was_moved(
    fakes: Fakes, photos: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    run(photos, out, settings=METRIC)
    (out / "mine.csv").write_text("action,tree_id\ndelete,2\n", encoding="utf-8")
    measure_cloud_file(out / "cloud.ply", out, request=ScaleRequest(), edits=out / "mine.csv")
    moved = out.rename(tmp_path / "moved")
    clicked = click_scale(moved, 1.0, show=clicking(moved, 0, 3)).run
    assert clicked is not None
    assert clicked.plot["trees"] == len(STEMS) - 1


def test_a_clicked_scale_after_the_trees_of_another_cloud_is_of_the_run_s_photographs(
    fakes: Fakes, photos: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    before = run(photos, out).plot
    (out / "cloud.ply").rename(tmp_path / "scan.ply")
    measure_cloud_file(tmp_path / "scan.ply", out, request=ScaleRequest(factor=M_PER_UNIT))
    assert read_plot(out)["source"] == "scan.ply"
    clicked = click_scale(out, 1.0, show=clicking(out, 0, 3)).run
    assert clicked is not None
    assert [clicked.plot[key] for key in ("source", "photos")] == [before[key] for key in ("source", "photos")]


def test_a_border_goes_through_a_run(fakes: Fakes, photos: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    run(photos, out, settings=METRIC)
    bordered = run(photos, out, settings=replace(METRIC, border=BorderRequest(radius_m=1.38)))
    assert ran(bordered) == ["trees", "report"]
    plot = bordered.plot
    assert plot["per_hectare_of"] == "the plot within its border"
    assert (plot["plot_border"]["origin"], plot["plot_border"]["stems"]) == ("walk", 2)
    assert plot["warning_codes"][-1]["code"] == "border_cases"
    marker = run(photos, out, settings=replace(METRIC, border=BorderRequest(radius_m=1.38, marker=7))).plot
    assert (marker["per_hectare_of"], marker["plot_border"]) == ("seen ground only", None)
    assert "marker 7, was not found" in marker["warnings"][-1]


def test_a_border_lies_round_a_board_whose_length_nobody_knows(
    fakes: Fakes, photos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    others = replace(scale_of_boards([board(7, (0.0, 0.0, 0.0), "abc")], m_per_unit=M_PER_UNIT), source="none")

    def find_scale(*_: Any, **__: Any) -> FoundScale:
        return FoundScale(scale=scale_from_factor(M_PER_UNIT), others=others)

    monkeypatch.setattr(cloud_stages, "find_scale", find_scale)
    monkeypatch.setattr(measure_cloud, "seen_boards", lambda *_, **__: others)
    out, border = tmp_path / "out", BorderRequest(radius_m=1.38, marker=7)
    plot = run(photos, out, settings=replace(METRIC, border=border)).plot
    assert plot["plot_border"]["origin"] == "marker 7"
    assert not plot["scale_details"]
    # So it does where its trees are measured again.
    stage = TreeStageSettings(border=border)
    measure_cloud_file(out / "cloud.ply", out, request=ScaleRequest(), settings=MeasureSettings(stage=stage))
    again = json.loads((out / "plot.json").read_text(encoding="utf-8"))
    assert again["plot_border"]["center"] == pytest.approx(plot["plot_border"]["center"])


def test_what_is_known_of_scale_cameras_and_boards_is_given_to_the_trees(
    fakes: Fakes, photos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[PlotCloudInput] = []

    def measure_plot(cloud: PlotCloudInput, *args: Any, **kwargs: Any) -> Any:
        given.append(cloud)
        return real_trees(cloud, *args, **kwargs)

    def find_scale(*_: Any, scene: Any, **__: Any) -> FoundScale:
        # The scene is that of the poses; what they know of its cameras stands beside it.
        entries = {view.name: {"center": 0.03, "direction_rad": 0.004} for view in scene.views[1:]}
        write_text(scene.folder / "poses.json", json.dumps({"camera_std": entries}))
        boards = [board(number, (number, 0.0, 1.0), "abc") for number in (40, 43)]
        return FoundScale(scale=scale_of_boards(boards, m_per_unit=M_PER_UNIT, rel_std=0.02))

    monkeypatch.setattr(pipeline, "measure_plot", measure_plot)
    monkeypatch.setattr(cloud_stages, "find_scale", find_scale)
    out = tmp_path / "out"
    run(photos, out)
    (cloud,) = given
    assert cloud.scale_rel_std == 0.02
    assert cloud.marker_numbers == (40, 43)
    assert cloud.photos is not None
    assert cloud.photos.ray_std_m is not None
    # Three metres or more from each camera; the first one is not known.
    std_m = cloud.photos.ray_std_m(np.zeros(3))
    assert std_m[0] == 0.0
    assert (std_m[1:] > np.hypot(M_PER_UNIT * 0.03, 3.0 * 0.004)).all()
    for row in read_trees(out / "trees.csv"):
        assert row.dbh_hi95_cm is not None
        assert row.dbh_lo95_cm is not None
        assert row.dbh_cm is not None
        assert row.dbh_hi95_cm - row.dbh_lo95_cm > 2 * 1.96 * 0.02 * row.dbh_cm


def test_no_stem_is_ok_where_boards_stand_metres_from_themselves(
    fakes: Fakes, photos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def find_scale(*_: Any, **__: Any) -> FoundScale:
        boards = [board(n, (n, y, 1.0), "abc"[: 3 - y // 4]) for n in (40, 43) for y in (0, 4)]
        scale = scale_of_boards(boards, m_per_unit=M_PER_UNIT, rel_std=0.02)
        return FoundScale(scale=scale, warnings=boards_at_two_places(scale, M_PER_UNIT))

    monkeypatch.setattr(cloud_stages, "find_scale", find_scale)
    out = tmp_path / "out"
    run(photos, out)
    measure_cloud_file(out / "cloud.ply", tmp_path / "again", request=ScaleRequest())
    shutil.rmtree(out / "confidence")
    measure_cloud_file(out / "cloud.ply", tmp_path / "alone", request=ScaleRequest())
    for folder in (out, tmp_path / "again", tmp_path / "alone"):
        rows = [row for row in read_trees(folder / "trees.csv") if row.dbh_cm is not None]
        assert rows
        assert {row.status for row in rows} == {"doubtful"}
        assert all("boards 40, 43 stand at two places" in row.reason for row in rows)
