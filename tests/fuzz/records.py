"""Readers of fsinfer's own files: the ledger's records, plot.json, and what the report shows."""

from __future__ import annotations

import json
from contextlib import suppress
from functools import cache
from pathlib import Path
from shutil import copytree
from tempfile import mkdtemp
from typing import Any

from tests.fuzz.mutators import change_json, change_text, cut
from tests.fuzz.reader import Reader

_JSON = (change_json, change_json, change_json, change_text, cut)


def _frames_result(out: Path):  # type: ignore[no-untyped-def]
    from fsinfer.frames.select import FramesResult
    from fsinfer.frames.table import FrameRow

    row = FrameRow(name="a", source="a.jpg", time_s=1.5, sharpness=0.5, mean_luminance=100.0, dark_share=0.1,
                   bright_share=0.2, kept=True, reason="")  # fmt: skip
    return FramesResult(folder=out / "frames", rows=(row,))


def _poses_result(out: Path):  # type: ignore[no-untyped-def]
    from fsinfer.poses.estimate import PosesResult

    return PosesResult(scene=out / "scene", photos=3, registered=2)


def _run_stages(out: Path) -> None:
    from fsinfer.workflow.ledger import Ledger
    from fsinfer.workflow.photo_stages import FRAMES, POSES

    ledger = Ledger(out)

    def frames(_: bool):  # type: ignore[no-untyped-def]
        (out / "frames").mkdir(exist_ok=True)
        (out / "frames" / "frames.csv").write_text("a", encoding="utf-8")
        return _frames_result(out)

    def poses(_: bool):  # type: ignore[no-untyped-def]
        (out / "scene").mkdir(exist_ok=True)
        (out / "scene" / "pair.txt").write_text("0", encoding="utf-8")
        return _poses_result(out)

    first = ledger.run(FRAMES, frames, inputs={"source": ["a"], "settings": {}})
    second = ledger.run(POSES, poses, inputs={"photos": ["a"]}, after=[first])
    for record, folder in ((first, first.result.folder), (second, second.result.scene)):
        if not folder.resolve().is_relative_to(out.resolve()):
            msg = f"the result of {record.name} leads out of the output folder: {folder}"
            raise AssertionError(msg)


def _read_ledger(folder: Path) -> None:
    from fsinfer.workflow.ledger import Ledger, Stage
    from fsinfer.workflow.photo_stages import FRAMES, POSES

    ledger = Ledger(folder)
    stages: tuple[Stage[Any], ...] = (FRAMES, POSES)
    for stage in stages:
        ledger.recall(stage)
        ledger.inputs_of(stage.name)
        ledger.has(stage.name)
    _run_stages(folder)


@cache
def _plot() -> Path:
    from fsinfer.output.json_values import as_json
    from fsinfer.workflow.settings import RunSettings
    from tests.support.report_plot import write_report_folder

    folder = write_report_folder(Path(mkdtemp()) / "plot")
    plot = json.loads((folder / "plot.json").read_text(encoding="utf-8"))
    plot |= {
        "warnings": ["a warning"], "settings": as_json(RunSettings()), "photos_given": 12,
        "warning_codes": [{"code": "a", "values": {"n": 1}, "text": "a warning", "remark": False}],
        "rejected": [{"name": "x", "reason": "blurred"}], "left_out": ["view_01"],
        "parts": [{"folder": "parts/1", "photos": 5, "trees": 1, "trees_with_dbh": 1, "error": None}],
        "scale_details": {"markers": [{"id": 1, "views": ["view_00"], "residual_mm": 1.0}]},
        "stand": {"trees": 3, "area_m2": 64.0}, "trees": 3, "trees_with_dbh": 3, "peak_rss_mb": 100.0,
        "plot_border": {"origin": "circle", "radius_m": 5.0, "area_m2": 78.5, "center": [0, 0]},
    }  # fmt: skip
    (folder / "plot.json").write_text(json.dumps(plot), encoding="utf-8")
    trees = [
        {"tree_id": n, "reasons": [{"code": "a", "values": {}, "text": "t", "advises_revisit": True}]} for n in (1, 2)
    ]
    (folder / "trees.json").write_text(json.dumps(trees), encoding="utf-8")
    return folder


def _make_plot(folder: Path) -> None:
    copytree(_plot(), folder, dirs_exist_ok=True)


def _make_small(folder: Path) -> None:
    for name in ("plot.json", "trees.json", "trees.csv"):
        (folder / name).write_bytes((_plot() / name).read_bytes())


def _report(folder: Path) -> None:
    from fsinfer.report import make_report

    page = make_report(folder).read_text(encoding="utf-8")
    assert "<script>alert" not in page


def _read_plot(folder: Path) -> None:
    from fsinfer.output.json_values import of_json
    from fsinfer.output.plot_json import read_plot, write_plot
    from fsinfer.output.support import write_support_zip
    from fsinfer.report.contents import read_contents
    from fsinfer.workflow.settings import RunSettings

    plot = read_plot(folder)
    with suppress(TypeError, ValueError, KeyError, OverflowError):  # as the caller does
        of_json(RunSettings, plot.get("settings"))
    write_plot(folder.parent / "again", plot)
    contents = read_contents(folder)
    _ = (contents.metric, contents.metre, contents.cloud_from_scene, contents.trees_per_cloud, contents.warnings)
    write_support_zip(folder, folder.parent / "support.zip")


READERS = (
    Reader(name="ledger", what="records of the stages (.fsinfer/*.json)", make=_run_stages, read=_read_ledger,
           targets=(".fsinfer/*.json",), mutators=_JSON),
    Reader(name="plot-json", what="plot.json, and the support zip", make=_make_small, targets=("plot.json",),
           mutators=_JSON, read=_read_plot),
    Reader(name="report", what="reports of changed output folders", make=_make_plot, read=_report, most_mb=512,
           targets=("plot.json", "plot.json", "plot.json", "trees.json"), mutators=_JSON[:3]),
    Reader(name="report-tables", what="reports of changed tables and maps", make=_make_plot, read=_report, most_mb=512,
           targets=("trees.csv", "scene/cams/*_cam.txt", "depth/depth.json", "trees.laz", "scene/images/*.jpg"),
           mutators=(change_text, cut)),
)  # fmt: skip
