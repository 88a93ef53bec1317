"""Each format is read to the cameras that it was written from: places, directions and lenses, to a millionth."""

from __future__ import annotations

import json
import re
import unicodedata
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.errors import SceneError
from fsinfer.importers.foreign import ForeignScene, centers_of
from fsinfer.importers.formats import reader_of
from fsinfer.importers.write import write_scene
from fsinfer.io.images import write_image
from tests.support import foreign_scenes as made
from tests.support.foreign_scenes import BROWN, COLMAP_LENSES, PINHOLE, SIZE, Truth

#: Of Unicode.
Form = Literal["NFC", "NFD"]
#: Writes a scene below a folder and returns what is given to fsinfer, for a lens that the format can say.
Writer = Callable[[Truth, Path], Path]


def _colmap(kind: str, *, binary: bool) -> Writer:
    def write(scene: Truth, folder: Path) -> Path:
        made.write_colmap(scene, folder / "sparse" / "0", kind=kind, binary=binary)
        made.write_photos(scene, folder / "images")
        return folder

    return write


def _openmvs(version: int, *, normalized: bool = False, from_corner: bool = False) -> Writer:
    def write(scene: Truth, folder: Path) -> Path:
        file = folder / "scene.mvs"
        made.write_openmvs(scene, file, version=version, normalized=normalized, from_corner=from_corner)
        made.write_photos(scene, folder / "images")
        return file

    return write


def _metashape(*, component: bool) -> Writer:
    def write(scene: Truth, folder: Path) -> Path:
        made.write_metashape(scene, folder / "cameras.xml", component=component)
        made.write_photos(scene, folder / "images")
        return folder / "cameras.xml"

    return write


def _transforms(scene: Truth, folder: Path) -> Path:
    made.write_transforms(scene, folder / "transforms.json")
    made.write_photos(scene, folder / "images")
    return folder


def _folder(write: Callable[[Truth, Path], None]) -> Writer:
    def written(scene: Truth, folder: Path) -> Path:
        write(scene, folder / "export")
        return folder / "export"

    return written


FORMATS = {
    **{f"colmap-{kind}-text": (_colmap(kind, binary=False), lens) for kind, lens in COLMAP_LENSES.items()},
    **{f"colmap-{kind}-binary": (_colmap(kind, binary=True), lens) for kind, lens in COLMAP_LENSES.items()},
    **{f"openmvs-{version}": (_openmvs(version), PINHOLE) for version in (1, 3, 4, 5, 6, 7)},
    "openmvs-normalized": (_openmvs(7, normalized=True), PINHOLE),
    "openmvs-normalized-from-corner": (_openmvs(7, normalized=True, from_corner=True), PINHOLE),
    "openmvs-normalized-middle": (
        _openmvs(7, normalized=True, from_corner=True),
        replace(PINHOLE, cx=(SIZE[0] - 1) / 2, cy=(SIZE[1] - 1) / 2),
    ),
    "metashape-component": (_metashape(component=True), replace(BROWN, fy=129.0)),
    "metashape-chunk": (_metashape(component=False), BROWN),
    "transforms": (_transforms, replace(BROWN, fy=129.0)),
    "polycam": (_folder(made.write_polycam), PINHOLE),
    "scanner": (_folder(made.write_scanner_app), PINHOLE),
    "record3d": (_folder(made.write_record3d), PINHOLE),
    "rtabmap": (_folder(made.write_rtabmap), BROWN),
}


def read(given: Path, images: Path | None = None) -> ForeignScene:
    reader = reader_of(given, images)
    assert reader is not None, given
    return reader()


@pytest.mark.parametrize("name", FORMATS)
def test_cameras_are_those_that_were_written(tmp_path: Path, name: str) -> None:
    write, lens = FORMATS[name]
    scene = made.truth(lens)
    found = read(write(scene, tmp_path / "a plot"))
    assert len(found.photos) == len(scene.photos)
    for photo, true in zip(found.photos, scene.photos, strict=True):
        np.testing.assert_allclose(photo.cam_from_world, true.cam_from_world, atol=1e-6)
        assert (photo.lens.width, photo.lens.height) == SIZE
        # The whole lens at once: where it puts points that OpenCV projects.
        pixels, depth = made.project(true, lens, scene.points)
        near = (depth > 0) & (np.abs(pixels - np.array(SIZE) / 2) < np.array(SIZE)).all(axis=1)
        in_camera = scene.points @ true.cam_from_world[:3, :3].T + true.cam_from_world[:3, 3]
        rays = in_camera[near, :2] / in_camera[near, 2:]
        np.testing.assert_allclose(photo.lens.pixels_of(rays), pixels[near], atol=1e-6 * lens.fx)
        assert photo.path.is_file()


