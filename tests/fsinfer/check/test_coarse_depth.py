"""The quick look at the depth, where there is nothing to look at."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from fsinfer.check.coarse_depth import read_glance, take_glance
from fsinfer.scene import read_scene
from tests.support.plane_scene import write_plane_scene


def test_photos_without_neighbours_give_no_quick_look_now_or_later(tmp_path: Path) -> None:
    scene = read_scene(write_plane_scene(tmp_path / "scene", height=48, width=64))
    alone = replace(scene, views=tuple(replace(view, sources=()) for view in scene.views))
    assert take_glance(alone, tmp_path / "work") is None
    # A check that is given again reads what the first one left, which is nothing.
    assert read_glance(alone, tmp_path / "work") is None
