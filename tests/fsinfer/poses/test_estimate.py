"""Structure from motion finds the cameras of rendered photographs, and says what is wrong with hopeless ones."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.errors import FsinferError, ImageError, OutputError, PosesError
from fsinfer.io.gravity import noted_gravity
from fsinfer.io.images import image_size, read_image, write_image
from fsinfer.notices.capture import CaptureCode
from fsinfer.notices.notice import notice
from fsinfer.notices.sentences import sentence
from fsinfer.poses.adjustment.adjust import PhotoAdjustment
from fsinfer.poses.adjustment.photo_effects import effects_of
from fsinfer.poses.adjustment.precision import CameraPrecision
from fsinfer.poses.adjustment.projection import TURN
from fsinfer.poses.boards import BoardSighting
from fsinfer.poses.estimate import PosesResult, estimate_poses
from fsinfer.poses.mapping import MappedWalk, Walk
from fsinfer.poses.settings import PoseSettings
from fsinfer.poses.sparse import read_sparse
from fsinfer.progress import Progress
from fsinfer.scale.markers_seen import read_markers_seen
from fsinfer.scene import Scene, read_scene
from fsinfer.workflow.single_stages import poses_of
from tests.support.apple_note import phone_exif
from tests.support.places import DATA
from tests.support.rendered_room import FOCAL_PX, SIZE, photographs, poses
from tests.support.room_model import room_model

MONSTREE = DATA / "monstree"
SETTINGS = PoseSettings(max_features=1000, threads=1)


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("room")
    for index, image in enumerate(photographs()):
        # A space and an umlaut: names come from phones and people.
        note = phone_exif((-1.0, 0.1, -0.02 * index), 1, maker=None).tobytes()
        write_image(folder / "photos" / f"Bäume {index}.png", image, exif=note)
    (folder / "photos" / "cut.jpg").write_bytes(b"\xff\xd8\xff\xe0 this is no photograph")
    return folder


@pytest.fixture(scope="module")
def result(room: Path) -> PosesResult:
    return estimate_poses(room / "photos", room / "scene", settings=SETTINGS)


@pytest.fixture(scope="module")
def scene(result: PosesResult) -> Scene:
    return read_scene(result.scene)


def test_every_readable_photo_is_placed_and_the_damaged_one_is_named(result: PosesResult) -> None:
    assert (result.photos, result.registered) == (9, 8)
    assert len(result.warnings) == 1
    assert "cut.jpg" in sentence(result.warnings[0])
    record = json.loads((result.scene / "poses.json").read_text(encoding="utf-8"))
    assert (record["photos"], record["registered"]) == (9, 8)
    assert record["mean_reprojection_error_px"] < 1


def test_the_scene_keeps_which_way_gravity_pulled(room: Path, scene: Scene) -> None:
    for view in scene.views:
        given = noted_gravity(room / "photos" / f"{view.name}.png")
        kept = noted_gravity(view.image_path)
        assert given is not None
        assert kept is not None
        np.testing.assert_allclose(kept, given, atol=1e-4)


def assert_cameras_agree_with_the_truth(scene: Scene) -> None:
    truth = np.array([-pose[:3, :3].T @ pose[:3, 3] for pose in poses()])
    found = np.array([view.camera.center for view in scene.views])
    a, b = found - found.mean(0), truth - truth.mean(0)
    u, s, vt = np.linalg.svd(b.T @ a)
    rotation = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    scale = (s * [1, 1, np.linalg.det(u @ vt)]).sum() / (a**2).sum()
    error = np.linalg.norm(scale * a @ rotation.T - b, axis=1)
    assert error.max() < 0.03  # of a walk of 2.4 units round something 3.5 units away
    for view, pose in zip(scene.views, poses(), strict=True):
        between = view.camera.cam_from_world[:3, :3] @ rotation.T @ pose[:3, :3].T
        assert np.degrees(np.arccos(np.clip((np.trace(between) - 1) / 2, -1, 1))) < 0.6


def test_cameras_agree_with_the_truth_up_to_a_similarity(scene: Scene) -> None:
    assert_cameras_agree_with_the_truth(scene)


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_large_photos_are_reduced_before_anything_else(tmp_path: Path, suffix: str) -> None:
    for index, image in enumerate(photographs()):
        large = cv2.resize(image, (3 * SIZE[0], 3 * SIZE[1]), interpolation=cv2.INTER_CUBIC)
        write_image(tmp_path / "photos" / f"{index}{suffix}", np.asarray(large, np.uint8))
    result = estimate_poses(
        tmp_path / "photos", tmp_path / "scene", settings=replace(SETTINGS, longest_px=round(1.1 * SIZE[0]))
    )
    scene = read_scene(result.scene)
    assert result.registered == len(photographs())
    assert_cameras_agree_with_the_truth(scene)
    for view in scene.views:
        width, height = image_size(view.image_path)
        assert 0.85 * SIZE[0] < width < 1.15 * SIZE[0]
        assert abs(view.camera.intrinsic[0, 0] / FOCAL_PX / (width / SIZE[0]) - 1) < 0.05
        assert abs(view.camera.intrinsic[1, 2] - (height - 1) / 2) < 1


def test_intrinsics_belong_to_the_images_written(scene: Scene) -> None:
    for view in scene.views:
        width, height = image_size(view.image_path)
        matrix = view.camera.intrinsic
        assert abs(matrix[0, 2] - (width - 1) / 2) < 1
        assert abs(matrix[1, 2] - (height - 1) / 2) < 1
        assert abs(matrix[0, 0] / 420 - 1) < 0.05
        assert read_image(view.image_path).min(axis=2)[[0, -1]].max() > 0


def test_sparse_points_project_where_they_were_seen(scene: Scene) -> None:
    import pycolmap

    model = pycolmap.Reconstruction(scene.folder / "sparse")
    assert {image.name for image in model.images.values()} == {view.image_path.name for view in scene.views}
    by_name = {Path(image.name).stem: image for image in model.images.values()}
    for view in scene.views:
        seen = by_name[view.name].get_observation_points2D()
        points = np.array([model.points3D[point.point3D_id].xyz for point in seen])
        projected = points @ view.camera.cam_from_world[:3, :3].T + view.camera.cam_from_world[:3, 3]
        depths = projected[:, 2]
        projected = projected @ view.camera.intrinsic.T
        # COLMAP's pixel centres are at 0.5, the scene's at 0.
        offset = projected[:, :2] / projected[:, 2:] + 0.5 - [point.xy for point in seen]
        assert len(seen) > 50
        assert np.abs(np.median(offset, axis=0)).max() < 0.1
        assert view.camera.depth_min < np.percentile(depths, 1)
        assert view.camera.depth_max > np.percentile(depths, 99)


def test_points_lie_on_the_pictures_and_sources_are_neighbours(scene: Scene) -> None:
    sparse = read_sparse(scene.folder / "sparse")
    assert set(sparse.observations) == {view.name for view in scene.views}
    assert len(sparse.points) > 200
    for index, view in enumerate(scene.views):
        assert len(view.sources) == 7
        assert abs(view.sources[0] - index) <= 2


def test_a_second_call_finds_the_poses_done(room: Path, tmp_path: Path) -> None:
    first = poses_of(room / "photos", tmp_path / "scene", settings=SETTINGS)
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*") if path.is_file()}
    again = poses_of(room / "photos", tmp_path / "scene", settings=replace(SETTINGS, threads=2))
    assert (first.ran, again.ran) == (True, False)
    assert again.result == first.result
    assert before == {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*") if path.is_file()}


def test_threads_do_not_change_the_poses(result: PosesResult, room: Path, tmp_path: Path) -> None:
    estimate_poses(room / "photos", tmp_path / "scene", settings=replace(SETTINGS, threads=2))
    for name in ("cams", "sparse"):
        files = sorted((result.scene / name).iterdir())
        assert len(files) >= 3
        assert [path.read_bytes() for path in files] == [
            (tmp_path / "scene" / name / path.name).read_bytes() for path in files
        ]


def test_goes_on_from_the_features_after_a_kill(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import pycolmap

    photos, out = tmp_path / "photos", tmp_path / "out"
    for index, image in enumerate(photographs()[:4]):
        write_image(photos / f"p{index}.jpg", image)

    class KillError(Exception):
        pass

    def stop(_stage: str) -> Progress:
        def report(_done: int, _total: int, what: str) -> None:
            if what == "matching photos":
                raise KillError

        return report

    with pytest.raises(KillError):
        poses_of(photos, out, settings=SETTINGS, progress=stop)
    assert not (out / "poses.json").exists()

    def forbidden(*_args: object, **_options: object) -> None:
        pytest.fail("features were extracted again")

    # In this process, where that is seen.
    monkeypatch.setattr("fsinfer.workflow.photo_stages.estimate_poses_apart", estimate_poses)
    monkeypatch.setattr(pycolmap, "extract_features", forbidden)
    assert poses_of(photos, out, settings=SETTINGS).result.registered == 4
    assert not (out / "work").exists()


def test_other_photos_begin_anew_where_an_attempt_was_stopped(tmp_path: Path) -> None:
    def stop(_done: int, _total: int, what: str) -> None:
        if what == "matching photos":
            raise KeyboardInterrupt

    for index, image in enumerate(photographs()[:5]):
        write_image(tmp_path / "photos" / f"p{index}.jpg", image)
    with pytest.raises(KeyboardInterrupt):
        estimate_poses(tmp_path / "photos", tmp_path / "out", settings=SETTINGS, progress=stop)
    (tmp_path / "photos" / "p4.jpg").unlink()
    # Four photos: the database of the five would have the fifth's features.
    result = estimate_poses(tmp_path / "photos", tmp_path / "out", settings=SETTINGS)
    assert (result.photos, result.registered, result.left_out) == (4, 4, ())


def test_the_larger_of_two_parts_is_taken_and_the_other_named(tmp_path: Path) -> None:
    for index, image in enumerate(photographs()[:5]):
        write_image(tmp_path / "photos" / f"p{index}.jpg", image)
    for index, image in enumerate(photographs(seed=50)[2:5]):
        write_image(tmp_path / "photos" / f"other{index}.jpg", image)
    result = estimate_poses(tmp_path / "photos", tmp_path / "scene", settings=SETTINGS)
    assert (result.photos, result.registered) == (8, 5)
    assert len(result.warnings) == 1
    assert "3 of 8 photos left out (other0, other1, other2): they hang together" in sentence(result.warnings[0])
    assert {view.name for view in read_scene(result.scene).views} == {f"p{index}" for index in range(5)}


def moved_px(one: NDArray[np.uint8], other: NDArray[np.uint8], rows: slice) -> float:
    """How far to the right what ``one`` shows in these rows lies in ``other``."""
    grey = [cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)[rows].astype(np.float64) for image in (one, other)]
    window = cv2.createHanningWindow(grey[0].shape[::-1], cv2.CV_64F)
    return float(cv2.phaseCorrelate(grey[0], grey[1], window)[0][0])


def test_what_changes_from_photo_to_photo_is_told_and_undone_in_the_images(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    views, shutter_px = 4, 24.0
    for index, image in enumerate(photographs(views)):
        write_image(tmp_path / "photos" / f"r{index}.png", image)

    board = 0.5 + np.array([[200, 40], [260, 40], [260, 320], [200, 320]])  # pixels' centres in COLMAP's way
    outside = board - [230.0, 0.0]

    def mapped(walk: Walk, *_: Any) -> MappedWalk:
        sightings = tuple(
            BoardSighting(file=file, number=number, corners_px=corners)
            for file in walk.files[1:]
            for number, corners in ((7, board), (9, outside))
        )
        return MappedWalk(model=room_model(walk.files, poses(views)), misplaced={}, sightings=sightings)

    def adjusted(model: Any, *_: Any, **__: Any) -> tuple[Any, PhotoAdjustment]:
        """All but the last photo turned about the upright axis while they were read out; the room is twice as large."""
        import pycolmap

        own = np.zeros(9)
        own[TURN] = 0.0, shutter_px / FOCAL_PX, 0.0
        effects = effects_of(own, np.empty((0, 2)), np.empty(0), *SIZE)
        found = PhotoAdjustment(
            effects={i: effects for i in model.reg_image_ids() if model.images[i].name != "00003.png"},
            precisions={i: CameraPrecision(center_std=0.01 * i, direction_std_rad=1e-4) for i in model.reg_image_ids()},
            groups=("turn",),
            rolling_shutter_px=shutter_px,
            focal_std_percent=0.0502,
            principal_std_px=0.25,
        )
        larger = deepcopy(model)
        larger.transform(pycolmap.Sim3d(2.0, pycolmap.Rotation3d(), np.zeros(3)))
        return larger, found

    monkeypatch.setattr("fsinfer.poses.estimate.map_walk", mapped)
    still = estimate_poses(tmp_path / "photos", tmp_path / "still", settings=SETTINGS)
    monkeypatch.setattr("fsinfer.poses.estimate.adjust_photos", adjusted)
    result = estimate_poses(tmp_path / "photos", tmp_path / "scene", settings=SETTINGS)

    # Nothing was to be told of so few photos that stood still; what is small is not told now.
    assert still.warnings == ()
    assert result.warnings == (notice(CaptureCode.rolling_shutter, median_px=shutter_px),)
    assert (result.rolling_shutter_px, result.focal_std_percent, result.principal_std_px) == (shutter_px, 0.0502, 0.25)
    record = json.loads((result.scene / "poses.json").read_text(encoding="utf-8"))
    assert record["warnings"] == [sentence(result.warnings[0])]
    assert record["adjusted_photo_by_photo"] == ["turn"]
    assert (record["rolling_shutter_px"], record["focal_std_percent"]) == (shutter_px, 0.05)
    assert record["principal_std_px"] == 0.25
    assert {name: std["center"] for name, std in record["camera_std"].items()} == {
        "r0": 0.01, "r1": 0.02, "r2": 0.03, "r3": 0.04,
    }  # fmt: skip
    before, after = read_scene(still.scene).views, read_scene(result.scene).views
    for view, was in zip(after, before, strict=True):
        np.testing.assert_allclose(view.camera.center, 2 * was.camera.center, atol=1e-6)
        image, plain = read_image(view.image_path), read_image(was.image_path)
        if view.name == "r3":
            np.testing.assert_array_equal(image, plain)
            continue
        # The last rows had seen everything half the way to the right, the first rows to the left, and the middle one
        # where it belongs. Strips are 60 of 360 rows.
        half = shutter_px * (0.5 - 30 / SIZE[1])
        moved = [moved_px(plain, image, slice(row, row + 60)) for row in (0, 150, 300)]
        np.testing.assert_allclose(moved, [half, 0.0, -half], atol=1.5)

    # Boards that were seen are told where the images show them now.
    markers = read_markers_seen(read_scene(result.scene))
    assert markers.of("r0", "4X4_50", 12.0) == ()
    for name in ("r1", "r2", "r3"):
        ((number, corners),) = markers.of(name, "4X4_50", 12.0) or ()
        assert number == 7
        turned = shutter_px * (0.5 - board[:, 1] / SIZE[1]) if name != "r3" else np.zeros(4)
        np.testing.assert_allclose(corners, board - 0.5 + np.column_stack([turned, np.zeros(4)]), atol=1.0)


def noise_photos(folder: Path, count: int) -> Path:
    rng = np.random.default_rng(0)
    for index in range(count):
        write_image(folder / f"n{index}.png", rng.integers(0, 255, (120, 160, 3), dtype=np.uint8))
    return folder


@pytest.mark.parametrize("flat", [False, True])
def test_photos_without_overlap(tmp_path: Path, flat: bool, capfd: pytest.CaptureFixture[str]) -> None:
    folder = noise_photos(tmp_path / "photos", 4)
    if flat:
        for path in folder.iterdir():
            write_image(path, np.full((120, 160, 3), 90, np.uint8))
    with pytest.raises(PosesError, match="overlap"):
        estimate_poses(folder, tmp_path / "out", settings=SETTINGS)
    captured = capfd.readouterr()
    assert captured.out + captured.err == ""
    assert not (tmp_path / "out" / "cams").exists()


def test_too_few_photos(tmp_path: Path) -> None:
    with pytest.raises(PosesError, match="one photo"):
        estimate_poses(noise_photos(tmp_path / "one", 1), tmp_path / "out", settings=SETTINGS)
    with pytest.raises(PosesError, match="2 photos"):
        estimate_poses(noise_photos(tmp_path / "two", 2), tmp_path / "out", settings=SETTINGS)


def test_messages_name_the_folder_of_the_user(tmp_path: Path) -> None:
    for count in (1, 2, 4):
        chosen = noise_photos(tmp_path / f"chosen{count}", count)
        with pytest.raises(PosesError, match=r"walk\.mp4") as caught:
            estimate_poses(chosen, tmp_path / f"out{count}", settings=SETTINGS, origin=tmp_path / "walk.mp4")
        assert "chosen" not in str(caught.value)


def test_a_program_that_is_told_to_end_ends_without_a_trace(tmp_path: Path) -> None:
    code = (
        "import os, signal; from pathlib import Path; from fsinfer.poses.colmap import colmap_errors\n"
        "with colmap_errors('x', Path('.')): os.kill(os.getpid(), signal.SIGTERM)"
    )
    ended = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, check=False)
    assert ended.returncode == -signal.SIGTERM
    assert ended.stdout + ended.stderr == b""


def test_folder_without_photos(tmp_path: Path) -> None:
    for folder in (tmp_path, tmp_path / "gone"):
        with pytest.raises(ImageError, match="folder"):
            estimate_poses(folder, tmp_path / "out", settings=SETTINGS)


def test_folders_of_the_user_are_not_touched(tmp_path: Path) -> None:
    photos = noise_photos(tmp_path / "scene" / "images", 4)
    before = sorted(photos.iterdir())
    with pytest.raises(ImageError, match="overwritten"):
        estimate_poses(photos, tmp_path / "scene", settings=SETTINGS)
    with pytest.raises(OutputError, match="did not make"):
        estimate_poses(noise_photos(tmp_path / "other", 4), tmp_path / "scene", settings=SETTINGS)
    assert sorted(photos.iterdir()) == before


def test_unknown_mapper(tmp_path: Path) -> None:
    settings = PoseSettings(mapper="magic", threads=1)
    with pytest.raises(FsinferError, match="magic"):
        estimate_poses(noise_photos(tmp_path / "photos", 3), tmp_path / "out", settings=settings)


@pytest.mark.skipif(not MONSTREE.is_dir(), reason="shared/data/monstree is not there")
def test_phone_photos_lie_on_their_side_and_are_written_upright(tmp_path: Path) -> None:
    from fsinfer.io.images import is_upright_jpeg_or_png
    from fsinfer.io.photo_folders import list_images

    paths = list_images(MONSTREE)
    assert not is_upright_jpeg_or_png(paths[0])
    assert image_size(paths[0]) == (1512, 2016)
