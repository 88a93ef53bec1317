"""The scene folder, and the layout that BlendedMVS has instead."""

from __future__ import annotations

from pathlib import Path

import pytest

from fsinfer.errors import SceneError
from fsinfer.scene import read_scene, scene_digest
from tests.support.plane_scene import write_plane_scene


@pytest.fixture
def blended(tmp_path: Path) -> Path:
    scene = write_plane_scene(tmp_path / "scene")
    (scene / "images").rename(scene / "blended_images")
    (scene / "pair.txt").rename(scene / "cams" / "pair.txt")
    return scene


def test_a_scene_of_blendedmvs_is_read_as_one_of_mvsnet(tmp_path: Path, blended: Path) -> None:
    usual = read_scene(write_plane_scene(tmp_path / "usual"))
    found = read_scene(blended)
    assert scene_digest(found) == scene_digest(usual)
    assert [view.image_path for view in found.views] == [blended / "blended_images" / f"{i}.png" for i in range(3)]
    assert [view.sources for view in found.views] == [(1, 2), (0, 2), (0, 1)]


def test_what_is_missing_in_it_is_named_where_it_belongs(blended: Path) -> None:
    (blended / "blended_images" / "1.png").unlink()
    with pytest.raises(SceneError, match=r"blended_images has no image for 1_cam\.txt"):
        read_scene(blended)
    (blended / "cams" / "pair.txt").unlink()
    with pytest.raises(SceneError, match=r"scene.pair\.txt is not a pair list"):
        read_scene(blended)


def test_the_usual_names_go_before(blended: Path) -> None:
    write_plane_scene(blended, views=2)
    (blended / "cams" / "2_cam.txt").unlink()
    assert [view.image_path.parent.name for view in read_scene(blended).views] == ["images", "images"]