@pytest.mark.parametrize("name", ["colmap-OPENCV-text", "colmap-OPENCV-binary", "openmvs-1", "openmvs-7"])
def test_tie_points_and_who_sees_them(tmp_path: Path, name: str) -> None:
    write, lens = FORMATS[name]
    scene = made.truth(lens)
    sparse = read(write(scene, tmp_path)).sparse
    assert sparse is not None
    np.testing.assert_allclose(sparse.points, scene.points, atol=1e-6)
    for photo, seen in zip(scene.photos, made.visible(scene), strict=True):
        assert sparse.observations[photo.name].tolist() == seen.tolist()
    counts = np.bincount(np.concatenate(made.visible(scene)), minlength=len(scene.points))
    assert sparse.track_lengths.tolist() == counts.tolist()


@pytest.mark.parametrize(
    ("name", "metric", "z_up"),
    [
        ("colmap-OPENCV-text", False, False),
        ("openmvs-7", False, False),
        ("transforms", False, False),
        ("metashape-chunk", True, False),
        ("polycam", True, True),
        ("scanner", True, True),
        ("record3d", True, False),
        ("rtabmap", True, True),
    ],
)
def test_what_is_known_of_the_unit_and_of_the_vertical(tmp_path: Path, name: str, metric: bool, z_up: bool) -> None:
    write, lens = FORMATS[name]
    found = read(write(made.truth(lens), tmp_path))
    assert (found.metric, found.z_up) == (metric, z_up)


@pytest.mark.parametrize("binary", [True, False])
def test_of_several_models_the_one_with_the_most_photographs_is_used(tmp_path: Path, binary: bool) -> None:
    """The mapper begins with what it can, and numbers what it could not join in that order."""
    scene = made.truth(PINHOLE)
    nine = (replace(scene.photos[index % 4], name=f"IMG_{index}") for index in range(9))
    scene = replace(scene, photos=tuple(nine))
    made.write_photos(scene, tmp_path / "images")
    for number, (start, end) in {0: (0, 2), 2: (2, 4), 10: (4, 9)}.items():
        part = replace(scene, photos=scene.photos[start:end])
        made.write_colmap(part, tmp_path / "sparse" / str(number), kind="PINHOLE", binary=binary)
    found = read(tmp_path)
    assert [photo.name for photo in found.photos] == [photo.name for photo in scene.photos[4:]]
    (remark,) = found.remarks
    assert re.search(r"3 models.*sparse.10, with the most images \(5\).*sparse.0 \(2 images\), .*sparse.2 \(2", remark)
    # A smaller one is used where it is asked for, and a damaged one is in nobody's way.
    assert len(read(tmp_path / "sparse" / "0").photos) == 2
    assert read(tmp_path / "sparse" / "0").remarks == ()
    (tmp_path / "sparse" / "0" / f"images.{'bin' if binary else 'txt'}").write_bytes(b"1 2 3\n")
    assert len(read(tmp_path).photos) == 5


def test_a_chunk_without_a_scale_is_in_its_own_unit(tmp_path: Path) -> None:
    scene = made.truth(PINHOLE)
    made.write_metashape(scene, tmp_path / "cameras.xml", scaled=False)
    made.write_photos(scene, tmp_path)
    found = read(tmp_path / "cameras.xml")
    assert not found.metric
    assert any("no scale" in remark for remark in found.remarks)
    steps = np.linalg.norm(np.diff(centers_of(found.photos), axis=0), axis=1)
    true = [np.linalg.norm(made.world_from_cam(b)[:3, 3] - made.world_from_cam(a)[:3, 3])
            for a, b in zip(scene.photos[:-1], scene.photos[1:], strict=True)]  # fmt: skip
    np.testing.assert_allclose(steps * made.CHUNK_SCALE, true, rtol=1e-9)


def test_photographs_of_one_name_are_left_out_and_named(tmp_path: Path) -> None:
    """Two cards begin their numbers anew: which of the two the one file is nobody can tell."""
    scene = made.truth(PINHOLE)
    made.write_photos(scene, tmp_path)
    names = [photo.name for photo in scene.photos]
    alike = [replace(photo, name=names[0]) if photo.name == names[-1] else photo for photo in scene.photos]
    made.write_metashape(replace(scene, photos=tuple(alike)), tmp_path / "cameras.xml")
    found = read(tmp_path / "cameras.xml")
    assert [photo.name for photo in found.photos] == names[1:-1]
    assert found.left_out.count(f"walk/{names[0]}") == 2
    assert any(f"left out (walk/{names[0]})" in remark for remark in found.remarks)
    both = replace(scene, photos=(alike[0], alike[-1]))
    made.write_metashape(both, tmp_path / "cameras.xml")
    with pytest.raises(SceneError, match=rf"2 share a file with another \(walk/{names[0]}, walk/{names[0]}\)"):
        read(tmp_path / "cameras.xml")


