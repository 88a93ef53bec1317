"""Files that lie, that are bombs, or that want out of the output folder: one error of fsinfer, and nothing happens.

``python -m tests.fuzz`` looks for more of them; what it found stands here.
"""

from __future__ import annotations

import json
import os
import shutil
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import laspy
import numpy as np
import pytest
from PIL import Image

from fsinfer.cli.app import app
from fsinfer.depth.manifest import models_folder, read_manifest
from fsinfer.depth.maps import DepthMaps
from fsinfer.depth.model import DepthModel
from fsinfer.depth.photo_confidence import QUANTITIES
from fsinfer.depth.session import Graph
from fsinfer.errors import (
    CloudError,
    FsinferError,
    ImageError,
    InputError,
    ModelError,
    OutputError,
    SceneError,
)
from fsinfer.evaluation.measured import read_measured
from fsinfer.io.chunks import open_chunks
from fsinfer.io.cloud import PointCloud, read_cloud, write_cloud
from fsinfer.io.exif import camera_exif, camera_key, gnss_degrees
from fsinfer.io.files import atomic_path, copy_file, write_text
from fsinfer.io.images import image_size, is_upright_jpeg_or_png, read_image
from fsinfer.io.json_text import parse_json
from fsinfer.io.las_writing import copy_las
from fsinfer.io.pfm import read_pfm
from fsinfer.notices.stems import StemCode
from fsinfer.output.json_values import of_json
from fsinfer.output.plot_json import read_plot
from fsinfer.plot_border.request import read_polygon
from fsinfer.scene import read_camera, read_scene
from fsinfer.trees.measure import analyse_plot
from fsinfer.workflow.ledger import Ledger, Stage
from tests.support.plane_scene import write_plane_scene
from tests.support.report_plot import plot_cloud


@pytest.fixture
def cloud() -> PointCloud:
    rng = np.random.default_rng(0)
    extra = {"TreeID": np.arange(50, dtype=np.int32)}
    return PointCloud(xyz=rng.uniform(0, 4, (50, 3)), rgb=np.full((50, 3), 9, np.uint8), extra=extra)


def overwrite(path: Path, offset: int, form: str, *values: float) -> None:
    content = bytearray(path.read_bytes())
    struct.pack_into(form, content, offset, *values)
    path.write_bytes(content)


# Place in the header (LAS 1.4), what is written there, and what the message says of it.
LIES = [
    (247, "<Q", 10**6, "50 of 1000000 points are there"),
    (100, "<I", 2**32 - 1, "more records than the file can hold"),
    (243, "<I", 2**31, "more records than the file can hold"),
    (96, "<I", 2**31, "more records than the file can hold"),
]


@pytest.mark.parametrize(("offset", "form", "value", "said"), LIES)
def test_a_las_header_that_promises_too_much(
    tmp_path: Path, cloud: PointCloud, offset: int, form: str, value: int, said: str
) -> None:
    path = tmp_path / "a.las"
    write_cloud(path, cloud)
    if offset == 243:
        overwrite(path, 235, "<Q", 375)
    overwrite(path, offset, form, value)
    for read in (read_cloud, open_chunks):
        with pytest.raises(CloudError, match=rf"a\.las .*{said}"):
            read(path)


def test_a_record_behind_the_points_that_is_longer_than_the_file(tmp_path: Path, cloud: PointCloud) -> None:
    path = tmp_path / "a.las"
    write_cloud(path, cloud)
    overwrite(path, 235, "<QI", path.stat().st_size, 1)
    sound = path.read_bytes() + bytes(20) + struct.pack("<Q", 4) + bytes(32) + b"text"
    path.write_bytes(sound)
    assert len(read_cloud(path)) == 50
    path.write_bytes(sound[:-44] + struct.pack("<Q", 2**40) + sound[-36:])
    with pytest.raises(CloudError, match="more records than the file can hold"):
        read_cloud(path)


def laz_record(path: Path) -> int:
    """Where the record that describes the compression begins."""
    return path.read_bytes().index(b"laszip encoded") + 52


