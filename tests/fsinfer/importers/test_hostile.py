"""Files that are cut, lie, or were made to hurt: one message, no traceback, no memory to speak of."""

from __future__ import annotations

import json
import struct
import tracemalloc
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fsinfer.errors import FsinferError, SceneError
from fsinfer.importers.files import view_names
from fsinfer.importers.formats import reader_of
from tests.support import foreign_scenes as made
from tests.support.foreign_scenes import BROWN, PINHOLE

#: More than any reader needs for files of a few kilobytes.
_MOST_BYTES = 30_000_000


def read(path: Path) -> object:
    """Read whatever is there; every error must be one that a user can understand."""
    reader = reader_of(path)
    return None if reader is None else reader()


def message(path: Path) -> str:
    tracemalloc.start()
    try:
        with pytest.raises(SceneError) as raised:
            read(path)
        assert tracemalloc.get_traced_memory()[1] < _MOST_BYTES
    finally:
        tracemalloc.stop()
    return str(raised.value)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All formats beside each other, each in a folder of its own, with photographs."""
    base = tmp_path_factory.mktemp("formats")
    scene = made.truth(BROWN, views=3)
    few = made.Truth(lens=BROWN, photos=scene.photos, points=scene.points[:40])
    made.write_colmap(few, base / "binary", kind="OPENCV", binary=True)
    made.write_colmap(few, base / "text", kind="OPENCV")
    made.write_openmvs(few, base / "openmvs" / "scene.mvs")
    made.write_metashape(few, base / "metashape" / "cameras.xml")
    made.write_transforms(few, base / "transforms" / "transforms.json")
    for name in ("binary", "text", "openmvs", "metashape", "transforms"):
        made.write_photos(few, base / name / "images")
    made.write_polycam(few, base / "polycam")
    made.write_scanner_app(few, base / "scanner")
    made.write_record3d(few, base / "record3d")
    made.write_rtabmap(few, base / "rtabmap")
    return base


FILES = (
    "binary/cameras.bin", "binary/images.bin", "binary/points3D.bin", "text/cameras.txt", "text/images.txt",
    "text/points3D.txt", "openmvs/scene.mvs", "metashape/cameras.xml", "transforms/transforms.json",
    "polycam/keyframes/cameras/IMG_0001.json", "scanner/frame_00001.json", "record3d/metadata.json",
    "rtabmap/map_camera_poses.txt", "rtabmap/map_calib/2.yaml",
)  # fmt: skip


@pytest.mark.parametrize("file", FILES)
def test_a_file_cut_anywhere_or_changed_is_read_or_told(folder: Path, file: str) -> None:
    path = folder / file
    whole = path.read_bytes()
    given_path = folder / file.split("/")[0]
    cuts = sorted({0, 1, 7, *range(0, len(whole), max(1, len(whole) // 25)), len(whole) - 1})
    try:
        for cut in cuts:
            path.write_bytes(whole[:cut])
            with suppress(FsinferError):
                read(given_path)
        _change(path, whole, given_path)
    finally:
        path.write_bytes(whole)
    assert read(given_path) is not None


def _change(path: Path, whole: bytes, given_path: Path) -> None:
    @settings(max_examples=60, suppress_health_check=list(HealthCheck), database=None, derandomize=True)
    @given(
        st.lists(st.tuples(st.integers(0, len(whole) - 1), st.binary(min_size=1, max_size=9)), min_size=1, max_size=4)
    )
    def changed(changes: list[tuple[int, bytes]]) -> None:
        data = bytearray(whole)
        for place, content in changes:
            data[place : place + len(content)] = content
        path.write_bytes(bytes(data))
        with suppress(FsinferError):
            read(given_path)

    changed()


@pytest.mark.parametrize("file", ["cameras.bin", "images.bin", "points3D.bin"])
def test_a_count_that_lies_costs_nothing(folder: Path, file: str) -> None:
    path = folder / "binary" / file
    whole = path.read_bytes()
    try:
        for count in (2**63, 2**40, len(whole)):
            path.write_bytes(struct.pack("<Q", count) + whole[8:])
            assert "promises" in message(folder / "binary")
    finally:
        path.write_bytes(whole)


def test_counts_of_openmvs_that_lie_cost_nothing(folder: Path) -> None:
    path = folder / "openmvs" / "scene.mvs"
    whole = path.read_bytes()
    places = [place for place in range(12, len(whole) - 8) if whole[place : place + 8] == struct.pack("<Q", 3)]
    assert len(places) > 2
    try:
        for place in places[:6]:
            path.write_bytes(whole[:place] + struct.pack("<Q", 2**61) + whole[place + 8 :])
            assert "scene.mvs" in message(path)
    finally:
        path.write_bytes(whole)


def test_a_newer_version_and_a_project_of_openmvs_are_told(tmp_path: Path) -> None:
    made.write_openmvs(made.truth(PINHOLE), tmp_path / "scene.mvs")
    whole = (tmp_path / "scene.mvs").read_bytes()
    (tmp_path / "scene.mvs").write_bytes(b"MVSI" + struct.pack("<I", 8) + whole[8:])
    assert "version 8" in message(tmp_path / "scene.mvs")
    (tmp_path / "scene.mvs").write_bytes(b"MVS\0" + whole[4:])
    assert "is a project of OpenMVS" in message(tmp_path / "scene.mvs")


def test_entities_that_grow_are_refused(tmp_path: Path) -> None:
    entities = "".join(f'<!ENTITY a{i} "{f"&a{i - 1};" * 10 if i else "aaaaaaaaaa"}">' for i in range(9))
    text = f'<?xml version="1.0"?><!DOCTYPE document [{entities}]><document><chunk>&a8;</chunk></document>'
    (tmp_path / "cameras.xml").write_text(text, encoding="utf-8")
    assert "document type" in message(tmp_path / "cameras.xml")


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"fl_x": None}, "no focal length"),
        ({"fl_x": "wide"}, "fl_x"),
        ({"fl_x": 1e400}, "fl_x"),
        ({"w": [1, 2]}, "w of"),
        ({"camera_model": "OPENCV_FISHEYE"}, "OPENCV_FISHEYE"),
        ({"is_fisheye": True}, "fisheye"),
        ({"frames": {}}, "list of frames"),
        ({"frames": []}, "0 photographs"),
        ({"frames": [{"file_path": "a.png"}]}, "transform_matrix"),
        ({"frames": [{"transform_matrix": [[1] * 4] * 4}]}, "no file_path"),
        ({"frames": [{"file_path": "a.png", "transform_matrix": [[0] * 4] * 4}]}, "no rotation"),
        ({"frames": [{"file_path": "a.png", "transform_matrix": np.diag([2, 2, 2, 1]).tolist()}]}, "no rotation"),
        ({"frames": [{"file_path": "a.png", "transform_matrix": np.diag([-1, 1, 1, 1]).tolist()}]}, "no rotation"),
    ],
)  # fmt: skip
def test_transforms_that_make_no_sense_are_told(tmp_path: Path, change: dict[str, object], told: str) -> None:
    made.write_transforms(made.truth(PINHOLE), tmp_path / "transforms.json")
    content = json.loads((tmp_path / "transforms.json").read_text(encoding="utf-8")) | change
    (tmp_path / "transforms.json").write_text(json.dumps(content), encoding="utf-8")
    made.write_photos(made.truth(PINHOLE), tmp_path / "images")
    assert told in message(tmp_path)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('type="frame" class="adjusted"', 'type="fisheye" class="adjusted"', "type fisheye"),
        ('label="unknown" type="frame"', 'label="unknown" type="spherical"', "type spherical"),
        ("<f>130.0</f>", "", "no focal length f"),
        ("<k1>", "<p3>0.1</p3><k1>", "p3 and p4"),
        ("<f>130.0</f>", "<f>wide</f>", "no numbers"),
        ("<scale locked=\"true\">2.5", "<scale locked=\"true\">-2.5", "scale of the chunk is -2.5"),
        ("</chunk>", "</piece>", "no XML"),
        ('sensor_id="4" component_id', 'sensor_id="5" component_id', "without a calibration"),
    ],
)  # fmt: skip
def test_cameras_of_metashape_that_make_no_sense_are_told(tmp_path: Path, old: str, new: str, told: str) -> None:
    made.write_metashape(made.truth(PINHOLE), tmp_path / "cameras.xml")
    text = (tmp_path / "cameras.xml").read_text(encoding="utf-8")
    assert old in text
    (tmp_path / "cameras.xml").write_text(text.replace(old, new), encoding="utf-8")
    made.write_photos(made.truth(PINHOLE), tmp_path)
    assert told in message(tmp_path / "cameras.xml")


def test_images_of_colmap_without_their_second_lines_are_told(tmp_path: Path) -> None:
    """Every second photograph would be taken for the observations of the one before, and be missed by nobody."""
    scene = made.truth(PINHOLE)
    made.write_colmap(scene, tmp_path / "sparse" / "0", kind="PINHOLE")
    made.write_photos(scene, tmp_path / "images")
    path = tmp_path / "sparse" / "0" / "images.txt"
    header, *lines = path.read_text(encoding="utf-8").splitlines()
    path.write_text("\n".join([header, *lines[::2]]) + "\n", encoding="utf-8")
    with pytest.raises(SceneError, match=r"behind IMG_0000\.png is not its observations; each image has two lines"):
        read(tmp_path)


def test_models_of_colmap_that_are_not_read_are_told_by_their_name(tmp_path: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    for name, model in pycolmap.CameraModelId.__members__.items():
        if model.value < 0 or name in made.COLMAP_MODELS:
            continue
        numbers = len(pycolmap.Camera.create_from_model_id(1, model, 100.0, 160, 120).params)
        camera = struct.pack(f"<QiiQQ{numbers}d", 1, 7, model.value, 160, 120, *[1.0] * numbers)
        made.write_colmap(made.truth(PINHOLE), tmp_path, kind="PINHOLE", binary=True)
        (tmp_path / "cameras.bin").write_bytes(camera)
        with pytest.raises(SceneError, match=f"model {name}, which is not read.*image_undistorter"):
            read(tmp_path)


def test_a_fisheye_of_colmap_is_told_with_the_way_out(tmp_path: Path) -> None:
    made.write_colmap(made.truth(PINHOLE), tmp_path, kind="PINHOLE")
    (tmp_path / "cameras.txt").write_text("7 OPENCV_FISHEYE 160 120 100 100 80 60 0 0 0 0\n", encoding="utf-8")
    assert "colmap image_undistorter" in message(tmp_path)


@pytest.mark.parametrize("model", ["equidistant", '"kannala_brandt4"'])
def test_a_fisheye_of_rtabmap_is_told_with_the_way_out(tmp_path: Path, model: str) -> None:
    made.write_rtabmap(made.truth(PINHOLE), tmp_path)
    file = tmp_path / "map_calib" / "2.yaml"
    text = file.read_text(encoding="utf-8")
    file.write_text(text.replace("plumb_bob", model), encoding="utf-8")
    told = message(tmp_path)
    assert f"2.yaml: the camera has the distortion model {model.strip(chr(34))}" in told
    assert "undistort the photographs" in told


@pytest.mark.parametrize(
    "line", ["distortion_model: rational_polynomial\n", 'distortion_model: "plumb_bob"\r\n', "distortion_model:\n", ""]
)
def test_models_of_rtabmap_that_are_no_fisheye_are_read(tmp_path: Path, line: str) -> None:
    made.write_rtabmap(made.truth(PINHOLE), tmp_path)
    for file in (tmp_path / "map_calib").iterdir():
        text = file.read_text(encoding="utf-8")
        file.write_text(text.replace("distortion_model: plumb_bob\n", line), encoding="utf-8", newline="")
    reader = reader_of(tmp_path)
    assert reader is not None
    assert len(reader().photos) == 4


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["a.jpg", "b.JPG"], ["a", "b"]),
        (["one/a.jpg", "two\\a.jpg"], ["one_a", "two_a"]),
        (["a.jpg", "A.jpg", "a.jpg"], ["a", "A_2", "a_3"]),
        (["../../etc/passwd", "/etc/passwd2"], ["passwd", "passwd2"]),
        (["C:\\x\\y.png"], ["y"]),
        (["", "..", "\0"], ["photo", "photo_2", "photo_3"]),
        (["Försterei 7.jpg", "林 1.png"], ["Försterei 7", "林 1"]),
        (['a<b>:"c|?*.jpg', "x\ny.jpg"], ["a_b___c___", "x_y"]),
        (["DSC.0001.jpg", "frame.12"], ["DSC.0001", "frame.12"]),
    ],
)
def test_names_of_views(names: list[str], expected: list[str]) -> None:
    assert view_names(names) == expected


@given(st.lists(st.text(max_size=300), max_size=8))
def test_names_of_views_are_file_names_all_apart(names: list[str]) -> None:
    found = view_names(names)
    assert len({name.lower() for name in found}) == len(names)
    for name in found:
        assert name.strip()
        assert not set(name) & set('/\\<>:"|?*\0\n')
        assert name not in (".", "..")
        assert len(name) < 140
