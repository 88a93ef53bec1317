"""What the stages from depth to cloud hang on: a change of it does them anew."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from fsinfer.depth.settings import DepthSettings
from fsinfer.depth.stage import DepthResult
from fsinfer.scene import Scene, read_scene
from fsinfer.workflow import cloud_stages
from fsinfer.workflow.ledger import Ledger
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
