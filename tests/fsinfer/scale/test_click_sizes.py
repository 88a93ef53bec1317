"""Clicks in pictures that have another size by now."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsinfer.io.images import write_image
from fsinfer.scale.clicks.file import CLICKS_FILE, SavedClicks, clicked_length, read_clicks, write_clicks
from fsinfer.scale.clicks.server import ClickServer
from fsinfer.scale.clicks.sizes import fit_clicks, picture_sizes
from fsinfer.scale.find import find_scale
from fsinfer.scale.request import ScaleRequest, Size
from fsinfer.scene import Scene, read_scene, write_camera
from fsinfer.workflow.kept_clicks import kept_clicks
from tests.fsinfer.scale.test_click_server import true_clicks
from tests.support.synthetic_plot import M_PER_UNIT, SIZE, write_scene_folder


def scene_of(folder: Path, width: int, height: int) -> Scene:
    """The scene with pictures of another size, which show the same where the shape is the same."""
    write_scene_folder(folder)
    scene = read_scene(folder)
    x, y = width / SIZE[0], height / SIZE[1]
    # Pixel centres are whole numbers.
    larger = np.array([[x, 0, (x - 1) / 2], [0, y, (y - 1) / 2], [0, 0, 1]])
    for view in scene.views:
        write_image(view.image_path, np.full((height, width, 3), 128, np.uint8))
        camera = replace(view.camera, intrinsic=larger @ view.camera.intrinsic)
        write_camera(folder / "cams" / f"{view.name}_cam.txt", camera)
    return read_scene(folder)


def request_of(clicks: object, sizes: Mapping[str, Size]) -> ScaleRequest:
    return ScaleRequest(clicks=clicked_length(clicks, 1.0, sizes), printed_boards=False)


@pytest.mark.parametrize("size", [(320, 240), (80, 60), (107, 80)])
def test_clicks_give_the_same_scale_in_pictures_of_another_size(tmp_path: Path, size: Size) -> None:
    was = scene_of(tmp_path / "was", *SIZE)
    now = scene_of(tmp_path / "now", *size)
    request = request_of(true_clicks(was, 0, 2, 3), picture_sizes(was))
    found = find_scale(request, scene=now)
    assert found.warnings == ()
    # What is rounded to whole pixels is an eighth of a pixel in 120.
    assert found.scale.m_per_unit == pytest.approx(M_PER_UNIT, rel=1e-6 if size != (107, 80) else 2e-3)


def test_clicks_in_pictures_of_another_shape_do_not_fit(tmp_path: Path) -> None:
    was, now = scene_of(tmp_path / "was", *SIZE), scene_of(tmp_path / "now", 320, 180)
    found = find_scale(request_of(true_clicks(was, 0, 3), picture_sizes(was)), scene=now)
    assert found.scale.m_per_unit is None
    assert "view_00 had 160x120 pixels and has 320x180" in str(dict(found.warnings[0].items)["error"])


@given(
    u=st.floats(-0.5, 159.5), v=st.floats(-0.5, 119.5), share=st.sampled_from([(320, 240), (640, 480), (1600, 1200)])
)
def test_there_and_back_is_the_same_place(u: float, v: float, share: Size) -> None:
    clicked = clicked_length({"a": [[u, v], [v, u]]}, 1.0, {"a": SIZE})
    there = fit_clicks(clicked, {"a": share})
    assert there.views[0].size == share
    back = fit_clicks(there, {"a": SIZE}).views[0]
    np.testing.assert_allclose([back.first, back.second], [[u, v], [v, u]], atol=1e-9)
    # The corners of the picture stay its corners.
    corner = fit_clicks(clicked_length({"a": [[-0.5, -0.5], [159.5, 119.5]]}, 1.0, {"a": SIZE}), {"a": share}).views[0]
    assert (corner.first, corner.second) == ((-0.5, -0.5), (share[0] - 0.5, share[1] - 0.5))


def test_clicks_of_an_earlier_version_are_those_in_the_scene_that_lies_there(tmp_path: Path) -> None:
    was = scene_of(tmp_path / "scene", *SIZE)
    clicks = true_clicks(was, 0, 3)
    old = {"used": {"length_m": 1.0, "clicks": clicks}, "draft": {"view_05": [[1.0, 2.0], None]}}
    (tmp_path / CLICKS_FILE).write_text(json.dumps(old), encoding="utf-8")
    assert kept_clicks(tmp_path).used == clicked_length(clicks, 1.0, picture_sizes(was))
    now = scene_of(tmp_path / "scene", 320, 240)
    used = kept_clicks(tmp_path).used
    assert used is not None
    found = find_scale(ScaleRequest(clicks=used, printed_boards=False), scene=now)
    assert found.scale.m_per_unit == pytest.approx(M_PER_UNIT, rel=1e-6)
    assert read_clicks(tmp_path).sizes == {"view_05": SIZE}


def test_without_clicks_or_a_scene_nothing_is_written(tmp_path: Path) -> None:
    assert kept_clicks(tmp_path) == SavedClicks()
    assert list(tmp_path.iterdir()) == []
    write_clicks(tmp_path, SavedClicks(draft={"view_05": ((1.0, 2.0), None)}))
    before = (tmp_path / CLICKS_FILE).read_bytes()
    assert kept_clicks(tmp_path).sizes == {}
    assert (tmp_path / CLICKS_FILE).read_bytes() == before


def test_the_page_shows_a_draft_at_the_same_place(tmp_path: Path) -> None:
    now = scene_of(tmp_path, 320, 240)
    draft = {"view_05": ((1.0, 2.0), None), "view_06": ((0.0, 0.0), (1.0, 1.0)), "view_01": ((4.0, 5.0), None)}
    sizes = {"view_05": SIZE, "view_06": (160, 90)}
    kept: list[SavedClicks] = []
    with ClickServer(now, 1.0, SavedClicks(draft=draft, sizes=sizes), kept.append) as server:
        page = server.page()
        # Another shape is another picture; what has no size is taken as it stands.
        assert '"view_05": [[2.5, 4.5], null]' in page
        assert '"view_01": [[4.0, 5.0], null]' in page
        assert '"view_06": [' not in page
        server.draft({"view_02": [[7.0, 8.0], None]})
    write_clicks(tmp_path, kept[-1])
    assert read_clicks(tmp_path).sizes == {"view_02": (320, 240)}


def test_a_photograph_that_is_gone_keeps_nobody_from_the_clicks(tmp_path: Path) -> None:
    scene = scene_of(tmp_path, *SIZE)
    request = request_of(true_clicks(scene, 0, 3), picture_sizes(scene))
    scene.views[0].image_path.unlink()
    assert find_scale(request, scene=scene).scale.m_per_unit == pytest.approx(M_PER_UNIT, rel=1e-6)
