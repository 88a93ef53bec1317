"""What the stages from depth to cloud hang on: a change of it does them anew."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fsinfer.depth.settings import DepthSettings
from fsinfer.depth.stage import DepthResult
from fsinfer.io.cloud import PointCloud, write_cloud
from fsinfer.notices.capture import CaptureCode
from fsinfer.placement.settings import LevelSettings
from fsinfer.scene import Scene, read_scene
from fsinfer.workflow import cloud_stages
from fsinfer.workflow.ledger import Ledger, StageRecord
from tests.support.plane_scene import write_plane_scene


def moved(scene: Scene) -> Scene:
    """One camera a millimetre beside."""
    pose = scene.views[1].camera.cam_from_world.copy()
    pose[0, 3] += 1e-3
    view = replace(scene.views[1], camera=replace(scene.views[1].camera, cam_from_world=pose))
    return replace(scene, views=(scene.views[0], view, *scene.views[2:]))


def test_depth_maps_of_other_poses_or_settings_are_computed_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    resumed: list[bool] = []

    def estimate_depth(_scene: Scene, out: Path, *, resume: bool, **_: object) -> DepthResult:
        resumed.append(resume)
        for name in ("depth", "confidence"):
            (out / name).mkdir(exist_ok=True)
        return DepthResult(depth_folder=out, views=3, model="field", model_sha256="abc", precision="float32")

    monkeypatch.setattr(cloud_stages, "estimate_depth", estimate_depth)
    monkeypatch.setattr(cloud_stages, "model_digest", lambda settings: settings.model)
    scene = read_scene(write_plane_scene(tmp_path / "scene"))
    settings = DepthSettings()
    ledger = Ledger(tmp_path / "out")
    ledger.out.mkdir()
    asked = [
        (scene, settings),
        (scene, settings),
        (moved(scene), settings),
        (moved(scene), replace(settings, source_views=settings.source_views + 1)),
        (moved(scene), replace(settings, model="another")),
    ]
    ran = [cloud_stages.compute_depth(ledger, given, settings=chosen).ran for given, chosen in asked]
    assert ran == [True, False, True, True, True]
    assert resumed == [False] * 4  # what another scene left is not gone on with


def test_that_no_ground_was_found_stays_known_of_the_cloud(tmp_path: Path) -> None:
    scene = read_scene(write_plane_scene(tmp_path / "scene"))
    camera = scene.views[0].camera
    right, down, ahead = camera.cam_from_world[:3, :3]
    rng = np.random.default_rng(0)
    told = []
    for name, below in (("ground", 1.5), ("crowns only", -5.0)):
        ledger = Ledger(tmp_path / name)
        ledger.out.mkdir()
        flat = rng.uniform(-4, 4, (5000, 2)) @ np.array([right, ahead])
        path = ledger.out / "fused.ply"
        write_cloud(path, PointCloud(xyz=camera.center + below * down + flat))
        cloud = cloud_stages.FusedCloud(path=path, points=5000)
        fused = StageRecord(name="fuse", run_id="1", seconds=0.0, peak_rss_mb=None, made_by="", result=cloud, ran=True)
        for _ in range(2):  # the second is recalled, not done again
            placed = cloud_stages.place_plot(ledger, scene, fused, m_per_unit=None, settings=LevelSettings())
            told.append((placed.ran, [warning.code for warning in placed.result.warnings]))
    lost = [CaptureCode.no_ground_plane]
    assert told == [(True, []), (False, []), (True, lost), (False, lost)]
