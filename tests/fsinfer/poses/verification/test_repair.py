"""A photo that was placed wrongly finds its true place when the photos are mapped again."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fsinfer.poses.colmap import reconstruct
from fsinfer.poses.settings import PoseSettings
from fsinfer.poses.verification.misplaced import agreeing_matches, drop, drop_strays, without_pairs
from fsinfer.poses.verification.pair_votes import PairVote
from fsinfer.poses.verification.repair import placed_again, repair, repair_part
from fsinfer.progress import silent


def synthetic(database: Path, frames: int, points: int) -> Any:
    """A ``pycolmap.Reconstruction`` of so many photos and points, with their matches in ``database``."""
    pycolmap = pytest.importorskip("pycolmap")
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig = 1, 1, frames
    options.num_points3D = points
    with pycolmap.Database.open(database) as opened:
        return pycolmap.synthesize_dataset(options, opened)


def moved_to(model: Any, rotvec: Sequence[float], shift: Sequence[float]) -> Any:
    """The fifth photo of a model, after it was moved with its points."""
    return move(model, sorted(model.reg_image_ids())[4], rotvec, shift)


def move(model: Any, image_id: int, rotvec: Sequence[float], shift: Sequence[float]) -> Any:
    """A photo of a model, moved with its points."""
    pycolmap = pytest.importorskip("pycolmap")
    image = model.images[image_id]
    turn = pycolmap.Rotation3d(Rotation.from_rotvec(rotvec).as_quat())
    pose = pycolmap.Rigid3d(turn, np.array(shift)) * image.cam_from_world()
    model.frame(image.frame_id).set_cam_from_world(image.camera_id, pose)
    return image


def test_a_moved_photo_finds_its_place_again(tmp_path: Path) -> None:
    database = tmp_path / "database.db"
    model = synthetic(database, 8, 200)
    (tmp_path / "images").mkdir()
    image_ids = sorted(model.reg_image_ids())
    walk = [model.images[i].name for i in image_ids]
    true = {i: model.images[i].projection_center() for i in image_ids}
    before = agreeing_matches(model, database)
    # The mapper puts it elsewhere, with its points: another place, turned by twelve degrees.
    moved_to(model, [0.0, 0.2, 0.1], [0.6, 0.0, 0.2])
    assert agreeing_matches(model, database) < before
    repaired, misplaced = repair(model, database, walk, tmp_path, PoseSettings(threads=1), silent)
    assert not any(misplaced.values())
    assert repaired.num_reg_images() == 8
    assert agreeing_matches(repaired, database) == before
    # The same shape: distances between the photos, up to one scale.
    found = np.array([repaired.images[i].projection_center() for i in image_ids])
    expected = np.array([true[i] for i in image_ids])
    ratio = np.linalg.norm(found[1:] - found[0], axis=1) / np.linalg.norm(expected[1:] - expected[0], axis=1)
    assert np.ptp(ratio) / ratio.mean() < 0.01


def test_what_is_judged_the_same_way_is_mapped_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    database = tmp_path / "database.db"
    model = synthetic(database, 8, 200)
    walk = [model.images[i].name for i in sorted(model.reg_image_ids())]
    lost = str(moved_to(model, [0.0, 0.2, 0.1], [0.6, 0.0, 0.2]).name)
    starts = []

    def found_no_place(*_: Any, start: Any) -> list[Any]:
        starts.append(start)
        return [deepcopy(start)]

    monkeypatch.setattr("fsinfer.poses.verification.repair.reconstruct", found_no_place)
    repaired, _ = repair(model, database, walk, tmp_path, PoseSettings(threads=1), silent)
    placed = {str(repaired.images[i].name) for i in repaired.reg_image_ids()}
    assert placed == set(walk) - {lost}
    # All three ways of judging take the same photo for a wrong one.
    assert len(starts) == 1


@pytest.mark.parametrize("found", ["all", "none"])
def test_photos_that_a_part_lost_find_their_place_beside_what_is_right(tmp_path: Path, found: str) -> None:
    database = tmp_path / "database.db"
    right = synthetic(database, 8, 200)
    wrong = deepcopy(right)
    moved_to(wrong, [0.0, 0.2, 0.1], [0.6, 0.0, 0.2])
    begun: list[int] = []

    def mapped(start: Any) -> list[Any]:
        begun.append(start.num_reg_images())
        return [deepcopy(right)] if found == "all" else []

    assert repair_part(deepcopy(right), database, 0, 3, mapped).num_reg_images() == 8
    assert begun == []
    assert repair_part(deepcopy(wrong), database, 0, 3, mapped).num_reg_images() == (8 if found == "all" else 7)
    assert begun == [7]
    # What is left of it is too little to go on from.
    assert repair_part(deepcopy(wrong), database, 0, 8, mapped).num_reg_images() == 7
    assert begun == [7]


@pytest.mark.parametrize("found", ["right", "still wrong", "nothing"])
def test_photos_beyond_the_plot_find_their_place_or_are_left_out(tmp_path: Path, found: str) -> None:
    database = tmp_path / "database.db"
    right = synthetic(database, 8, 100)
    wrong = deepcopy(right)
    moved = moved_to(wrong, [0.0, 0.0, 0.0], [1e5, 0.0, 0.0])
    begun: list[int] = []

    def mapped(start: Any) -> list[Any]:
        begun.append(start.num_reg_images())
        return {"right": [deepcopy(right)], "still wrong": [deepcopy(wrong)], "nothing": []}[found]

    model, lost = placed_again(deepcopy(right), (), database, mapped)
    assert (model.num_reg_images(), lost, begun) == (8, [], [])
    model, lost = placed_again(deepcopy(wrong), (), database, mapped)
    assert begun == [7]
    assert (model.num_reg_images(), lost) == ((8, []) if found == "right" else (7, [moved.name]))


def test_forgotten_pairs_are_gone_from_the_copy_only(tmp_path: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    model = synthetic(tmp_path / "database.db", 4, 50)
    one, two, *_ = sorted(model.reg_image_ids())
    copy = without_pairs(tmp_path / "database.db", [(one, two)], tmp_path / "copy.db")
    left = []
    for path in (tmp_path / "database.db", copy):
        with pycolmap.Database.open(path) as opened:
            left.append(int(opened.num_verified_image_pairs()))
    assert left == [6, 5]


class _Image:
    """What the look at strays needs of a ``pycolmap.Image``."""

    def __init__(self, name: str, center: NDArray[np.float64]) -> None:
        self.name, self.frame_id, self._center = name, name, center

    def projection_center(self) -> NDArray[np.float64]:
        return self._center


class _Model:
    def __init__(self, images: dict[int, _Image]) -> None:
        self.images = images

    def reg_image_ids(self) -> list[int]:
        return sorted(self.images)

    def deregister_frame(self, name: str) -> None:
        self.images = {i: image for i, image in self.images.items() if image.name != name}


@pytest.mark.parametrize(("agreeing", "kept"), [(0.9, True), (0.3, False)])
def test_a_walk_begun_anew_elsewhere_stays_where_its_matches_vouch_for_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, agreeing: float, kept: bool
) -> None:
    # Eighty photos in a row, twelve of another row, and five at a hundred times the scale.
    row = np.arange(80)[:, None] * [0.5, 0.0, 0.0]
    other = np.arange(12)[:, None] * [0.5, 0.0, 0.0] + [0.0, 20.0, 0.0]
    lost = np.arange(5)[:, None] * [50.0, 0.0, 0.0] + [0.0, 900.0, 0.0]
    centers = np.concatenate([row, other, lost])
    walk = [f"{i:03d}.jpg" for i in range(len(centers))]
    images = {i + 1: _Image(name, center) for i, (name, center) in enumerate(zip(walk, centers, strict=True))}
    votes = [PairVote(first=k, second=80 + k, matches=100, agrees=k < 12 * agreeing) for k in range(12)]
    votes += [PairVote(first=k, second=92 + k, matches=100, agrees=False) for k in range(5)]
    monkeypatch.setattr("fsinfer.poses.verification.misplaced.pair_votes", lambda *_: (sorted(images), votes))
    model = _Model(images)
    dropped = drop_strays(model, walk, tmp_path / "database.db")
    assert set(walk[92:]) <= set(dropped)
    assert (set(walk[80:92]) & set(dropped) == set()) is kept
    # Without matches nothing vouches for it.
    model = _Model(images)
    assert set(drop_strays(model, walk)) == set(walk[80:])


def test_photos_that_were_placed_far_too_near_to_each_other_are_placed_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    database = tmp_path / "database.db"
    model = synthetic(database, 12, 200)
    (tmp_path / "images").mkdir()
    image_ids = sorted(model.reg_image_ids())
    walk = [model.images[i].name for i in image_ids]
    true = np.array([model.images[i].projection_center() for i in image_ids])
    shrunk = image_ids[4:8]
    for image_id in shrunk:
        image = model.images[image_id]
        pose = image.cam_from_world()
        beside = true[8] + 0.01 * (true[image_ids.index(image_id)] - true[8])
        turned = pycolmap.Rigid3d(pose.rotation, -pose.rotation.matrix() @ beside)
        model.frame(image.frame_id).set_cam_from_world(image.camera_id, turned)

    def still_shrunk(model: Any, *_: Any) -> list[int]:
        centers = {i: model.images[i].projection_center() for i in model.reg_image_ids()}
        near = np.linalg.norm(true[5] - true[4]) / 20.0
        return shrunk if np.linalg.norm(centers[shrunk[1]] - centers[shrunk[0]]) < near else []

    monkeypatch.setattr("fsinfer.poses.verification.repair.is_walk", lambda *_: True)
    monkeypatch.setattr("fsinfer.poses.verification.repair.shrunk_photos", still_shrunk)
    repaired, misplaced = repair(model, database, walk, tmp_path, PoseSettings(threads=1), silent)
    assert not any(misplaced.values())
    assert repaired.num_reg_images() == 12
    found = np.array([repaired.images[i].projection_center() for i in image_ids])
    ratio = np.linalg.norm(found[1:] - found[0], axis=1) / np.linalg.norm(true[1:] - true[0], axis=1)
    assert np.ptp(ratio) / ratio.mean() < 0.01


def test_photos_that_a_straightened_walk_lacks_are_mapped_on_from_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The mapper's own model is bent; of the straight one six photos are missing, and both judge themselves right."""
    database = tmp_path / "database.db"
    truth = synthetic(database, 24, 200)
    (tmp_path / "images").mkdir()
    image_ids = sorted(truth.reg_image_ids())
    walk = [truth.images[i].name for i in image_ids]
    straight = deepcopy(truth)
    drop(straight, image_ids[9:15])
    bent = deepcopy(truth)
    for image_id in image_ids[12:]:
        move(bent, image_id, [0.0, 0.4, 0.1], [0.6, 0.0, 0.2])
    folders: list[str] = []

    def counted(*given: Any, **options: Any) -> list[Any]:
        folders.append(given[2].name)
        return reconstruct(*given, **options)

    monkeypatch.setattr("fsinfer.poses.verification.repair.is_walk", lambda *_: True)
    monkeypatch.setattr("fsinfer.poses.verification.repair.cut_and_join", lambda *_: straight)
    monkeypatch.setattr("fsinfer.poses.verification.repair.reconstruct", counted)
    repaired, misplaced = repair(bent, database, walk, tmp_path, PoseSettings(threads=1), silent)
    assert folders == ["cut_again"]  # and the walk is not mapped three times more
    assert not any(misplaced.values())
    assert repaired.num_reg_images() == 24
    found, true = (np.array([model.images[i].projection_center() for i in image_ids]) for model in (repaired, truth))
    ratio = np.linalg.norm(found[1:] - found[0], axis=1) / np.linalg.norm(true[1:] - true[0], axis=1)
    assert np.ptp(ratio) / ratio.mean() < 0.01