def points_of(path: Path) -> int:
    return int(struct.unpack_from("<I", path.read_bytes(), 96)[0])


def lie_in_piece(path: Path) -> None:
    # After the place of the table, the first point and the count of the points: the length of the first layer.
    point_bytes = struct.unpack_from("<H", path.read_bytes(), 105)[0]
    overwrite(path, points_of(path) + 8 + point_bytes + 4, "<I", 2**31)


def lie_in_table(path: Path) -> None:
    (table,) = struct.unpack_from("<q", path.read_bytes(), points_of(path))
    overwrite(path, table + 4, "<I", 2**32 - 1)


@pytest.mark.parametrize(
    ("lie", "said"),
    [
        (lie_in_piece, "a piece of its compressed points promises more"),
        (lie_in_table, "compressed points promise more"),
        (lambda path: overwrite(path, laz_record(path) + 12, "<I", 2**31), "2147483648 points are compressed together"),
        (lambda path: overwrite(path, laz_record(path) + 12, "<I", 0), "0 points are compressed together"),
        (lambda path: overwrite(path, laz_record(path) + 36, "<H", 60000), "that of other points"),
        (lambda path: overwrite(path, points_of(path), "<q", 2**40), "table of its compressed points is missing"),
        (lambda path: overwrite(path, 247, "<Q", 10**12), "more points than the file can hold"),
    ],
)
def test_laz_whose_lengths_lie(tmp_path: Path, cloud: PointCloud, lie: Callable[[Path], None], said: str) -> None:
    # The decompressor asks for memory by each of them, and ends the process where it gets none.
    path = tmp_path / "a.laz"
    write_cloud(path, cloud)
    lie(path)
    with pytest.raises(CloudError, match=rf"a\.laz .*{said}"):
        read_cloud(path)


def test_a_vector_for_each_point_is_left_out(tmp_path: Path, cloud: PointCloud) -> None:
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.add_extra_dim(laspy.ExtraBytesParams(name="vector", type="3f8"))
    header.add_extra_dim(laspy.ExtraBytesParams(name="value", type="f8"))
    points = laspy.LasData(header)
    points.x, points.y, points.z = cloud.xyz.T
    points["vector"], points["value"] = np.ones((50, 3)), np.arange(50.0)
    points.write(tmp_path / "a.las")
    read = read_cloud(tmp_path / "a.las")
    assert list(read.extra) == ["value"]
    np.testing.assert_array_equal(read.extra["value"], np.arange(50.0))


def test_a_copy_of_a_cloud_that_cannot_be_copied(tmp_path: Path, cloud: PointCloud) -> None:
    path = tmp_path / "a.las"
    write_cloud(path, cloud)
    overwrite(path, 24, "<B", 0)  # LAS 0.4
    with pytest.raises(CloudError, match=r"a\.las"):
        copy_las(path, tmp_path / "b.las", "Number", lambda xyz: np.zeros(len(xyz), np.int32), chunk_points=100)
    assert not (tmp_path / "b.las").exists()


@pytest.mark.parametrize("size", ["-1 -1", "0 5", "-4 8", "100000 100000"])
def test_pfm_of_an_impossible_size(tmp_path: Path, size: str) -> None:
    path = tmp_path / "a.pfm"
    path.write_bytes(b"Pf\n" + size.encode() + b"\n-1.0\n" + bytes(400))
    with pytest.raises(SceneError, match=r"a\.pfm"):
        read_pfm(path)


CAMERA = "extrinsic\n{0} 0 0 0\n0 {1} 0 0\n0 0 1 0\n0 0 0 1\n\nintrinsic\n{2} 0 5\n0 {3} 5\n0 0 1\n\n1 0.1 192 {4}\n"


