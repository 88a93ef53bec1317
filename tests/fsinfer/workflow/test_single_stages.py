"""Which scale a cloud file of its own gets, and what that does to the unit in plot.json."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fsinfer.depth.settings import DepthSettings
from fsinfer.errors import ImageError, SceneError
from fsinfer.frames.settings import FrameSettings
from fsinfer.io.images import can_be_read, write_image
from fsinfer.io.pfm import read_pfm, write_pfm
from fsinfer.notices.capture import CaptureCode
from fsinfer.notices.notice import notice
from fsinfer.output.json_values import as_json
from fsinfer.output.plot_json import read_plot
from fsinfer.poses.estimate import PosesResult
from fsinfer.poses.settings import PoseSettings
from fsinfer.scale.find import FoundScale
from fsinfer.scale.request import ScaleRequest
from fsinfer.scale.scale import Scale
from fsinfer.scene import Scene, read_scene, write_camera
from fsinfer.workflow import cloud_origin, cloud_stages, measure_cloud, photo_stages
from fsinfer.workflow.ledger import Ledger
from fsinfer.workflow.single_stages import depth_of, frames_of, fuse_scene, poses_of
from fsinfer.workflow.summary import update_plot
from tests.support.plane_scene import write_plane_scene
from tests.support.synthetic_plot import write_depth_folder, write_scene_folder


@pytest.mark.parametrize(("cloud_per_scene", "factor"), [(1.0, 0.5), (0.5, 1.0), (0.25, 2.0)])
def test_markers_scale_the_scene_and_the_cloud_follows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cloud_per_scene: float, factor: float
) -> None:
    write_scene_folder(tmp_path / "scene")
    found = Scale(m_per_unit=0.5, source="aruco", rel_std=0.01)
    monkeypatch.setattr(cloud_origin, "find_scale", lambda *_, **__: FoundScale(scale=found))
    turn = np.array([[0.0, -1.0, 0.0, 3.0], [1.0, 0.0, 0.0, 2.0], [0.0, 0.0, 1.0, 1.0], [0.0, 0.0, 0.0, 1.0]])
    similarity = np.diag([cloud_per_scene] * 3 + [1.0]) @ turn
    origin = cloud_origin.CloudOrigin(cloud_from_scene=similarity, units="model units")
    given = cloud_origin.cloud_scale(ScaleRequest(aruco_length_m=0.25), tmp_path / "cloud.ply", tmp_path, origin)
    assert given.scale.m_per_unit == pytest.approx(factor)
    assert (given.scale.source, given.scale.rel_std, given.warnings) == ("aruco", 0.01, ())


def test_plot_json_of_single_commands_keeps_what_others_wrote(tmp_path: Path) -> None:
    update_plot(tmp_path, source="scene", stage="fuse", seconds=2.0, values={"points": 7, "units": "m"})
    update_plot(tmp_path, source="cloud.ply", stage="trees", seconds=1.0, values={"trees": 3})
    plot = read_plot(tmp_path)
    assert (plot["source"], plot["points"], plot["trees"]) == ("scene", 7, 3)
    assert plot["seconds"] == {"fuse": 2.0, "trees": 1.0, "total": 3.0}
    # Every key of the contract is there, empty where nothing is known.
    for key in ("photos", "registered", "scale_m_per_unit", "density_per_m2", "peak_rss_mb", "model_sha256"):
        assert plot[key] is None
    assert plot["warnings"] == []


@pytest.mark.parametrize("part", ["depth", "confidence"])
def test_maps_that_were_edited_are_fused_again(tmp_path: Path, part: str) -> None:
    """A person or a fence is masked in the maps: their sizes and their first and last rows stay what they were."""
    scene = read_scene(write_plane_scene(tmp_path / "scene", height=240, width=320))
    for view in scene.views:
        write_pfm(tmp_path / "depth" / f"{view.name}.pfm", np.full((240, 320), 3.0, np.float32))
        write_pfm(tmp_path / "confidence" / f"{view.name}.pfm", np.full((240, 320), 0.9, np.float32))
    (tmp_path / "depth" / "depth.json").write_text(json.dumps({"pixel_step": 1.0}))
    first = fuse_scene(scene.folder, tmp_path)
    assert not fuse_scene(scene.folder, tmp_path).ran
    for view in scene.views:
        path = tmp_path / part / f"{view.name}.pfm"
        values = read_pfm(path)
        values[90:140] = 0
        write_pfm(path, values)
    again = fuse_scene(scene.folder, tmp_path)
    assert again.ran
    assert again.result.points < 0.85 * first.result.points


def test_maps_of_cameras_of_before_are_not_fused(tmp_path: Path) -> None:
    """Photographs that are placed once more have another unit, in which the depths of before are others."""
    scene = read_scene(write_plane_scene(tmp_path / "scene"))
    depth_of(scene.folder, tmp_path / "out", settings=DepthSettings())
    fused = fuse_scene(scene.folder, tmp_path / "out")
    for view in scene.views:
        pose = view.camera.cam_from_world.copy()
        pose[:3, 3] *= 1.03
        write_camera(scene.folder / "cams" / f"{view.name}_cam.txt", replace(view.camera, cam_from_world=pose))
    with pytest.raises(SceneError, match=r"changed since; run again: fsinfer depth"):
        fuse_scene(scene.folder, tmp_path / "out")
    depth_of(scene.folder, tmp_path / "out", settings=DepthSettings())
    again = fuse_scene(scene.folder, tmp_path / "out")
    assert again.ran
    assert again.run_id != fused.run_id


def _stop_depth(scene_folder: Path, out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C after the first map of depth with other settings than the defaults."""

    def write_one(scene: Scene, folder: Path, **_: object) -> None:
        write_depth_folder(scene, folder)
        for part in ("depth", "confidence"):
            (folder / part / f"{scene.views[-1].name}.pfm").unlink()
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(cloud_stages, "estimate_depth", write_one)
        with pytest.raises(KeyboardInterrupt):
            depth_of(scene_folder, out, settings=DepthSettings(source_views=2))


