"""A whole run with exact frames, poses and depth that kills itself: ``python killed_run.py PHOTOS OUT STAGE WRITES``.

SIGKILL strikes once ``STAGE`` has begun and ``WRITES`` more files have been replaced; with STAGE "never" it ends.
The stages from fusion on are the real ones; drawing is left out for speed.
"""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

from fsinfer.depth.sfm_check import DepthCheck
from fsinfer.depth.stage import DepthResult
from fsinfer.frames.select import FramesResult
from fsinfer.frames.table import FrameRow
from fsinfer.io.files import copy_file, make_folder, write_text
from fsinfer.io.photo_folders import list_images
from fsinfer.poses.estimate import PosesResult
from fsinfer.scale.request import ScaleRequest
from fsinfer.workflow import pipeline
from fsinfer.workflow.settings import RunSettings
from tests.support.synthetic_plot import M_PER_UNIT, VIEWS, write_depth_folder, write_scene_folder


def main(source: Path, out: Path, stage: str, writes: int) -> None:
    kill_after(out / ".fsinfer" / f"{stage}.json", writes)
    stand_in()
    settings = RunSettings(scale=ScaleRequest(factor=M_PER_UNIT))
    result = pipeline.run(source, out, settings=settings)
    print(*(record.name for record in result.stages if record.ran))


def stand_in() -> None:
    """Exact frames, poses and depth in the place of the real ones, and no drawing."""
    manifest = SimpleNamespace(int8_regularizer=None, sha256_of=lambda *, int8: "0" * 64)
    checked = DepthCheck(median_rel=0.0025, per_view_rel={}, compared=1, asked=1, relaxed=False)
    stand_ins = {
        "fsinfer.workflow.photo_stages.select_frames": select_frames,
        "fsinfer.workflow.photo_stages.estimate_poses_apart": estimate_poses,
        "fsinfer.workflow.cloud_stages.estimate_depth": estimate_depth,
        "fsinfer.workflow.cloud_stages.read_manifest": lambda _, **__: manifest,
        "fsinfer.workflow.cloud_stages.read_sparse": lambda _: None,
        "fsinfer.workflow.cloud_stages.check_depth": lambda *_, **__: checked,
        "fsinfer.report.make_report": report,
        "fsinfer.trees.outputs.figures.write_figures": lambda folder, *_, **__: make_folder(folder),
    }
    for name, made in stand_ins.items():
        patch(name, made).start()


def kill_after(record: Path, writes: int) -> None:
    """Every file is put in its place by ``Path.replace``: count from the one that says that the stage has begun."""
    replace = Path.replace
    seen = -1

    def counting(self: Path, target: Path) -> Any:
        nonlocal seen
        done = replace(self, target)
        if seen >= 0 or Path(target) == record:
            seen += 1
        if seen == writes:
            os.kill(os.getpid(), signal.SIGKILL)
        return done

    Path.replace = counting  # type: ignore[method-assign,assignment]


def report(folder: Path) -> Path:
    write_text(folder / "report.html", "<html>")
    return folder / "report.html"


def select_frames(source: Path, out: Path, **_: Any) -> FramesResult:
    (out / "images").mkdir(parents=True, exist_ok=True)
    rows = []
    for path in list_images(source):
        copy_file(path, out / "images" / path.name)
        rows.append(
            FrameRow(
                name=path.stem,
                source=path.name,
                time_s=None,
                sharpness=1.0,
                mean_luminance=100.0,
                dark_share=0.0,
                bright_share=0.0,
                kept=True,
                reason="",
            )
        )
    return FramesResult(folder=out, rows=tuple(rows))


def estimate_poses(images: Path, out: Path, **_: Any) -> PosesResult:
    write_scene_folder(out)
    return PosesResult(scene=out, photos=len(list_images(images)), registered=VIEWS)


def estimate_depth(scene: Any, out: Path, **_: Any) -> DepthResult:
    write_depth_folder(scene, out)
    return DepthResult(depth_folder=out, views=VIEWS, model="exact", model_sha256="0" * 64, precision="float32")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3], int(sys.argv[4]))