@pytest.mark.parametrize(
    "values",
    [(1, 1, "nan", 9, 5), (1, 1, 9, "inf", 5), (1, 1, 9, -9, 5), (1, 1, 9, 9, "inf"), (2, 2, 9, 9, 5), (-1, 1, 9, 9, 5),
     (0, 0, 9, 9, 5), (1, "1e400", 9, 9, 5), (1, 1, 1e-300, 9, 5), (1, 1, "9 0 0 5 0 9 0 0 0", 9, 5)],
)  # fmt: skip
def test_cameras_that_are_none(tmp_path: Path, values: tuple[object, ...]) -> None:
    path = tmp_path / "a_cam.txt"
    path.write_text(CAMERA.format(1, 1, 9, 9, 5), encoding="utf-8")
    assert read_camera(path).depth_max == 5
    path.write_text(CAMERA.format(*values), encoding="utf-8")
    with pytest.raises(SceneError, match=r"a_cam\.txt"):
        read_camera(path)


def test_a_message_stays_readable(tmp_path: Path) -> None:
    path = tmp_path / "a_cam.txt"
    path.write_text(CAMERA.format("a" * 100_000, 1, 9, 9, 5), encoding="utf-8")
    with pytest.raises(SceneError) as told:
        read_camera(path)
    assert len(str(told.value)) < 1600
    assert "a_cam.txt" in str(told.value)
    assert str(told.value).endswith("write the scene again")


DEEP = "[" * 100_000 + "]" * 100_000
BAD_JSON = [DEEP, "[" * 200 + "]" * 200, "9" * 400, '{"a": "\\ud800"}', "{", "\x00"]


@pytest.mark.parametrize("text", BAD_JSON, ids=range(len(BAD_JSON)))
def test_json_that_breaks_readers(tmp_path: Path, text: str) -> None:
    with pytest.raises(ValueError):
        parse_json(text)
    (tmp_path / "plot.json").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"plot\.json"):
        read_plot(tmp_path)


def test_json_that_is_sound() -> None:
    assert parse_json('{"a": [1, 2.5, null, "\\u00e4"], "b": 123456789012345678901234567890}') == {
        "a": [1, 2.5, None, "ä"],
        "b": 123456789012345678901234567890,
    }


@pytest.mark.parametrize(
    "step", ["Infinity", "NaN", "-1", "0", "1e9", "1" + "0" * 299 + "0" * 20, '"a"', "null", "[1]"]
)
def test_depth_json_with_an_impossible_step(tmp_path: Path, step: str) -> None:
    scene = read_scene(write_plane_scene(tmp_path / "scene"))
    shutil.copytree(tmp_path / "scene" / "depths", tmp_path / "depth")
    (tmp_path / "depth" / "depth.json").write_text('{"pixel_step": 1.0}', encoding="utf-8")
    assert DepthMaps(scene, tmp_path).available == (0, 1, 2)
    (tmp_path / "depth" / "depth.json").write_text(f'{{"pixel_step": {step}}}', encoding="utf-8")
    with pytest.raises(SceneError, match=r"depth\.json"):
        DepthMaps(scene, tmp_path)


def png(width: int, height: int) -> bytes:
    """A PNG that says it is so large, and holds nothing."""
    pieces = [(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)), (b"IDAT", zlib.compress(bytes(1000)))]
    chunks = [
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body)) for kind, body in pieces
    ]
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


@pytest.mark.parametrize("reader", [read_image, image_size, is_upright_jpeg_or_png, camera_key, camera_exif])
def test_a_picture_of_too_many_pixels(tmp_path: Path, reader: Callable[[Path], object]) -> None:
    path = tmp_path / "bomb.png"
    path.write_bytes(png(100_000, 100_000))
    with pytest.raises(ImageError, match=r"bomb\.png has too many pixels .* fewer than 150 megapixels"):
        reader(path)


def exif_with(tag: int, kind: int, count: int, value: int) -> bytes:
    """EXIF of one tag, of which type and count may make no sense."""
    return b"Exif\x00\x00II*\x00\x08\x00\x00\x00" + struct.pack("<HHHII", 1, tag, kind, count, value) + bytes(4)


