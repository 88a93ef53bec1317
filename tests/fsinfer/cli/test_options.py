"""Every option of a command reaches the work: what it says stands in the settings that the work is given."""

from __future__ import annotations

from operator import attrgetter
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import typer
import typer.core

from fsinfer.cli.app import app
from fsinfer.errors import FsinferError
from tests.support.command_line import Call

#: What options say, and the fields of the settings in which it stands then.
SCALE: dict[str, dict[str, Any]] = {
    "--scale 0.5": {"scale.factor": 0.5},
    "--aruco-length-m 0.3": {"scale.aruco_length_m": 0.3},
    "--aruco-dictionary 5X5_100": {"scale.aruco_dictionary": "5X5_100"},
    "--endpoints -1,0,0 1,2,3 --length-m 2.5": {
        "scale.endpoints": ((-1.0, 0.0, 0.0), (1.0, 2.0, 3.0)),
        "scale.length_m": 2.5,
    },
}
TREES: dict[str, dict[str, Any]] = {
    "--bh 1.37": {"trees.bh_m": 1.37},
    "--bh-rule uphill": {"trees.bh_rule": "uphill"},
    "--plot-radius-m 12.62": {"border.radius_m": 12.62, "border.marker": None, "border.center": None},
    "--plot-radius-m 9 --plot-center marker:7": {"border.radius_m": 9.0, "border.marker": 7},
    "--plot-radius-m 9 --plot-center -1.5,2": {"border.radius_m": 9.0, "border.center": (-1.5, 2.0)},
    "--plot-polygon corners.csv": {"border.polygon": ((0.0, 0.0), (5.0, 0.0), (5.0, 5.0))},
    "--far-stems": {"walk.measure_far": True},
    "--edits mine.csv": {"edits": Path("mine.csv")},
}
DEPTH: dict[str, dict[str, Any]] = {
    "--model other.json": {"depth.model": "other.json"},
    "--views 3": {"depth.source_views": 2},
    "--max-size 640": {"depth.max_size_px": 640},
    "--jobs 1": {"depth.threads": 1},
    "--memory-gb 1.5": {"depth.memory_gb": 1.5},
    "--provider cuda": {"depth.provider": "cuda"},
    "--precision float32": {"depth.precision": "float32"},
    "--trust-model": {"depth.trust_model": True},
    "--scheduler tcp://10.0.0.5:8786 --copy": {"depth.scheduler": "tcp://10.0.0.5:8786", "depth.copy_photos": True},
}
FRAMES: dict[str, dict[str, Any]] = {
    "--interval-s 0.5": {"frames.interval_s": 0.5},
    "--equalize clahe": {"frames.equalize": "clahe"},
    "--max-size 3000": {"frames.longest_px": 3000},
    "--max-size 960": {"frames.longest_px": 2400},
}
RUN: dict[str, dict[str, Any]] = {
    **SCALE,
    **TREES,
    **DEPTH,
    **FRAMES,
    "--jobs 2": {"poses.threads": 2},
    "--max-size 2400": {"frames.longest_px": 2400, "poses.longest_px": 2400},
    "--max-size 3000": {"frames.longest_px": 3000, "poses.longest_px": 3000},
    "--memory-gb 2.5": {"fusion.memory_gb": 2.5},
}
#: What each command calls to do its work, and its options.
COMMANDS: dict[str, tuple[str, dict[str, dict[str, Any]]]] = {
    "run": ("fsinfer.workflow.pipeline.run", RUN),
    "trees": ("fsinfer.workflow.measure_cloud.measure_cloud_file", {**SCALE, **TREES}),
    "depth": ("fsinfer.workflow.single_stages.depth_of", {**DEPTH, "--images photos": {"images": Path("photos")}}),
    "frames": ("fsinfer.workflow.single_stages.frames_of", FRAMES),
    "poses": (
        "fsinfer.workflow.single_stages.poses_of",
        {"--jobs 2": {"poses.threads": 2}, "--max-size 3000": {"poses.longest_px": 3000}},
    ),
    "evaluate": (
        "fsinfer.evaluation.metrics.evaluate",
        {
            "--max-distance-m 0.7": {"max_distance_m": 0.7},
            "--by-id": {"by_id": True},
            "--align always": {"align": "always"},
            "--area-margin-m 1": {"area_margin_m": 1.0},
        },
    ),
    "check": (
        "fsinfer.check.check_capture",
        {
            "--aruco-length-m 0.3": {"scale.aruco_length_m": 0.3},
            "--aruco-dictionary 5X5_100": {"scale.aruco_dictionary": "5X5_100", "poses.dictionary": "5X5_100"},
            "--interval-s 0.5": {"frames.interval_s": 0.5},
            "--margin-m 2.5": {"coverage.margin_m": 2.5},
            "--max-size 3000": {"frames.longest_px": 3000, "poses.longest_px": 3000},
        },
    ),
}
#: What changes nothing but what is shown.
SHOWN = {"--quiet", "-q", "--debug", "--help", "-h", "--json", "--figure"}


class _StoppedError(FsinferError):
    """Ends a command before its work."""


def settings_of(command: str, given: dict[str, Any]) -> Any:
    """What the work was given, as an object that has the names that the tables above have for it."""
    if command == "evaluate":
        return SimpleNamespace(**given)
    settings = given["settings"]
    if command == "trees":
        return SimpleNamespace(**given | vars(settings.stage), scale=given["request"])
    if command in ("run", "check"):
        return SimpleNamespace(**given | vars(settings))
    return SimpleNamespace(**given | {command: settings})


@pytest.mark.parametrize(
    ("command", "words"), [(name, words) for name, (_, told) in COMMANDS.items() for words in told]
)
def test_an_option_reaches_the_work(
    command: str, words: str, call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("corners.csv").write_text("x_m,y_m\n0,0\n5,0\n5,5\n", encoding="utf-8")
    target, told = COMMANDS[command]
    given: dict[str, Any] = {}

    def stop(*_: object, **options: object) -> None:
        given.update(options)
        raise _StoppedError

    monkeypatch.setattr(target, stop)
    monkeypatch.setattr("fsinfer.evaluation.measured.read_measured", lambda *_, **__: [])
    silent = () if command == "evaluate" else ("--quiet",)
    code, _, error = call(command, "source", "out", *words.split(), *silent)
    assert (code, error) == (2, "Error: \n")
    found = settings_of(command, given)
    assert {name: attrgetter(name)(found) for name in told[words]} == told[words]


@pytest.mark.parametrize("command", COMMANDS)
def test_no_option_is_left_out_here(command: str) -> None:
    group = typer.main.get_command(app)
    assert isinstance(group, typer.core.TyperGroup)
    there = {name for option in group.commands[command].params for name in option.opts if name.startswith("-")}
    tried = {word for words in COMMANDS[command][1] for word in words.split() if word.startswith("--")}
    assert there - tried - SHOWN <= {"-j", "--threads"}
