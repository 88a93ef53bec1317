"""The command line: help, exit codes, what is printed, and the commands on small real input."""

from __future__ import annotations

import csv
import errno
import json
import logging
import shutil
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fsinfer
from fsinfer.check import CheckSettings
from fsinfer.cli.console import explain, reports_errors, stage_progress, warn
from fsinfer.depth.manifest import models_folder
from fsinfer.errors import CloudError, FsinferError
from fsinfer.io.cloud import PointCloud, read_cloud, write_cloud
from fsinfer.output.layout import RECORDS_FOLDER
from fsinfer.output.plot_json import read_plot
from fsinfer.poses.settings import PoseSettings
from fsinfer.scene import read_scene
from fsinfer.workflow.folder_lock import alone_in
from fsinfer.workflow.settings import RunSettings, speedless
from tests.support.command_line import Call
from tests.support.synthetic_plot import M_PER_UNIT, STEMS, write_depth_folder, write_scene_folder

COMMANDS = (
    "demo",
    "run",
    "marker",
    "check",
    "frames",
    "poses",
    "depth",
    "fuse",
    "trees",
    "evaluate",
    "report",
    "support",
)


def test_help_names_every_command(call: Call) -> None:
    code, out, _ = call("--help")
    assert code == 0
    assert [name for name in COMMANDS if name not in out] == []


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(call: Call, command: str) -> None:
    code, out, _ = call(command, "--help")
    assert code == 0
    assert "--debug" in out