@pytest.mark.parametrize(
    "exif",
    [exif_with(0x0112, 2, 4, 0x00616161), exif_with(0x8769, 4, 1, 2**31), exif_with(0x8769, 4, 1, 0),
     exif_with(0x8825, 2, 4, 0x00616161), exif_with(0x0110, 5, 2**30, 8), b"Exif\x00\x00II*\x00\xff\xff\xff\xff"],
)  # fmt: skip
def test_broken_metadata_costs_no_photo(tmp_path: Path, exif: bytes) -> None:
    path = tmp_path / "a.jpg"
    Image.fromarray(np.full((40, 60, 3), 90, np.uint8)).save(path, exif=exif)
    for reader in (image_size, is_upright_jpeg_or_png, camera_key, camera_exif, gnss_degrees):
        reader(path)
    assert image_size(path) == (60, 40)


@pytest.mark.parametrize("kind", [RuntimeError, KeyError, IndexError, struct.error, TypeError])
def test_whatever_a_decoder_raises_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: type[Exception]
) -> None:
    path = tmp_path / "a.png"
    Image.fromarray(np.zeros((40, 60, 3), np.uint8)).save(path)

    def broken(_: object) -> None:
        raise kind("broken")

    monkeypatch.setattr(Image.Image, "getexif", broken)
    assert image_size(path) == (60, 40)
    monkeypatch.setattr("PIL.PngImagePlugin.PngImageFile.load", broken)
    with pytest.raises(ImageError, match=r"a\.png is damaged"):
        read_image(path)


@dataclass(frozen=True, kw_only=True)
class Written:
    path: Path


@pytest.mark.parametrize("place", ["/etc/hostname", "../outside", "a/../../outside", 5, None])
def test_a_record_cannot_lead_out_of_its_folder(tmp_path: Path, place: object) -> None:
    assert of_json(Written, {"path": "cloud.ply"}, folder=tmp_path).path == tmp_path / "cloud.ply"
    with pytest.raises((TypeError, ValueError)):
        of_json(Written, {"path": place}, folder=tmp_path)


BAD_RECORDS = [
    {"result": {"path": "/etc/hostname"}}, {"seconds": "x"}, {"seconds": float("inf")}, {"run_id": None},
    {"result": {"path": {"a": 1}}}, {"result": None}, {"seconds": 10**400}, {"outputs": []},
]  # fmt: skip


@pytest.mark.parametrize("bad", BAD_RECORDS, ids=range(len(BAD_RECORDS)))
@pytest.mark.parametrize("state", ["done", "started"])
def test_a_damaged_record_costs_a_repetition_at_most(tmp_path: Path, bad: dict[str, object], state: str) -> None:
    stage = Stage(name="s", version=1, result=Written, outputs=("a",), keeps_partial=True)

    def work(_: bool) -> Written:
        (tmp_path / "a").mkdir(exist_ok=True)
        return Written(path=tmp_path / "a" / "b")

    Ledger(tmp_path).run(stage, work, inputs={})
    record = tmp_path / ".fsinfer" / "s.json"
    saved = json.loads(record.read_text(encoding="utf-8"))
    text = json.dumps(saved | {"state": state} | {key: value for key, value in bad.items() if value != 10**400})
    record.write_text(
        text if bad != {"seconds": 10**400} else text[:-1] + f', "seconds": {10**400}}}', encoding="utf-8"
    )
    done = Ledger(tmp_path).run(stage, work, inputs={})
    assert done.result.path == tmp_path / "a" / "b"
    assert done.seconds < 1e6


def test_a_link_in_the_place_of_a_part_is_not_written_through(tmp_path: Path) -> None:
    outside = tmp_path / "outside.txt"
    outside.write_text("precious", encoding="utf-8")
    out = tmp_path / "out"
    out.mkdir()
    (out / ".a.part.txt").symlink_to(outside)
    write_text(out / "a.txt", "new")
    assert outside.read_text(encoding="utf-8") == "precious"
    assert (out / "a.txt").read_text(encoding="utf-8") == "new"


def test_what_is_written_is_on_the_disk_before_it_has_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    flushed: list[tuple[int, bool]] = []
    fsync = os.fsync

    def noting(number: int) -> None:
        flushed.append((os.fstat(number).st_size, (tmp_path / "a.txt").exists()))
        fsync(number)

    monkeypatch.setattr(os, "fsync", noting)
    write_text(tmp_path / "a.txt", "12345")
    assert flushed == [(5, False)]