def test_photographs_of_a_group_lie_in_the_folder_of_its_name(tmp_path: Path) -> None:
    """Two cards begin their numbers anew, and Metashape makes a group of each folder; its labels have no folder."""
    scene = made.truth(PINHOLE)
    alike = tuple(replace(photo, name=f"IMG_{index % 2}") for index, photo in enumerate(scene.photos))
    made.write_metashape(replace(scene, photos=alike), tmp_path / "cameras.xml")
    text = (tmp_path / "cameras.xml").read_text(encoding="utf-8")
    text = text.replace('<group id="0" label="walk">', '<group id="0" label="erste Hälfte">')
    text = text.replace('<camera id="2"', '</group><group id="1" label="zweite Hälfte"><camera id="2"')
    (tmp_path / "cameras.xml").write_text(text, encoding="utf-8")
    for folder, photos in (("erste Hälfte", alike[:2]), ("zweite Hälfte", alike[2:])):
        made.write_photos(replace(scene, photos=photos), tmp_path / "Fotos" / folder)
    found = read(tmp_path / "cameras.xml", tmp_path / "Fotos")
    assert [photo.path.relative_to(tmp_path / "Fotos").as_posix() for photo in found.photos] == [
        "erste Hälfte/IMG_0.png", "erste Hälfte/IMG_1.png", "zweite Hälfte/IMG_0.png", "zweite Hälfte/IMG_1.png",
    ]  # fmt: skip
    for photo, true in zip(found.photos, scene.photos, strict=True):
        np.testing.assert_allclose(photo.cam_from_world, true.cam_from_world, atol=1e-6)
    assert found.left_out == ("not aligned",)


@pytest.mark.parametrize(("told", "stored"), [("NFC", "NFD"), ("NFD", "NFC")])
def test_umlauts_in_one_character_and_in_two_are_the_same(tmp_path: Path, told: Form, stored: Form) -> None:
    scene = made.truth(PINHOLE)
    names = [f"Fläche 3 {photo.name}" for photo in scene.photos]
    called = [unicodedata.normalize(told, name) for name in names]
    photos = tuple(replace(photo, name=name) for photo, name in zip(scene.photos, called, strict=True))
    made.write_metashape(replace(scene, photos=photos), tmp_path / "cameras.xml")
    made.write_photos(scene, tmp_path / "images", [unicodedata.normalize(stored, name) for name in names])
    assert [photo.name for photo in read(tmp_path / "cameras.xml").photos] == called


def test_a_label_that_several_files_fit_is_refused_with_their_names(tmp_path: Path) -> None:
    scene = made.truth(PINHOLE)
    made.write_photos(scene, tmp_path)
    made.write_metashape(scene, tmp_path / "cameras.xml")
    first = scene.photos[0].name
    write_image(tmp_path / f"{first}.jpg", made.render(scene.photos[-1], scene.lens))
    with pytest.raises(SceneError, match=rf"{first} may be {first}.jpg or {first}.png in .*; leave the one there"):
        read(tmp_path / "cameras.xml")


@pytest.mark.parametrize(
    "name", ["colmap-PINHOLE-text", "colmap-PINHOLE-binary", "openmvs-7", "transforms", "metashape-chunk"]
)
def test_coordinates_of_a_grid_are_taken_from_the_middle_of_the_cameras(tmp_path: Path, name: str) -> None:
    grid = np.array([5_200_000.0, -520_000.0, 400.0])
    scene = made.truth(PINHOLE)
    near = read(FORMATS[name][0](scene, tmp_path / "near"))
    far = replace(
        scene,
        photos=tuple(replace(p, cam_from_world=p.cam_from_world @ _shift(-grid)) for p in scene.photos),
        points=scene.points + grid,
    )
    found = read(FORMATS[name][0](far, tmp_path / "far"))
    assert near.origin == (0.0, 0.0, 0.0)
    assert np.abs(np.array(found.origin) - grid).max() < 5
    assert np.abs(centers_of(found.photos)).max() < 5
    rest = grid - np.array(found.origin)
    np.testing.assert_allclose(centers_of(found.photos), centers_of(near.photos) + rest, atol=1e-6)
    if found.sparse is not None and near.sparse is not None:
        # OpenMVS keeps tie points in single precision: half a metre is all that they know of a northing.
        tolerance = 0.5 if name.startswith("openmvs") else 1e-6
        np.testing.assert_allclose(found.sparse.points, near.sparse.points + rest, atol=tolerance)
    write_scene(found, tmp_path / "scene")
    told = json.loads((tmp_path / "scene" / "import.json").read_text(encoding="utf-8"))
    np.testing.assert_array_equal(told["origin"], found.origin)


