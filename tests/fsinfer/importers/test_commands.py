"""``fsinfer depth`` and what follows, given the scenes of other programs, from the command line."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from fsinfer.io.cloud import read_cloud
from fsinfer.io.pfm import read_pfm
from fsinfer.output.plot_json import read_plot
from fsinfer.scale.clicks.file import SavedClicks, write_clicks
from fsinfer.scale.request import ClickedEnds, ClickedLength
from fsinfer.scene import project, read_scene
from tests.support import foreign_scenes as made
from tests.support.command_line import Call
from tests.support.foreign_scenes import BROWN, PINHOLE, WALL_M, Truth

#: Blanks, umlauts, characters of three bytes, and a sign that shells and formats read otherwise.
AWKWARD = "Wald & Försterei 林 1,5"


def wall_error(out: Path) -> float:
    """Median of |depth - true| / true over the sure pixels of all views, whatever the unit and frame are."""
    found = []
    views = read_scene(out / "scene").views
    index = json.loads((out / "depth" / "depth.json").read_text(encoding="utf-8"))["views"]
    true = {photo.name: photo for photo in made.truth().photos}
    centers = np.array([view.camera.center for view in views])
    true_centers = np.array([made.world_from_cam(true[view.name])[:3, 3] for view in views])
    unit = np.linalg.norm(centers[-1] - centers[0]) / np.linalg.norm(true_centers[-1] - true_centers[0])
    for view in views:
        depth = read_pfm(out / "depth" / f"{view.name}.pfm")
        sure = read_pfm(out / "confidence" / f"{view.name}.pfm") > 0.2
        entry = index[view.name]
        v, u = np.nonzero(sure)
        matrix = view.camera.intrinsic
        x = (u * entry["pixel_step_x"] + entry["offset_x_px"] - matrix[0, 2]) / matrix[0, 0]
        y = (v * entry["pixel_step_y"] + entry["offset_y_px"] - matrix[1, 2]) / matrix[1, 1]
        pose = made.world_from_cam(true[view.name])
        directions = np.column_stack([x, y, np.ones_like(x)]) @ pose[:3, :3].T
        expected = (WALL_M - pose[1, 3]) / directions[:, 1] * unit
        found.append(np.abs(depth[sure] - expected) / expected)
    together = np.concatenate(found)
    assert len(together) > 1000
    return float(np.median(together))


def write_all(scene: Truth, base: Path) -> None:
    made.write_colmap(scene, base / "project" / "sparse" / "0", kind="FULL_OPENCV", binary=True)
    made.write_metashape(scene, base / "cameras.xml")
    made.write_photos(scene, base / "my photos")


FULL = made.TrueLens(bent=(*BROWN.bent, 0.0, 0.0, 0.0))


def test_a_project_of_colmap_becomes_a_cloud_and_trees_ask_for_a_scale(call: Call, tmp_path: Path) -> None:
    base = tmp_path / AWKWARD
    write_all(made.truth(FULL), base)
    out = base / "my plot"
    code, text, err = call("depth", base / "project", out, "--images", base / "my photos", "--jobs", 1, "-q")
    assert (code, err) == (0, "")
    assert "4 depth maps" in text
    assert wall_error(out) < 0.03
    # Given again it is done already; without the option the photographs are not found, and nothing is lost.
    before = (out / "depth" / "IMG_0000.pfm").stat().st_mtime_ns
    assert call("depth", base / "project", out, "--images", base / "my photos", "--jobs", 1, "-q")[0] == 0
    assert (out / "depth" / "IMG_0000.pfm").stat().st_mtime_ns == before
    code, _, err = call("depth", base / "project", out, "-q")
    assert code == 2
    assert "--images" in err
    assert (out / "scene" / "cams" / "IMG_0000_cam.txt").is_file()
    assert call("fuse", base / "project", out, "--no-level", "-q")[0] == 0
    plot = read_plot(out)
    assert (plot["units"], plot["scale_m_per_unit"], plot["scale_source"]) == ("model units", None, "none")
    cloud = read_cloud(out / "cloud.ply")
    assert np.median(cloud.xyz[:, 1]) == pytest.approx(WALL_M, rel=0.03)
    # Two ends clicked in two photographs give the scale of trees; --length-m 2 where the truth is 1.
    clicks = ClickedLength(views=tuple(_clicks(out, [[0.4, 3, 1.4], [1.4, 3, 1.4]])), length_m=2.0)
    code, _, err = call("trees", out / "cloud.ply", out, "-q")
    assert (code, "no scale" in err) == (0, True), err
    write_clicks(out, SavedClicks(used=clicks))
    code, _, err = call("trees", out / "cloud.ply", out, "-q")
    assert code == 0, err
    trees_scale = read_plot(out)["trees_scale"]
    assert trees_scale["m_per_unit"] == pytest.approx(2.0, rel=1e-3)
    assert trees_scale["source"] != "none"


def _clicks(out: Path, ends: list[list[float]]) -> list[ClickedEnds]:
    found = []
    for view in (read_scene(out / "scene").views[i] for i in (0, 2, 3)):
        (u0, v0), (u1, v1) = project(np.array(ends), view.camera)[0]
        found.append(ClickedEnds(view=view.name, first=(float(u0), float(v0)), second=(float(u1), float(v1))))
    return found


def test_cameras_of_metashape_become_a_cloud_in_metres(call: Call, tmp_path: Path) -> None:
    base = tmp_path / AWKWARD
    write_all(made.truth(BROWN), base)
    out = tmp_path / "out"
    code, _, err = call("depth", base / "cameras.xml", out, "--images", base / "my photos", "--jobs", 1, "-q")
    assert code == 0
    assert "Metashape gives no tie points" in err
    assert "1 photograph has no pose" in err
    assert wall_error(out) < 0.03
    centers = np.array([view.camera.center for view in read_scene(out / "scene").views])
    assert np.linalg.norm(centers[1] - centers[0]) == pytest.approx(0.3, abs=0.06)
    made.write_metashape(made.truth(BROWN), base / "others.xml", component=False)
    code, _, err = call("fuse", base / "others.xml", out, "--no-level", "-q")
    assert (code, "not the scene that was imported" in err) == (2, True)
    code, text, err = call("fuse", base / "cameras.xml", out, "--no-level", "-q")
    assert (code, err) == (0, ""), text
    plot = read_plot(out)
    assert (plot["units"], plot["scale_m_per_unit"], plot["scale_source"]) == ("m", 1.0, "Metashape")
    code, _, err = call("trees", out / "cloud.ply", out, "-q")
    assert code == 0
    assert "no scale" not in err


def test_fuse_before_depth_is_told(call: Call, tmp_path: Path) -> None:
    write_all(made.truth(BROWN), tmp_path)
    code, _, err = call("fuse", tmp_path / "cameras.xml", tmp_path / "out", "-q")
    assert code == 2
    assert "fsinfer depth" in err


def test_a_scene_of_ours_is_never_overwritten(call: Call, tmp_path: Path) -> None:
    write_all(made.truth(PINHOLE), tmp_path)
    kept = tmp_path / "out" / "scene" / "images" / "a.jpg"
    kept.parent.mkdir(parents=True)
    kept.write_bytes(b"somebody's")
    arguments = ("depth", tmp_path / "cameras.xml", tmp_path / "out", "--images", tmp_path / "my photos", "-q")
    code, _, err = call(*arguments)
    assert code == 2
    assert "choose another output folder" in err
    assert kept.read_bytes() == b"somebody's"
    # Nor are photographs that lie where the import would empty.
    made.write_photos(made.truth(PINHOLE), tmp_path / "new" / "scene" / "images")
    inside = tmp_path / "new" / "scene" / "images"
    code, _, err = call("depth", tmp_path / "cameras.xml", tmp_path / "new", "--images", inside, "-q")
    assert code == 2
    assert "empties and fills" in err
    assert len(list(inside.iterdir())) == 4


@pytest.mark.parametrize(
    ("given", "images", "told"),
    [
        ("nowhere", None, "is not a folder"),
        ("empty", None, "COLMAP, OpenMVS, Metashape"),
        ("cameras.xml", "nowhere", "--images"),
        ("empty", "my photos", "none that is known here"),
        ("cameras.xml", "empty", "give their folder with --images"),
    ],
)
def test_what_is_no_scene_is_told(call: Call, tmp_path: Path, given: str, images: str | None, told: str) -> None:
    write_all(made.truth(PINHOLE), tmp_path)
    (tmp_path / "empty").mkdir()
    options = () if images is None else ("--images", tmp_path / images)
    code, out, err = call("depth", tmp_path / given, tmp_path / "out", *options, "-q")
    assert code == 2
    assert told in err
    assert "Traceback" not in out + err
    assert not (tmp_path / "out" / "scene").exists()


def test_a_wrong_model_is_told_before_photographs_are_undistorted(call: Call, tmp_path: Path) -> None:
    write_all(made.truth(BROWN), tmp_path)
    options = ("--images", tmp_path / "my photos", "--model", "no-such-model")
    assert call("depth", tmp_path / "cameras.xml", tmp_path / "out", *options, "-q")[0] == 2
    assert not (tmp_path / "out" / "scene").exists()


def test_the_help_of_fuse_says_which_scenes_are_turned(call: Call) -> None:
    code, out, _ = call("fuse", "--help")
    assert code == 0
    for program in ("fsinfer poses", "COLMAP", "OpenMVS", "nerfstudio", "Record3D", "Metashape"):
        assert program in " ".join(re.sub(r"[^\w\s(),.;-]", " ", out.partition("--no-level")[2]).split())
