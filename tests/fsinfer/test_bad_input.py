"""Each bad input on the command line: exit code 2, one message, no traceback, and nothing computed is lost."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fsinfer.cli.app import EXAMPLES
from fsinfer.io.cloud import PointCloud, write_cloud
from fsinfer.io.images import write_image
from fsinfer.scene import read_scene, write_camera
from tests.support.command_line import Call
from tests.support.synthetic_plot import write_depth_folder, write_scene_folder


def errors_of(result: tuple[int, str, str]) -> list[str]:
    """The error lines, after checking what holds for every error of the user."""
    code, out, err = result
    assert code == 2, (out, err)
    assert "Traceback" not in out + err
    lines = [line for line in err.splitlines() if line.startswith("Error: ")]
    assert len(lines) == 1, err
    return lines


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    folder = tmp_path / "scene"
    write_scene_folder(folder)
    return folder


def test_missing_source(call: Call, tmp_path: Path) -> None:
    for command in ("run", "frames", "poses"):
        message = errors_of(call(command, tmp_path / "nowhere", tmp_path / "out"))[0]
        assert "nowhere" in message


def test_empty_photo_folder(call: Call, tmp_path: Path) -> None:
    (tmp_path / "photos").mkdir()
    for command in ("run", "frames", "poses"):
        assert "photos" in errors_of(call(command, tmp_path / "photos", tmp_path / "out"))[0]


def test_photo_that_is_none(call: Call, tmp_path: Path) -> None:
    photos = tmp_path / "photos"
    photos.mkdir()
    for name in ("a.jpg", "b.jpg"):
        (photos / name).write_bytes(b"this is no photograph")
    assert ".jpg" in errors_of(call("poses", photos, tmp_path / "out"))[0]


def test_photos_that_do_not_overlap(call: Call, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for name in ("a", "b", "c"):
        noise = rng.integers(0, 255, (120, 160, 3), dtype=np.uint8)
        write_image(tmp_path / "photos" / f"{name}.jpg", noise)
    assert errors_of(call("poses", tmp_path / "photos", tmp_path / "out"))


def test_video_that_is_none(call: Call, tmp_path: Path) -> None:
    video = tmp_path / "walk.mp4"
    video.write_bytes(b"this is no video")
    assert "walk.mp4" in errors_of(call("frames", video, tmp_path / "out"))[0]


def test_scene_that_is_none(call: Call, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    for command in ("depth", "fuse"):
        assert "fsinfer poses" in errors_of(call(command, tmp_path / "empty", tmp_path / "out"))[0]
        assert errors_of(call(command, tmp_path / "nowhere", tmp_path / "out"))


def test_damaged_camera(call: Call, scene: Path, tmp_path: Path) -> None:
    (scene / "cams" / "view_03_cam.txt").write_text("extrinsic\n1 2 3\n", encoding="utf-8")
    assert "view_03_cam.txt" in errors_of(call("depth", scene, tmp_path / "out"))[0]


@pytest.mark.parametrize(("times", "fits"), [(0.25, "41x31"), (0.5, "80x60"), (2.0, "319x239")])
def test_cameras_for_pictures_of_another_size(call: Call, scene: Path, tmp_path: Path, times: float, fits: str) -> None:
    for view in read_scene(scene).views[4:]:
        intrinsic = np.diag([times, times, 1.0]) @ view.camera.intrinsic
        write_camera(scene / "cams" / f"{view.name}_cam.txt", replace(view.camera, intrinsic=intrinsic))
    message = errors_of(call("depth", scene, tmp_path / "out"))[0]
    assert "view_04_cam.txt" in message
    assert f"view_04.jpg, which has 160x120 pixels; a picture of about {fits} would fit" in message
    assert not (tmp_path / "out" / "depth").exists()


def test_unknown_model(call: Call, scene: Path, tmp_path: Path) -> None:
    assert "no-such-model" in errors_of(call("depth", scene, tmp_path / "out", "--model", "no-such-model"))[0]


def test_unknown_model_stops_a_run_before_any_work(call: Call, scene: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert "no-such-model" in errors_of(call("run", scene / "images", out, "--model", "no-such-model"))[0]
    assert not (out / "frames").exists()


def test_fuse_without_depth(call: Call, scene: Path, tmp_path: Path) -> None:
    assert "fsinfer depth" in errors_of(call("fuse", scene, tmp_path / "out"))[0]


def test_fuse_with_a_cut_depth_map(call: Call, scene: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    write_depth_folder(read_scene(scene), out)
    path = out / "depth" / "view_05.pfm"
    path.write_bytes(path.read_bytes()[:100])
    assert "view_05.pfm" in errors_of(call("fuse", scene, out))[0]
    assert (out / "depth" / "view_04.pfm").is_file()


def test_cloud_that_is_none(call: Call, tmp_path: Path) -> None:
    for name, content in (("a.ply", b"ply\nformat ascii"), ("a.laz", b"LASF"), ("a.docx", b"x"), ("b.las", b"")):
        path = tmp_path / name
        path.write_bytes(content)
        assert name in errors_of(call("trees", path, tmp_path / "out"))[0]
    assert "gone.ply" in errors_of(call("trees", tmp_path / "gone.ply", tmp_path / "out"))[0]


@pytest.fixture
def cloud(tmp_path: Path) -> Path:
    rng = np.random.default_rng(1)
    path = tmp_path / "cloud.ply"
    write_cloud(path, PointCloud(xyz=rng.uniform(0, [4, 4, 0.02], (2000, 3))))
    return path


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--scale", "-1"], "--scale"),
        (["--scale", "nan"], "--scale"),
        (["--scale", "0"], "--scale"),
        (["--aruco-length-m", "0"], "--aruco-length-m"),
        (["--scale", "1", "--aruco-length-m", "0.25"], "--aruco-length-m"),
        (["--endpoints", "0,0,0", "1,0,0"], "--length-m"),
        (["--length-m", "1"], "--endpoints"),
        (["--endpoints", "0,0,0", "0,0,0", "--length-m", "1"], "different"),
        (["--endpoints", "0,0", "1,0,0", "--length-m", "1"], "'0,0'"),
        (["--endpoints", "a,b,c", "1,0,0", "--length-m", "1"], "'a,b,c'"),
        (["--endpoints", "1,1,0", "-300.7,1,0", "--length-m", "1"], "-300.7,1,0: they are 301.7 apart"),
        (["--endpoints", "inf,0,0", "1,0,0", "--length-m", "1"], "finite"),
        (["--aruco-length-m", "0.25"], "--aruco-length-m"),
        (["--aruco-length-m", "0.25", "--aruco-dictionary", "9X9_99"], "9X9_99"),
    ],
)
def test_scale_options(call: Call, cloud: Path, tmp_path: Path, options: list[str], named: str) -> None:
    out = tmp_path / "out"
    assert named in errors_of(call("trees", cloud, out, *options))[0]
    assert not (out / "trees.csv").exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ["measure"],
        ["run"],
        ["run", "photos"],
        ["run", "photos", "out", "--scale", "big"],
        ["run", "photos", "out", "--views", "1"],
        ["run", "photos", "out", "--endpoints", "0,0,0"],
        ["evaluate", "a.csv", "b.csv", "--align", "perhaps"],
        ["trees", "a.ply", "out", "--no-such-option"],
    ],
)
def test_usage(call: Call, arguments: list[str]) -> None:
    code, out, err = call(*arguments)
    assert code == 2
    assert "Traceback" not in out + err
    assert err.strip()


def test_evaluate_with_tables_that_are_none(call: Call, tmp_path: Path) -> None:
    good, bad = tmp_path / "good.csv", tmp_path / "bad.csv"
    good.write_text("tree_id,x_m,y_m,dbh_cm\n1,0,0,30\n", encoding="utf-8")
    for content in ("", "a,b\n1,2\n", "tree_id,x_m,y_m,dbh_cm\n1,zero,0,30\n", "tree_id,x_m,y_m,dbh_cm\n1,0,0,-3\n"):
        bad.write_text(content, encoding="utf-8")
        assert "bad.csv" in errors_of(call("evaluate", bad, good))[0]
    assert "gone.csv" in errors_of(call("evaluate", tmp_path / "gone.csv", good))[0]
    assert "gone.csv" in errors_of(call("evaluate", good, tmp_path / "gone.csv"))[0]


def test_evaluate_with_a_column_twice(call: Call, tmp_path: Path) -> None:
    good, bad = tmp_path / "good.csv", tmp_path / "bad.csv"
    good.write_text("tree_id,x_m,y_m,dbh_cm\n1,0,0,30\n", encoding="utf-8")
    bad.write_text("tree_id,x_m,y_m,dbh_cm,note,DBH_cm,note\n1,0,0,30,a,31,b\n", encoding="utf-8")
    for tables in ((bad, good), (good, bad)):
        message = errors_of(call("evaluate", *tables))[0]
        assert "bad.csv has more than one column dbh_cm;" in message


def test_evaluate_with_an_area_that_ends_before_the_trees(call: Call, tmp_path: Path) -> None:
    good = tmp_path / "good.csv"
    good.write_text("tree_id,x_m,y_m,dbh_cm\n1,0,0,30\n", encoding="utf-8")
    code, out, err = call("evaluate", good, good, "--area-margin-m", "-1")
    assert (code, out) == (2, "")
    assert "--area-margin-m" in err


@pytest.mark.parametrize("figure", ["", ".", "folder", "f.docx", "f"])
def test_a_figure_that_cannot_be_drawn_is_told_before_the_comparison(
    call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, figure: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("folder").mkdir()
    Path("good.csv").write_text("tree_id,x_m,y_m,dbh_cm\n1,0,0,30\n", encoding="utf-8")
    message = errors_of(call("evaluate", "good.csv", "good.csv", "--figure", figure))[0]
    assert "--figure" in message
    assert ".png" in message
    assert sorted(path.name for path in tmp_path.iterdir()) == ["folder", "good.csv"]


def test_report_of_nothing(call: Call, tmp_path: Path) -> None:
    assert "nowhere" in errors_of(call("report", tmp_path / "nowhere"))[0]


def test_output_that_is_a_file(call: Call, cloud: Path, tmp_path: Path) -> None:
    (tmp_path / "out").write_text("in the way", encoding="utf-8")
    assert "out" in errors_of(call("trees", cloud, tmp_path / "out"))[0]
    assert (tmp_path / "out").read_text(encoding="utf-8") == "in the way"


def test_source_inside_the_output(call: Call, scene: Path, tmp_path: Path) -> None:
    message = errors_of(call("run", scene / "images", tmp_path))[0]
    assert "choose another output folder" in message
    assert (scene / "images" / "view_00.jpg").is_file()


def test_the_photos_are_no_output_folder(call: Call, tmp_path: Path) -> None:
    photos = tmp_path / "photos"
    write_image(photos / "a.jpg", np.zeros((120, 160, 3), np.uint8))
    for command in ("run", "check"):
        assert "photos-plot" in errors_of(call(command, photos, photos / "."))[0]
    assert [path.name for path in photos.iterdir()] == ["a.jpg"]


def test_a_marker_in_centimetres(call: Call, tmp_path: Path) -> None:
    message = errors_of(call("run", tmp_path, tmp_path / "out", "--aruco-length-m", 25))[0]
    assert "25 cm are 0.25" in message


def test_a_comma_in_a_number(call: Call, tmp_path: Path) -> None:
    for command in ("run", "trees"):
        code, _, err = call(command, tmp_path, tmp_path / "out", "--length-m", "2,05")
        assert code == 2
        assert "2.05" in err
    code, _, err = call("trees", tmp_path, tmp_path / "out", "--scale", "two")
    assert code == 2
    assert "'two'" in err


def test_a_missing_argument_is_shown_by_an_example(call: Call) -> None:
    for command, example in EXAMPLES.items():
        code, _, err = call(command)
        assert code == 2
        assert f"fsinfer {command} {example}" in " ".join(err.replace("│", " ").split())


def test_the_demo_is_not_put_among_photos(call: Call, tmp_path: Path) -> None:
    write_image(tmp_path / "a.jpg", np.zeros((120, 160, 3), np.uint8))
    assert "folder of its own" in errors_of(call("demo", tmp_path))[0]
    assert [path.name for path in tmp_path.iterdir()] == ["a.jpg"]


def test_the_cloud_before_its_scale_is_not_measured(call: Call, tmp_path: Path) -> None:
    for folder in (".fsinfer", "fused"):
        (tmp_path / folder).mkdir()
    write_cloud(tmp_path / "fused" / "cloud.ply", PointCloud(xyz=np.zeros((500, 3))))
    message = errors_of(call("trees", tmp_path / "fused" / "cloud.ply", tmp_path / "out"))[0]
    assert str(tmp_path / "cloud.ply") in message


def test_trees_without_a_scale_are_not_evaluated(call: Call, tmp_path: Path) -> None:
    (tmp_path / "measured.csv").write_text("tree_id,x_m,y_m,dbh_cm\n1,0,0,30\n", encoding="utf-8")
    (tmp_path / "trees.csv").write_text("tree_id,x_m,y_m,dbh_cm,reason\n1,0,0,,no scale\n", encoding="utf-8")
    message = errors_of(call("evaluate", tmp_path / "measured.csv", tmp_path / "trees.csv"))[0]
    assert "made without a scale" in message
    assert "there is no such file" in errors_of(call("evaluate", tmp_path / "gone.csv", tmp_path / "trees.csv"))[0]


def test_a_program_told_to_end_says_that_it_stopped(tmp_path: Path) -> None:
    code = """
import os, signal, time, typer
from fsinfer.cli.console import reports_errors, stop_on_signals

@reports_errors
def wait() -> None:
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(5)

stop_on_signals()
app = typer.Typer()
app.command()(wait)
app()
"""
    ended = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ended.returncode == 130
    assert ended.stderr == "Stopped. What is finished is kept: run the same command again to go on.\n"