@pytest.mark.parametrize(("missing", "mapped_again"), [(1, False), (2, True)])
def test_a_straightened_walk_is_mapped_again_only_where_much_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, missing: int, mapped_again: bool
) -> None:
    (tmp_path / "images").mkdir()
    database = tmp_path / "database.db"
    model = synthetic(database, 40, 100)
    image_ids = sorted(model.reg_image_ids())
    walk = [model.images[i].name for i in image_ids]
    straight = deepcopy(model)
    drop(straight, image_ids[5 : 5 + missing])
    # The mapper's own model is bent in the middle.
    for image_id in image_ids[20:]:
        move(model, image_id, [0.0, 0.4, 0.1], [0.6, 0.0, 0.2])
    again: list[Path] = []
    monkeypatch.setattr("fsinfer.poses.verification.repair.is_walk", lambda *_: True)
    monkeypatch.setattr("fsinfer.poses.verification.repair.cut_and_join", lambda *_: straight)

    def none(*given: Any, **_: Any) -> list[Any]:
        again.append(given[2])
        return []

    monkeypatch.setattr("fsinfer.poses.verification.repair.reconstruct", none)
    repaired, _ = repair(model, database, walk, tmp_path, PoseSettings(threads=1), silent)
    assert repaired.num_reg_images() == 40 - missing
    assert bool(again) is mapped_again
