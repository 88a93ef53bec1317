"""Photos are entered into COLMAP's database as COLMAP itself does, without being decoded."""

from __future__ import annotations

import sqlite3
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fsinfer.io.images import write_image
from fsinfer.poses.colmap import extract_features
from fsinfer.poses.settings import PoseSettings
from fsinfer.progress import silent

pycolmap = pytest.importorskip("pycolmap")

TABLES = ("cameras", "rigs", "rig_sensors", "frames", "frame_data", "images")


def photos(folder: Path, names: Sequence[str], size: tuple[int, int]) -> list[str]:
    rng = np.random.default_rng(len(names))
    for name in names:
        write_image(folder / name, rng.integers(0, 255, (*size, 3), dtype=np.uint8).repeat(4, axis=0).repeat(4, axis=1))
    return list(names)


def rows(database: Path) -> dict[str, list[Any]]:
    with closing(sqlite3.connect(database)) as opened:
        return {table: opened.execute(f"SELECT * FROM {table}").fetchall() for table in TABLES}


def test_as_colmap_enters_them(tmp_path: Path) -> None:
    images = tmp_path / "images"
    cameras = {
        "phone": photos(images, [f"{number:05d}.jpg" for number in (0, 3, 7)], (40, 60)),
        "other": photos(images, ["10.jpg", "11.jpg"], (60, 40)),
    }
    settings = PoseSettings(threads=1, max_features=200, enlarge_below_px=1)
    extract_features(tmp_path / "ours.db", images, cameras, settings, silent)
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = "SIMPLE_RADIAL"
    reader.default_focal_length_factor = settings.default_focal_factor
    pycolmap.Database.open(str(tmp_path / "colmap.db")).close()
    for names in cameras.values():
        pycolmap.import_images(
            tmp_path / "colmap.db", images, camera_mode=pycolmap.CameraMode.SINGLE, image_names=names, options=reader
        )
    assert rows(tmp_path / "ours.db") == rows(tmp_path / "colmap.db")
    assert [row[1] for row in rows(tmp_path / "ours.db")["images"]] == [*cameras["phone"], *cameras["other"]]


def test_photos_that_have_features_are_not_looked_at_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    images, database = tmp_path / "images", tmp_path / "database.db"
    names = photos(images, ["0.jpg", "1.jpg", "2.jpg"], (40, 60))
    settings = PoseSettings(threads=1, max_features=200, enlarge_below_px=1)
    extract_features(database, images, {"phone": names}, settings, silent)
    with closing(sqlite3.connect(database)) as opened, opened:
        opened.execute("DELETE FROM descriptors WHERE image_id = 2")
    looked: list[str] = []
    extract = pycolmap.extract_features

    def noted(*given: Any, image_names: list[str], **options: Any) -> None:
        looked.extend(image_names)
        extract(*given, image_names=image_names, **options)

    monkeypatch.setattr(pycolmap, "extract_features", noted)
    monkeypatch.setattr(pycolmap, "import_images", None)  # cannot be called
    extract_features(database, images, {"phone": names}, settings, silent)
    assert looked == ["1.jpg"]


def test_who_was_stopped_in_between_enters_the_rest_in_order(tmp_path: Path) -> None:
    images = tmp_path / "images"
    names = photos(images, [f"{number}.jpg" for number in range(4)], (40, 60))
    settings = PoseSettings(threads=1, max_features=200, enlarge_below_px=1)
    extract_features(tmp_path / "whole.db", images, {"phone": names}, settings, silent)
    extract_features(tmp_path / "half.db", images, {"phone": names[:2]}, settings, silent)
    extract_features(tmp_path / "half.db", images, {"phone": names}, settings, silent)
    assert rows(tmp_path / "half.db") == rows(tmp_path / "whole.db")


def test_photos_that_colmap_cannot_read_cost_the_others_no_camera(tmp_path: Path) -> None:
    images = tmp_path / "images"
    names = photos(images, [f"{number:02d}.jpg" for number in range(20)], (40, 60))
    (images / names[0]).write_bytes(b"no photograph")
    settings = PoseSettings(threads=1, max_features=50, enlarge_below_px=1)
    extract_features(tmp_path / "some.db", images, {"phone": names}, settings, silent)
    found = rows(tmp_path / "some.db")
    assert len(found["cameras"]) == 1
    assert {row[2] for row in found["images"]} == {1}
    assert len(found["frames"]) == len(found["images"])