def test_what_a_command_takes_is_told(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    # A report is made of what is there; its folder is not made.
    assert "made if missing" not in call("report", "--help")[1]
    assert "made if missing" in call("trees", "--help")[1]
    assert "LAZ or text" in call("trees", "--help")[1]


@pytest.mark.parametrize("command", ["run", "trees"])
def test_scale_options_are_there(call: Call, command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    out = call(command, "--help")[1]
    assert [
        o for o in ("--aruco-length-m", "--aruco-dictionary", "--endpoints", "--length-m", "--scale") if o not in out
    ] == []


class _StoppedError(FsinferError):
    """Ends a command before its work."""


@pytest.mark.parametrize(
    ("options", "dictionary"),
    [
        ((), "4X4_50"),
        (("--aruco-dictionary", "5X5_100"), "5X5_100"),
        (("--aruco-dictionary", "dict_5x5_100"), "5X5_100"),
    ],
)
def test_run_and_check_tie_photos_by_the_same_markers(
    call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: tuple[str, ...], dictionary: str
) -> None:
    given: dict[str, RunSettings | CheckSettings] = {}

    def catch(command: str) -> Callable[..., None]:
        def stop(*_: object, settings: RunSettings | CheckSettings, **__: object) -> None:
            given[command] = settings
            raise _StoppedError

        return stop

    monkeypatch.setattr("fsinfer.workflow.pipeline.run", catch("run"))
    monkeypatch.setattr("fsinfer.check.check_capture", catch("check"))
    for command in ("run", "check"):
        call(command, tmp_path, tmp_path / "out", *options)
    for settings in given.values():
        assert settings.poses.dictionary == settings.scale.aruco_dictionary == dictionary
    # What a run goes on from is told by all that decides about poses.
    assert speedless(given["run"].poses) == speedless(given["check"].poses)
    if not options:
        assert given["run"].poses == PoseSettings()


def test_a_misspelt_dictionary_is_told_before_any_work(call: Call, tmp_path: Path) -> None:
    for command in ("run", "check"):
        code, _, err = call(command, tmp_path, tmp_path / "out", "--aruco-dictionary", "9X9_99")
        assert code == 2
        assert "--aruco-dictionary 9X9_99 is unknown; it is one of 4X4_100," in err


def test_marker_prints_boards_that_tell_their_length(call: Call, tmp_path: Path) -> None:
    code, out, _ = call("marker", "--out", tmp_path / "m.pdf", "--paper", "a3", "--count", 2)
    assert code == 0
    assert "2 boards (40, 41), black square 250 mm, A3" in out
    assert (tmp_path / "m.pdf").read_bytes().startswith(b"%PDF")
    code, _, err = call("marker", "--out", tmp_path / "n.pdf", "--ids", "1,x")
    assert code == 2
    assert "--ids" in err


def test_version(call: Call) -> None:
    assert call("--version")[:2] == (0, f"fsinfer {fsinfer.__version__}\n")


@pytest.mark.parametrize(
    ("error", "code", "part"),
    [
        (CloudError("a.ply is empty;\n  export it again"), 2, "Error: a.ply is empty; export it again"),
        (OSError(errno.ENOSPC, "No space left on device", "x.pfm"), 2, "Error: No space left on device: x.pfm"),
        (PermissionError(errno.EACCES, "Permission denied", "x"), 2, "Error: Permission denied: x"),
        (OSError(errno.ENAMETOOLONG, "File name too long", "x" * 256), 2, "a name is too long for this disk: xxx"),
        (MemoryError(), 2, "--max-size"),
        (ZeroDivisionError("division by zero"), 1, "Internal error (ZeroDivisionError: division by zero)"),
        (OSError(errno.EIO, "Input/output error", "x"), 1, "--debug"),
    ],
)
def test_errors_are_one_line_with_the_right_code(error: Exception, code: int, part: str) -> None:
    message, given = explain(error)
    assert given == code
    assert part in message
    assert "\n" not in message


def _failing(error: BaseException) -> Callable[..., None]:
    @reports_errors
    def command(*, debug: bool = False) -> None:
        raise error

    return command


def test_trace_only_with_debug(capsys: pytest.CaptureFixture[str]) -> None:
    import typer

    for debug in (False, True):
        with pytest.raises(typer.Exit) as stopped:
            _failing(KeyError("x"))(debug=debug)
        assert stopped.value.exit_code == 1
        assert ("Traceback" in capsys.readouterr().err) is debug


def test_interrupt_says_how_to_go_on(capsys: pytest.CaptureFixture[str]) -> None:
    import typer

    with pytest.raises(typer.Exit) as stopped:
        _failing(KeyboardInterrupt())()
    assert stopped.value.exit_code == 130
    assert "run the same command again to go on" in capsys.readouterr().err


def test_progress_goes_to_stderr_and_quiet_is_quiet(capsys: pytest.CaptureFixture[str]) -> None:
    for quiet in (False, True):
        with stage_progress(quiet=quiet) as progress:
            report = progress("depth")
            report(0, 2, "a")
            report(2, 2, "depth")
        captured = capsys.readouterr()
        assert captured.out == ""
        assert ("depth: 2/2" in captured.err) is not quiet


def test_progress_bar_on_a_terminal(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with stage_progress(quiet=False) as progress:
        report = progress("depth")
        for done in range(4):
            report(done, 3, "views")
    assert "3/3" in capsys.readouterr().err


@pytest.fixture
def metric_out(tmp_path: Path, call: Call) -> Path:
    """A folder with the cloud that ``fuse`` made of exact depth, in levelled model units."""
    write_scene_folder(tmp_path / "scene")
    # What tells a scene of fsinfer poses, whose axes and unit mean nothing, from one of other origin.
    (tmp_path / "scene" / "poses.json").write_text("{}", encoding="utf-8")
    out = tmp_path / "out"
    write_depth_folder(read_scene(tmp_path / "scene"), out)
    code, text, err = call("fuse", tmp_path / "scene", out, "--quiet")
    assert code == 0, err
    assert "points in" in text
    return out


def _rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def test_fuse_then_trees(metric_out: Path, call: Call) -> None:
    cloud = read_cloud(metric_out / "cloud.ply")
    assert len(read_cloud(metric_out / "cloud.laz")) == len(cloud) == read_plot(metric_out)["points"]
    assert read_plot(metric_out)["units"] == "model units"

    code, out, err = call("trees", metric_out / "cloud.ply", metric_out, "--quiet")
    assert code == 0
    assert [row["dbh_cm"] for row in _rows(metric_out / "trees.csv")] == ["", "", ""]
    assert {row["reason"] for row in _rows(metric_out / "trees.csv")} == {"no scale"}
    assert "no scale was given" in err

    code, out, err = call("trees", metric_out / "cloud.ply", metric_out, "--scale", M_PER_UNIT, "--quiet")
    assert code == 0, err
    found = sorted(float(row["dbh_cm"]) for row in _rows(metric_out / "trees.csv"))
    assert out.startswith("3 trees, 3 with DBH")
    assert call("report", metric_out)[:2] == (0, f"{metric_out / 'report.html'}\n")
    np.testing.assert_allclose(found, sorted(200 * STEMS[:, 2]), atol=1.0)
    # The same once more leaves the report; that of another measurement would stand beside tables that it is not of.
    again = ("trees", metric_out / "cloud.ply", metric_out, "--scale", M_PER_UNIT, "--quiet")
    assert "is gone" not in call(*again)[1]
    assert (metric_out / "report.html").is_file()
    code, out, err = call(*again, "--bh", 1.0)
    assert code == 0, err
    assert not (metric_out / "report.html").exists()
    assert f"was of an earlier measurement and is gone: fsinfer report {metric_out}" in out
    # What a measurement that was killed has left may be of two.
    (metric_out / RECORDS_FOLDER / "measure.json").write_text('{"state": "started"}', encoding="utf-8")
    code, out, err = call("report", metric_out)
    assert (code, out) == (0, f"{metric_out / 'report.html'}\n")
    assert "may be of two measurements" in err
    # One that has come to its end since has written them all.
    code, out, err = call(*again, "--bh", 1.0)
    assert code == 0, err
    (metric_out / RECORDS_FOLDER / "trees.json").write_text('{"state": "started"}', encoding="utf-8")
    code, out, err = call("report", metric_out)
    assert (code, out) == (0, f"{metric_out / 'report.html'}\n")
    assert "may be of two measurements" not in err


def test_a_report_waits_until_nobody_is_at_work(metric_out: Path, call: Call) -> None:
    """Beside a run that replaces tables and figures it would draw a mixture."""
    begun, going = threading.Event(), threading.Event()

    def run() -> None:
        with alone_in(metric_out):
            begun.set()
            going.wait(60)

    other = threading.Thread(target=run)
    other.start()
    try:
        assert begun.wait(60)
        code, _, err = call("report", metric_out)
    finally:
        going.set()
        other.join()
    assert code == 2
    assert "another run of fsinfer is at work" in err
    assert not (metric_out / "report.html").exists()
    assert call("report", metric_out)[0] == 0


def test_a_measurement_that_was_refused_has_mixed_nothing(metric_out: Path, call: Call, tmp_path: Path) -> None:
    write_cloud(tmp_path / "few.ply", PointCloud(xyz=np.random.default_rng(0).uniform(0, 1, (50, 3))))
    code, _, err = call("trees", tmp_path / "few.ply", metric_out, "--quiet")
    assert code == 2
    assert "50 usable points" in err
    code, _, err = call("report", metric_out)
    assert code == 0
    assert "of two measurements" not in err


def test_a_report_of_no_run_makes_no_folder(tmp_path: Path, call: Call) -> None:
    assert call("report", tmp_path)[0] == call("report", tmp_path / "none")[0] == 2
    assert list(tmp_path.iterdir()) == []


def test_endpoints_may_be_negative(metric_out: Path, call: Call) -> None:
    options = ["--endpoints", "-1,0,0", "1,-0.0,0", "--length-m", 2 * M_PER_UNIT, "--quiet"]
    code, out, err = call("trees", metric_out / "cloud.ply", metric_out, *options)
    assert code == 0, err
    assert out.startswith("3 trees, 3 with DBH")


def test_fuse_keeps_the_frame_of_a_foreign_scene(tmp_path: Path, call: Call) -> None:
    write_scene_folder(tmp_path / "scene")
    out = tmp_path / "out"
    scene = read_scene(tmp_path / "scene")
    write_depth_folder(scene, out)
    assert call("fuse", tmp_path / "scene", out, "--quiet")[0] == 0
    assert read_plot(out)["cloud_from_scene"] == np.eye(4).tolist()
    # The ground goes through the origin of the scene, across the axis that points down in every camera.
    depth_below_origin = read_cloud(out / "cloud.ply").xyz @ scene.views[0].camera.cam_from_world[1, :3]
    assert np.median(depth_below_origin) == pytest.approx(0, abs=0.02)
    assert depth_below_origin.min() < -1.5 / M_PER_UNIT


def test_evaluate(tmp_path: Path, call: Call) -> None:
    measured, extracted = tmp_path / "measured.csv", tmp_path / "extracted.csv"
    measured.write_text("tree_id,x_m,y_m,dbh_cm\n1,0,0,30\n2,5,0,40\n3,0,5,20\n", encoding="utf-8")
    extracted.write_text("tree_id,x_m,y_m,dbh_cm\n8,0.1,0,31\n9,5,0.1,39\n", encoding="utf-8")
    code, out, err = call("evaluate", measured, extracted, "--json", "--align", "never")
    assert code == 0, err
    result: dict[str, Any] = json.loads(out)
    assert (result["n"], result["matched"], result["omitted"], result["false"]) == (3, 2, 1, 0)
    assert result["rmse_cm"] == pytest.approx(1.0)
    assert result["r"] == pytest.approx(2 / 3)
    code, out, _ = call("evaluate", measured, extracted, "--align", "never", "--figure", tmp_path / "f.png")
    assert code == 0
    # Of three trees two: what is over the matched alone says so.
    assert "rRMSE of matched    2.86 %" in out
    assert "AE of matched       97.14 %" in out
    assert (tmp_path / "f.png").stat().st_size > 1000


def test_evaluate_says_where_the_tables_seem_interchanged(tmp_path: Path, call: Call) -> None:
    measured, extracted = tmp_path / "measured.csv", tmp_path / "trees.csv"
    # What a person writes beside the diameters does not make the table one of fsinfer.
    measured.write_text("tree_id,x_m,y_m,dbh_cm,status\n1,0,0,30,alive\n2,5,0,40,dead\n", encoding="utf-8")
    extracted.write_text(
        "tree_id,x_m,y_m,dbh_cm,dbh_lo95_cm,dbh_hi95_cm,status\n1,0,0,31,29,33,ok\n2,5,0,39,38,40,ok\n",
        encoding="utf-8",
    )
    code, out, err = call("evaluate", extracted, measured)
    assert (code, "RMSE" in out) == (0, True)
    assert "seem to be interchanged" in err
    for tables in ((measured, extracted), (extracted, extracted)):
        code, out, err = call("evaluate", *tables)
        assert (code, "RMSE" in out, err) == (0, True, "")


@pytest.mark.parametrize(
    ("rows", "options", "says"),
    [
        ("8,40,0,31\n9,55,0.1,39\n", (), "given: no extracted tree stands where a measured one does. See whether x_m"),
        ("8,0,0,31\n", ("--by-id",), "given: no extracted tree has the tree_id of a measured one; without --by-id"),
        ("", (), "given: there are no extracted trees."),
        ("1,0,0,\n", (), "No matched tree has a DBH"),
    ],
)
def test_evaluate_says_why_there_is_no_accuracy(
    tmp_path: Path, call: Call, rows: str, options: tuple[str, ...], says: str
) -> None:
    measured, extracted = tmp_path / "measured.csv", tmp_path / "extracted.csv"
    measured.write_text("tree_id,x_m,y_m,dbh_cm\n1,0,0,30\n2,5,0,40\n3,0,5,20\n", encoding="utf-8")
    extracted.write_text(f"tree_id,x_m,y_m,dbh_cm\n{rows}", encoding="utf-8")
    code, out, err = call("evaluate", measured, extracted, *options)
    assert code == 0, err
    assert says in out.splitlines()[-1]


def test_warnings_of_the_library_are_shown_once(call: Call, capfd: pytest.CaptureFixture[str]) -> None:
    call("--version")
    call("--version")
    logging.getLogger("fsinfer.io.cloud").warning("%d points dropped", 3)
    warn(["3 points dropped"])
    logging.getLogger("fsinfer.io.cloud").info("not for people")
    assert capfd.readouterr().err == "Warning: 3 points dropped\n"


def test_a_provider_that_is_not_there_is_the_users_error(call: Call, tmp_path: Path) -> None:
    scene = tmp_path / "scene"
    write_scene_folder(scene)
    code, _, err = call("depth", scene, tmp_path / "out", "--provider", "nonsense", "--quiet")
    assert code == 2
    assert "no provider 'nonsense', only:" in err
    assert "cpu" in err


def test_a_precision_that_is_not_there_is_the_users_error(call: Call, tmp_path: Path) -> None:
    scene = tmp_path / "scene"
    write_scene_folder(scene)
    code, _, err = call("depth", scene, tmp_path / "out", "--precision", "half", "--quiet")
    assert code == 2
    assert "'half' is not one of" in err
    for file in models_folder().glob("field*"):
        shutil.copy(file, tmp_path)
    manifest = tmp_path / "field.json"
    data = json.loads(manifest.read_text(encoding="utf-8"))
    data.pop("int8", None)
    manifest.write_text(json.dumps(data), encoding="utf-8")
    for command in ("depth", "run"):
        source = scene if command == "depth" else scene / "images"
        code, _, err = call(command, source, tmp_path / "out", "--model", manifest, "--precision", "int8", "--quiet")
        assert code == 2
        assert "has no int8 regularizer" in err
        assert len(err.strip().splitlines()) == 1