def test_a_copy_that_was_cut_is_no_copy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.jpg").write_bytes(bytes(1000))

    def cut(_source: object, target: object, _length: int) -> None:
        target.write(b"1")  # type: ignore[attr-defined]
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(shutil, "copyfileobj", cut)
        with pytest.raises(KeyboardInterrupt):
            copy_file(tmp_path / "a.jpg", tmp_path / "out" / "a.jpg")
    assert list((tmp_path / "out").iterdir()) == []
    copy_file(tmp_path / "a.jpg", tmp_path / "out" / "a.jpg")
    assert (tmp_path / "out" / "a.jpg").read_bytes() == bytes(1000)
    with pytest.raises(InputError, match=r"gone\.jpg"):
        copy_file(tmp_path / "gone.jpg", tmp_path / "out" / "b.jpg")


def test_errors_of_a_library_on_a_full_disk_are_told_as_such(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class LibraryError(Exception):
        pass

    def write() -> None:
        with atomic_path(tmp_path / "a.laz") as temporary:
            temporary.write_bytes(b"1")
            raise LibraryError("IO failed")

    with pytest.raises(LibraryError):
        write()
    usage = shutil.disk_usage(tmp_path)._replace(free=100)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    with pytest.raises(OutputError, match=r"the disk is full: could not write .*a\.laz"):
        write()
    assert list(tmp_path.iterdir()) == []


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("model")
    for name in ("field.json", "field_features.onnx", "field_regularizer.onnx", "field_refiner.onnx"):
        shutil.copy(models_folder() / name, folder / name)
    data = json.loads((folder / "field.json").read_text(encoding="utf-8"))
    short = {key: value for key, value in data.items() if key not in ("int8", "tiles")}
    (folder / "manifest.json").write_text(json.dumps(short), encoding="utf-8")
    return folder


def changed(model: Path, tmp_path: Path, **entries: object) -> Path:
    """The manifest with other entries, named by their path with "__" between the keys."""
    data = json.loads((model / "manifest.json").read_text(encoding="utf-8"))
    for name, value in entries.items():
        *parents, last = name.split("__")
        place = data
        for parent in parents:
            place = place[parent]
        place[last] = value
    for file in model.glob("*.onnx"):
        (tmp_path / file.name).symlink_to(file)
    path = tmp_path / "manifest.json"
    path.write_text(json.dumps(data), encoding="utf-8")
    return path


def curves(**adds: list[float]) -> dict[str, object]:
    """Of the confidence, with so much added at 0 and 1."""
    flat = {name: {"at": [0.0, 1.0], "adds": adds.get(name, [0.0, 0.0])} for name in QUANTITIES}
    return {"constant": 0.0, **flat}


@pytest.mark.parametrize(
    "entry",
    [
        {"graphs__features__file": "../field_features.onnx"},
        {"graphs__features__file": "/etc/hostname"},
        {"graphs__regularizer__file": None},
        {"graphs__refiner__file": 5},
        {"sha256": None},
        {"sha256": 5},
        {"volume__planes": 10**9},
        {"volume__planes": -1},
        {"volume__planes": 191},
        {"volume__packed_planes": "8"},
        {"refine__planes": 1},
        {"refine__span": "wide"},
        {"confidence_calibration": {"raw": [0.0, float("nan")], "within_1pct": [0, 1]}},
        {"photo_confidence": {"constant": 0.0}},
        {"photo_confidence": curves(network=[0.0, float("nan")])},
        {"photo_confidence": curves(network=[0.0, 1.0, 2.0])},
        {"surface": {"file": "../field_features.onnx"}},
        {"surface": {"file": 5}},
        {"surface": {}},
        {"config": []},
    ],
    ids=str,
)
def test_a_manifest_that_no_model_has(model: Path, tmp_path: Path, entry: dict[str, object]) -> None:
    assert read_manifest(changed(model, tmp_path)).planes == 192
    for link in tmp_path.glob("*.onnx"):
        link.unlink()
    with pytest.raises(ModelError, match=r"manifest\.json is not a model manifest"):
        read_manifest(changed(model, tmp_path, **entry))


def test_a_changed_graph_is_used_only_when_told(
    model: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture, capsys: pytest.CaptureFixture[str]
) -> None:
    path = changed(model, tmp_path, sha256="0" * 64)
    with pytest.raises(ModelError, match=r"damaged or was changed.*--trust-model"):
        read_manifest(path)
    trusted = read_manifest(path, trust=True)
    assert trusted.sha256 == read_manifest(model).sha256
    assert "it is used all the same" in caplog.text
    # On the command line: with the option the next thing that is wrong is told.
    scene = write_plane_scene(tmp_path / "scene")
    (scene / "images" / "1.png").write_bytes(b"x")
    for options, said in (([], "damaged or was changed"), (["--trust-model"], "1.png")):
        with pytest.raises(SystemExit) as stopped:
            app(["depth", str(scene), str(tmp_path / "out"), "--model", str(path), "--quiet", *options])
        assert stopped.value.code == 2
        assert said in capsys.readouterr().err


class Session:
    """Stands for onnxruntime."""

    def __init__(self, answer: object) -> None:
        self.answer = answer

    def run(self, *_: object) -> object:
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer


def test_graphs_that_give_something_else() -> None:
    plane = np.zeros((4, 5), np.float32)
    file = Path("a.onnx")
    assert Graph(file, Session([plane, plane])).run_two({})[0] is plane
    for answer in ([plane], [plane, plane[:2]], [plane, plane[None]], []):
        with pytest.raises(ModelError, match=r"a\.onnx gives .* re-export"):
            Graph(file, Session(answer)).run_two({})
    with pytest.raises(ModelError, match=r"a\.onnx does not compute"):
        Graph(file, Session(RuntimeError("Invalid shape"))).run(None, {})
    with pytest.raises(MemoryError):
        Graph(file, Session(RuntimeError("Failed to allocate memory for requested buffer"))).run(None, {})


def test_features_of_another_shape(model: Path) -> None:
    loaded = DepthModel.load(model, threads=1, precision="float32")
    for answer in ([], [np.zeros((1, 6, 8, 8), np.float32)], [np.zeros((8, 8), np.float32)]):
        loaded._sessions["features"] = Graph(Path("a.onnx"), Session(answer), map_levels=[None])
        with pytest.raises(ModelError, match="the features of model field"):
            loaded.features(np.zeros((40, 40, 3), np.uint8))


def test_a_table_of_measured_trees_without_trees_is_named(tmp_path: Path) -> None:
    (tmp_path / "truth.csv").write_text("tree_id,x_m,y_m,dbh_cm\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"truth\.csv holds no measured trees"):
        read_measured(tmp_path / "truth.csv")
    assert read_measured(tmp_path / "truth.csv", need_dbh=False) == []


@pytest.mark.parametrize("kind", ["[]", "{}", "null", "5"])
def test_a_border_of_no_kind(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "plot.geojson"
    path.write_text(f'{{"type": {kind}, "coordinates": [[[0, 0], [1, 0], [1, 1]]]}}', encoding="utf-8")
    with pytest.raises(InputError, match=r"plot\.geojson"):
        read_polygon(path)


def test_a_point_at_the_end_of_the_world_is_left_out() -> None:
    plot = plot_cloud(points_per_stem=800, ground=4000).xyz
    result = analyse_plot(np.vstack([plot, [0.0, 0.0, 1e30]]))
    assert [tree.dbh_cm for tree in result.trees] == [tree.dbh_cm for tree in analyse_plot(plot).trees]
    assert any(warning.code == StemCode.far_outside for warning in result.warnings)


def test_every_error_keeps_its_class() -> None:
    for kind in (FsinferError, CloudError, OutputError):
        assert str(kind("a" * 10)) == "a" * 10
        assert type(kind("a" * 9000)) is kind