def _place_once_more(scene: Scene, factor: float) -> None:
    for view in scene.views:
        pose = view.camera.cam_from_world.copy()
        pose[:3, 3] *= factor
        write_camera(scene.folder / "cams" / f"{view.name}_cam.txt", replace(view.camera, cam_from_world=pose))


def test_maps_of_a_stage_that_was_stopped_are_those_of_the_cameras_of_then(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Depth is stopped; fewer maps are told, and those of cameras of before are fused no more than finished ones."""
    write_scene_folder(tmp_path / "scene")
    scene = read_scene(tmp_path / "scene")
    _stop_depth(scene.folder, tmp_path, monkeypatch)
    fuse_scene(scene.folder, tmp_path)
    assert "stopped before all its maps were made" in caplog.text
    _place_once_more(scene, 1.1)
    with pytest.raises(SceneError, match=r"changed since; run again: fsinfer depth"):
        fuse_scene(scene.folder, tmp_path)


def test_stems_are_not_looked_up_by_maps_of_other_cameras(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A run with one photo more is stopped in depth, and the check puts the places of before back beside the cloud."""
    write_scene_folder(tmp_path / "scene")
    scene = read_scene(tmp_path / "scene")
    write_depth_folder(scene, tmp_path)
    fuse_scene(scene.folder, tmp_path, level=True)
    cloud, origin = tmp_path / "cloud.ply", cloud_origin.origin_of_cloud(tmp_path)
    for part in ("depth", "confidence"):
        shutil.rmtree(tmp_path / part)
    _place_once_more(scene, 1.1)
    _stop_depth(scene.folder, tmp_path, monkeypatch)
    _place_once_more(scene, 1.0)
    with pytest.raises(SceneError, match=r"changed since; run again: fsinfer depth"):
        cloud_origin.own_photos(cloud, origin, 1.0)
    _stop_depth(scene.folder, tmp_path, monkeypatch)
    assert cloud_origin.own_photos(cloud, origin, 1.0) is not None


def test_photos_that_were_placed_once_more_are_not_those_of_the_cloud(tmp_path: Path) -> None:
    """A run that is stopped after its poses leaves the cloud of before beside cameras in another frame and unit."""
    write_scene_folder(tmp_path / "scene")
    scene = read_scene(tmp_path / "scene")
    write_depth_folder(scene, tmp_path)
    fuse_scene(scene.folder, tmp_path, level=True)
    origin = cloud_origin.origin_of_cloud(tmp_path)
    cloud, markers = tmp_path / "cloud.ply", ScaleRequest(aruco_length_m=0.25)
    assert cloud_origin.own_photos(cloud, origin, 1.0) is not None
    for view in scene.views:
        pose = view.camera.cam_from_world.copy()
        pose[:3, 3] *= 1.1
        write_camera(scene.folder / "cams" / f"{view.name}_cam.txt", replace(view.camera, cam_from_world=pose))
    with pytest.raises(SceneError, match="were placed once more"):
        cloud_origin.own_photos(cloud, origin, 1.0)
    with pytest.raises(SceneError, match="were placed once more"):
        cloud_origin.cloud_scale(markers, cloud, tmp_path, origin)


@pytest.mark.parametrize("part", ["depth", "confidence"])
def test_maps_that_were_edited_are_measured_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, part: str) -> None:
    write_scene_folder(tmp_path / "scene")
    scene = read_scene(tmp_path / "scene")
    write_depth_folder(scene, tmp_path)
    fuse_scene(scene.folder, tmp_path)

    class AskedError(Exception):
        pass

    def asked(_self: Ledger, _stage: object, _work: object, *, inputs: Mapping[str, Any]) -> None:
        raise AskedError(json.dumps(as_json(inputs)))

    monkeypatch.setattr(Ledger, "run", asked)

    def inputs() -> str:
        with pytest.raises(AskedError) as told:
            measure_cloud.measure_cloud_file(tmp_path / "cloud.ply", tmp_path, request=ScaleRequest())
        return str(told.value)

    before = inputs()
    assert inputs() == before
    path = tmp_path / part / f"{scene.views[1].name}.pfm"
    values = read_pfm(path)
    values[len(values) // 2] = 0
    write_pfm(path, values)
    assert inputs() != before


def test_nothing_is_written_among_the_photos(tmp_path: Path) -> None:
    write_image(tmp_path / "a.jpg", np.zeros((8, 8, 3), np.uint8))
    with pytest.raises(ImageError, match="the chosen frames would be written among the photos"):
        frames_of(tmp_path, tmp_path / "." / "", settings=FrameSettings())
    with pytest.raises(ImageError, match="the scene would be written among the photos"):
        poses_of(tmp_path, tmp_path, settings=PoseSettings())
    assert [path.name for path in tmp_path.iterdir()] == ["a.jpg"]


def damaged(path: Path) -> bytes:
    """Make a PNG one that ends in its middle with an error; returns what it was. Its length and its ends stay."""
    whole = path.read_bytes()
    middle = len(whole) // 2
    path.write_bytes(whole[: middle - 3000] + bytes(6000) + whole[middle + 3000 :])
    return whole


def test_a_photo_that_was_copied_once_more_is_taken_into_the_frames(tmp_path: Path) -> None:
    """As its message asks for: a hole in the middle of the first copy does not show in the digest."""
    folder, out = tmp_path / "photos", tmp_path / "out"
    rng = np.random.default_rng(0)
    for name in ("a.png", "b.png", "c.png", "c.jpg"):
        write_image(folder / name, rng.integers(0, 255, (500, 700, 3), np.uint8))
    whole = damaged(folder / "b.png")
    settings = FrameSettings()
    rows = frames_of(folder, out, settings=settings).result.rows
    assert [row.source for row in rows if not row.kept] == ["b.png", "c.png"]
    assert not frames_of(folder, out, settings=settings).ran
    (folder / "b.png").write_bytes(whole)
    again = frames_of(folder, out, settings=settings)
    assert again.ran
    assert [row.source for row in again.result.rows if not row.kept] == ["c.png"]  # of the same name as another
    assert not frames_of(folder, out, settings=settings).ran


def test_a_photo_that_was_copied_once_more_is_placed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, out = tmp_path / "photos", tmp_path / "out"
    rng = np.random.default_rng(0)
    for name in ("a.png", "b.png", "c.jpg", "c.png"):
        write_image(folder / name, rng.integers(0, 255, (500, 700, 3), np.uint8))
    # Of c one file can be read, and of b none.
    wholes = {name: damaged(folder / name) for name in ("b.png", "c.png")}

    def place(images: Path, scene: Path, **_: object) -> PosesResult:
        unread = [path for path in sorted(images.iterdir()) if not can_be_read(path)]
        told = tuple(notice(CaptureCode.photo_unreadable, error=path.name) for path in unread)
        left_out = ("b",) if folder / "b.png" in unread else ()
        return PosesResult(scene=scene, photos=4, registered=3, left_out=left_out, warnings=told)

    monkeypatch.setattr(photo_stages, "estimate_poses_apart", place)
    assert poses_of(folder, out, settings=PoseSettings()).ran
    assert not poses_of(folder, out, settings=PoseSettings()).ran
    for name, whole in wholes.items():
        (folder / name).write_bytes(whole)
        assert poses_of(folder, out, settings=PoseSettings()).ran
        assert not poses_of(folder, out, settings=PoseSettings()).ran
