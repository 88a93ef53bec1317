"""Features found in enlarged copies of photos are those that COLMAP finds in doubled ones, in the photos' pixels."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.io.images import write_image
from fsinfer.poses.colmap import extract_features
from fsinfer.poses.descriptors import matched, prepared
from fsinfer.poses.enlarged import find_in_enlarged
from fsinfer.poses.settings import PoseSettings
from fsinfer.progress import silent
from tests.support.rendered_room import photographs

pycolmap = pytest.importorskip("pycolmap")

NAMES = ["0.png", "1.png"]


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("room")
    for name, image in zip(NAMES, photographs(), strict=False):
        write_image(folder / name, image)
    return folder


def features(database: Path, name: str) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    with pycolmap.Database.open(database) as opened:
        number = opened.read_image_with_name(name).image_id
        return np.asarray(opened.read_keypoints(number)), np.asarray(opened.read_descriptors(number).data)


def found(room: Path, database: Path, enlargement: float, *, enlarged: bool = True) -> Path:
    settings = PoseSettings(
        enlarge_below_px=10_000 if enlarged else 10,
        enlargement=enlargement,
        max_enlarged_features=100_000,
        max_features=100_000,
        threads=2,
    )
    extract_features(database, room, {"camera": NAMES}, settings, silent)
    return database


@pytest.mark.parametrize("name", NAMES)
def test_they_lie_where_colmap_finds_them_in_doubled_photos(room: Path, tmp_path: Path, name: str) -> None:
    theirs, their_descriptors = features(found(room, tmp_path / "doubled.db", 2.0), name)
    ours, our_descriptors = features(found(room, tmp_path / "enlarged.db", 1.45), name)
    pairs = matched(prepared(our_descriptors), prepared(their_descriptors), max_ratio=0.8, max_angle=0.7)
    assert len(pairs) > 0.6 * len(ours)
    shift = ours[pairs[:, 0], :2] - theirs[pairs[:, 1], :2]
    # The largest, of 25 pixels, lie less exactly in either.
    assert (np.linalg.norm(shift, axis=1) < 1).mean() > 0.9
    assert np.abs(np.median(shift, axis=0)).max() < 0.03
    sizes = np.linalg.norm(ours[pairs[:, 0], 2:4], axis=1) / np.linalg.norm(theirs[pairs[:, 1], 2:4], axis=1)
    assert np.median(sizes) == pytest.approx(1, abs=0.05)


def test_there_are_more_than_in_the_photo_and_fewer_than_in_the_doubled_one(room: Path, tmp_path: Path) -> None:
    plain = features(found(room, tmp_path / "plain.db", 1.45, enlarged=False), "0.png")[0]
    enlarged = features(found(room, tmp_path / "enlarged.db", 1.45), "0.png")[0]
    doubled = features(found(room, tmp_path / "doubled.db", 2.0), "0.png")[0]
    assert 1.3 * len(plain) < len(enlarged) < len(doubled) / 1.3


def test_large_photos_are_reduced_before_they_count_as_small(room: Path, tmp_path: Path) -> None:
    counts = {}
    for name, below in (("reduced", 10), ("enlarged again", 10_000)):
        settings = PoseSettings(max_image_size=240, enlarge_below_px=below, threads=1)
        extract_features(tmp_path / f"{name}.db", room, {"camera": NAMES}, settings, silent)
        counts[name] = len(features(tmp_path / f"{name}.db", "0.png")[0])
    assert counts["enlarged again"] > 1.3 * counts["reduced"]


def test_the_camera_is_that_of_the_photo(room: Path, tmp_path: Path) -> None:
    with pycolmap.Database.open(found(room, tmp_path / "enlarged.db", 1.45)) as opened:
        cameras = opened.read_all_cameras()
    height, width = photographs()[0].shape[:2]
    assert [(camera.width, camera.height) for camera in cameras] == [(width, height)]


def test_what_a_stopped_run_left_is_completed(room: Path, tmp_path: Path) -> None:
    database = found(room, tmp_path / "enlarged.db", 1.45)
    keypoints, descriptors = features(database, "1.png")
    with closing(sqlite3.connect(database)) as opened:
        opened.execute("DELETE FROM descriptors WHERE image_id = (SELECT image_id FROM images WHERE name = '1.png')")
        opened.commit()
    found(room, database, 1.45)
    again, described = features(database, "1.png")
    np.testing.assert_array_equal(again, keypoints)
    np.testing.assert_array_equal(described, descriptors)
    assert [path.name for path in tmp_path.iterdir() if path.is_dir()] == []


def test_they_do_not_depend_on_threads(room: Path, tmp_path: Path) -> None:
    options = pycolmap.FeatureExtractionOptions()
    options.use_gpu, options.sift.first_octave = False, 0
    kept = []
    for threads in (1, 2):
        options.num_threads = threads
        database = tmp_path / f"{threads}.db"
        with pycolmap.Database.open(database):
            pass
        pycolmap.import_images(database, room, camera_mode=pycolmap.CameraMode.SINGLE, image_names=NAMES)
        find_in_enlarged(database, room, NAMES, 1.45, options, threads)
        kept.append([features(database, name) for name in NAMES])
    for one, other in zip(*kept, strict=True):
        np.testing.assert_array_equal(one[0], other[0])
        np.testing.assert_array_equal(one[1], other[1])


def test_a_photo_of_nothing_has_no_features(tmp_path: Path) -> None:
    write_image(tmp_path / "photos" / "0.png", np.full_like(photographs()[0], 130))
    write_image(tmp_path / "photos" / "1.png", photographs()[0])
    database = found(tmp_path / "photos", tmp_path / "enlarged.db", 1.45)
    assert len(features(database, "0.png")[0]) == 0 < len(features(database, "1.png")[0])