def _shift(by: NDArray[np.float64]) -> NDArray[np.float64]:
    matrix = np.eye(4)
    matrix[:3, 3] = by
    return matrix


def test_a_chunk_on_the_earth_gets_z_up_and_small_coordinates(tmp_path: Path) -> None:
    # Geocentric coordinates at 47° north, 8.5° east, 500 m above the ellipsoid (WGS84).
    latitude, longitude, height = np.radians(47.0), np.radians(8.5), 500.0
    a, e2 = 6378137.0, 6.69437999014e-3
    n = a / np.sqrt(1 - e2 * np.sin(latitude) ** 2)
    place = [
        (n + height) * np.cos(latitude) * np.cos(longitude),
        (n + height) * np.cos(latitude) * np.sin(longitude),
        (n * (1 - e2) + height) * np.sin(latitude),
    ]
    east = [-np.sin(longitude), np.cos(longitude), 0]
    up = [np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)]
    earth = np.eye(4)
    earth[:3, :3] = np.column_stack([east, np.cross(up, east), up])
    earth[:3, 3] = place
    scene = made.truth(PINHOLE)
    made.write_metashape(scene, tmp_path / "cameras.xml", world_from_truth=earth)
    made.write_photos(scene, tmp_path)
    found = read(tmp_path)
    assert found.metric
    assert found.z_up
    assert np.abs(centers_of(found.photos)).max() < 5
    np.testing.assert_allclose(found.origin, place, atol=5)
    for photo, true in zip(found.photos, scene.photos, strict=True):
        # The normal of the ellipsoid is taken below the cameras, not through them: 1e-5 rad at most.
        np.testing.assert_allclose(photo.cam_from_world[:3, :3], true.cam_from_world[:3, :3], atol=1e-5)
        steps = centers_of(found.photos) - centers_of(found.photos)[0]
    true_centers = np.array([made.world_from_cam(photo)[:3, 3] for photo in scene.photos])
    np.testing.assert_allclose(steps, true_centers - true_centers[0], atol=1e-5)


def test_openmvs_without_a_principal_point_has_it_in_the_middle(tmp_path: Path) -> None:
    scene = made.truth(replace(PINHOLE, cx=0.0, cy=0.0))
    found = read(_openmvs(7, normalized=True)(scene, tmp_path))
    assert {(photo.lens.cx, photo.lens.cy) for photo in found.photos} == {((SIZE[0] - 1) / 2, (SIZE[1] - 1) / 2)}


def test_pycolmap_and_the_reader_agree(tmp_path: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    options = pycolmap.SyntheticDatasetOptions()
    options.num_frames_per_rig, options.num_points3D = 5, 60
    model = pycolmap.synthesize_dataset(options)
    for binary in (True, False):
        folder = tmp_path / str(binary)
        folder.mkdir()
        (model.write_binary if binary else model.write_text)(folder)
        for image in model.images.values():
            path = folder / Path(image.name)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.with_suffix(".png").write_bytes(b"")
        names = {Path(image.name).stem: image for image in model.images.values()}
        found = read(folder)
        assert found.sparse is not None
        assert sorted(photo.name for photo in found.photos) == sorted(names)
        for photo in found.photos:
            image = names[photo.name]
            np.testing.assert_allclose(photo.cam_from_world[:3], image.cam_from_world().matrix(), atol=1e-9)
            assert len(found.sparse.observations[photo.name]) == image.num_points3D
            camera = model.cameras[image.camera_id]
            rays = np.array([[0.1, -0.2], [-0.3, 0.05]])
            pixels = camera.img_from_cam(np.column_stack([rays, np.ones(2)])) - 0.5
            np.testing.assert_allclose(photo.lens.pixels_of(rays), pixels, atol=1e-6)


def test_frames_of_a_film_are_thinned(tmp_path: Path) -> None:
    scene = made.truth(PINHOLE, views=4)
    crowded = replace(scene, photos=tuple(photo for photo in scene.photos for _ in range(5)))
    crowded = replace(crowded, photos=tuple(replace(photo, name=f"{i}") for i, photo in enumerate(crowded.photos)))
    made.write_record3d(crowded, tmp_path / "export")
    found = read(tmp_path / "export")
    assert [photo.name for photo in found.photos] == ["0", "5", "10", "15"]
    assert any("of 20 frames 4" in remark for remark in found.remarks)


def test_what_no_program_wrote_is_no_foreign_scene(tmp_path: Path) -> None:
    for name, content in (("a.xml", "<svg/>"), ("b.json", "{}"), ("c.mvs", "hello"), ("cameras.txt", "1 PINHOLE")):
        (tmp_path / name).write_text(content, encoding="utf-8")
        assert reader_of(tmp_path / name) is None
    assert reader_of(tmp_path) is None
    assert reader_of(tmp_path / "nowhere") is None
