"""A project is told from another one of the same name, and known wherever it lies."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from fsinfer.errors import SceneError
from fsinfer.importers.formats import camera_files, reader_of
from fsinfer.workflow.scene_source import imported_scene, our_scene
from tests.fsinfer.importers.test_formats import FORMATS
from tests.support import foreign_scenes as made

KINDS = ["colmap-OPENCV-text", "colmap-OPENCV-binary", "openmvs-7", "metashape-chunk", "transforms", "polycam",
         "scanner", "record3d", "rtabmap"]  # fmt: skip


def project(folder: Path, kind: str, *, moved: bool = False) -> Path:
    """A folder with a scene of this kind, whose cameras stand elsewhere where they are ``moved``."""
    write, lens = FORMATS[kind]
    scene = made.truth(lens)
    if moved:
        shifted = []
        for photo in scene.photos:
            pose = photo.cam_from_world.copy()
            pose[:3, 3] += 0.125
            shifted.append(replace(photo, cam_from_world=pose))
        scene = replace(scene, photos=tuple(shifted))
    folder.mkdir(parents=True)
    given = write(scene, folder)
    return given if given.is_dir() and given != folder else folder


@pytest.mark.parametrize("kind", KINDS)
def test_the_camera_files_are_among_those_that_are_read(tmp_path: Path, kind: str) -> None:
    given = project(tmp_path / "plot", kind)
    reader = reader_of(given)
    assert reader is not None
    assert camera_files(given)
    assert {*camera_files(given)} <= {*reader().files}


@pytest.mark.parametrize("kind", KINDS)
def test_another_project_of_the_same_name_is_told(tmp_path: Path, kind: str) -> None:
    own, other = project(tmp_path / "A" / "plot", kind), project(tmp_path / "B" / "plot", kind, moved=True)
    assert own.name == other.name
    our_scene(own, tmp_path / "out")
    assert imported_scene(own, tmp_path / "out") == tmp_path / "out" / "scene"
    with pytest.raises(SceneError, match="is not the scene that was imported into"):
        imported_scene(other, tmp_path / "out")
    # The same one, elsewhere.
    (tmp_path / "C").mkdir()
    copied = Path(shutil.move(own, tmp_path / "C" / own.name))
    assert imported_scene(copied, tmp_path / "out") == tmp_path / "out" / "scene"


def test_folders_that_noted_no_files_are_known_by_the_name(tmp_path: Path) -> None:
    own = project(tmp_path / "A" / "plot", "transforms")
    our_scene(own, tmp_path / "out")
    note = next(path for path in (tmp_path / "out" / ".fsinfer").rglob("import.json"))
    values = json.loads(note.read_text(encoding="utf-8"))
    del values["inputs"]["files"]
    note.write_text(json.dumps(values), encoding="utf-8")
    other = project(tmp_path / "B" / "plot", "transforms", moved=True)
    assert imported_scene(other, tmp_path / "out") == tmp_path / "out" / "scene"
