"""A walk's parts and boards end in one model, and what is mapped apart has the calibration that the rest knows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fsinfer.geometry.similarity import apply, fit_similarity
from fsinfer.poses.boards import BoardSighting
from fsinfer.poses.colmap import with_calibration
from fsinfer.poses.mapping import MappedWalk, Walk, map_walk, tells_focal_length
from fsinfer.poses.settings import PoseSettings, ThoroughSettings
from fsinfer.poses.sure_pairs import SurePairs
from fsinfer.progress import silent
from tests.fsinfer.poses.joining.test_parts import (
    FIRST,
    PHOTOS,
    SECOND,
    WITHIN,
    boards,
    errors,
    matched,
    names,
    part_of,
    sightings_of,
    walked,
)

pycolmap = pytest.importorskip("pycolmap")


def looking(*headings_deg: float) -> Any:
    model = pycolmap.Reconstruction()
    camera = pycolmap.Camera(model="SIMPLE_RADIAL", width=100, height=80, params=[90.0, 50.0, 40.0, 0.01], camera_id=1)
    model.add_camera_with_trivial_rig(camera)
    for number, heading in enumerate(headings_deg):
        turn = pycolmap.Rotation3d(Rotation.from_euler("y", heading, degrees=True).as_quat())
        image = pycolmap.Image(f"{number:02d}.jpg", np.zeros((0, 2)), 1, number + 1)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(turn, np.array([0.0, 0.0, number])))
    return model


def test_who_only_walks_ahead_does_not_know_the_focal_length() -> None:
    assert not tells_focal_length(looking(0, 5, -8, 10, 20))
    assert tells_focal_length(looking(0, 20, 40, 70))


def test_a_copy_of_the_database_gets_the_calibration_and_the_database_keeps_its_own(tmp_path: Path) -> None:
    given = pycolmap.Camera(model="SIMPLE_RADIAL", width=100, height=80, params=[120.0, 50.0, 40.0, 0.0], camera_id=1)
    with pycolmap.Database.open(tmp_path / "given.db") as opened:
        opened.write_camera(given, use_camera_id=True)
    model = looking(0, 90)
    copy = with_calibration(tmp_path / "given.db", [model.cameras[1]], tmp_path / "alone.db")
    with pycolmap.Database.open(copy) as opened:
        np.testing.assert_allclose(opened.read_camera(1).params, [90.0, 50.0, 40.0, 0.01])
    with pycolmap.Database.open(tmp_path / "given.db") as opened:
        np.testing.assert_allclose(opened.read_camera(1).params, [120.0, 50.0, 40.0, 0.0])
    assert not model.cameras[1].has_prior_focal_length  # the model is not changed


#: Two are enough to join parts.
BOARDS = boards((0.8, 0, 0), (-0.7, 0.2, 0.3))


def as_it_is(model: Any) -> Any:
    return model


def mapped_walk(
    work: Path,
    patch: pytest.MonkeyPatch,
    parts: Sequence[Any],
    sightings: Sequence[BoardSighting],
    *,
    mapper: str = "incremental",
    triangulated: Callable[[Any], Any] = as_it_is,
    min_share: float = 0.0,
) -> MappedWalk:
    """The walk of these parts, the largest first, as if COLMAP had made them of photographs."""
    matched(work / "database.db", parts[0], {})

    def reconstruct(*_: Any, start: Any = None, only: Sequence[str] = (), **__: Any) -> list[Any]:
        if start is not None:
            return []  # nothing more is found from there on
        if mapper == "global":
            return list(parts)
        # The further parts are mapped from the photos alone that have no place in the first.
        return [part for part in parts[1:] if set(files_of(part)) <= set(only)] if only else [parts[0]]

    def find_boards(_images: Path, files: Sequence[str], **_: Any) -> list[BoardSighting]:
        return [sighting for sighting in sightings if sighting.file in files]

    for step in ("extract_features", "match_features"):
        patch.setattr(f"fsinfer.poses.mapping.{step}", lambda *_: None)
    patch.setattr("fsinfer.poses.mapping.find_boards", find_boards)
    patch.setattr("fsinfer.poses.mapping.reconstruct", reconstruct)
    patch.setattr("fsinfer.poses.mapping.map_sure", lambda _sure, *_, start=None: reconstruct(start=start))
    patch.setattr("fsinfer.poses.mapping.triangulate", lambda model, *_: triangulated(model))
    files = tuple(names(range(PHOTOS)))
    # Some photos belong to no part, and those are not looked at again: there are no pictures to look at.
    settings = PoseSettings(mapper=mapper, thorough=ThoroughSettings(min_share=min_share), threads=1)
    return map_walk(Walk(files=files, cameras={"phone": files}), work / "photos", work, settings, silent)


def astray(model: Any, file: str) -> Any:
    """The model with a photo kilometres away."""
    left = deepcopy(model)
    image = next(image for image in left.images.values() if image.name == file)
    pose = pycolmap.Rigid3d(image.cam_from_world().rotation, np.array([0.0, 0.0, 1e6]))
    image.frame.set_cam_from_world(image.camera_id, pose)
    return left


def files_of(model: Any) -> list[str]:
    return sorted(model.images[i].name for i in model.reg_image_ids())


def corners_of(model: Any, truth: Any) -> list[tuple[NDArray[np.float64], list[str]]]:
    """The points that the model has beyond those of ``truth``: where they lie in its frame, and who sees them."""
    ids = sorted(model.reg_image_ids())
    true_from_model = fit_similarity(
        np.array([model.images[i].projection_center() for i in ids]),
        np.array([truth.images[i].projection_center() for i in ids]),
    )
    assert true_from_model is not None
    keypoints = truth.images[ids[0]].num_points2D()
    found = []
    for number in sorted(model.point3D_ids()):
        point = model.points3D[number]
        elements = [element for element in point.track.elements if element.point2D_idx >= keypoints]
        if elements:
            assert len(elements) == point.track.length()
            seen_by = sorted(model.images[element.image_id].name for element in elements)
            found.append((apply(true_from_model, point.xyz[None])[0], seen_by))
    return found


def assert_boards_tie(model: Any, truth: Any) -> None:
    """Each corner is one point that all photos of the walk see, where the board hangs."""
    corners = corners_of(model, truth)
    assert [seen_by for _, seen_by in corners] == 8 * [names(WITHIN)]
    np.testing.assert_allclose([xyz for xyz, _ in corners], np.vstack([BOARDS[0], BOARDS[1]]), atol=1e-3)


def test_the_corners_of_boards_are_points_of_the_model_that_is_adjusted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    truth = walked()
    mapped = mapped_walk(tmp_path, monkeypatch, [part_of(truth, WITHIN)], sightings_of(truth, BOARDS, WITHIN))
    assert_boards_tie(mapped.model, truth)
    assert mapped.model.num_points3D() == truth.num_points3D() + 8
    assert (mapped.joined, mapped.apart) == ((), ())


@pytest.mark.parametrize("mapper", ["incremental", "global"])
def test_a_part_that_boards_tie_ends_in_one_model_with_the_rest(
    mapper: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    truth = walked()
    parts = [part_of(truth, FIRST), part_of(truth, SECOND, moved=True)]
    mapped = mapped_walk(tmp_path, monkeypatch, parts, sightings_of(truth, BOARDS, WITHIN), mapper=mapper)
    assert files_of(mapped.model) == names(WITHIN)
    assert errors(mapped.model, truth).max() < 1e-3
    assert mapped.joined == tuple(names(SECOND))
    assert mapped.apart == ()
    assert not any(mapped.misplaced.values())
    # The boards are looked for once more in the joined model: their corners hold both parts together.
    assert_boards_tie(mapped.model, truth)


@pytest.mark.parametrize("known", [2, 1])
def test_only_a_part_that_boards_do_not_tie_is_looked_at_again(
    known: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class LookedAgain(Exception):
        pass

    def rematch(*_: Any) -> Path:
        raise LookedAgain

    monkeypatch.setattr("fsinfer.poses.mapping.rematch", rematch)
    truth = walked()
    parts = [part_of(truth, FIRST), part_of(truth, SECOND, moved=True)]
    seen = [sighting for sighting in sightings_of(truth, BOARDS, WITHIN) if sighting.number < known]
    if known < 2:
        with pytest.raises(LookedAgain):
            mapped_walk(tmp_path, monkeypatch, parts, seen, min_share=len(WITHIN) / PHOTOS)
    else:
        mapped = mapped_walk(tmp_path, monkeypatch, parts, seen, min_share=len(WITHIN) / PHOTOS)
        assert mapped.joined == tuple(names(SECOND))


def test_parts_that_fewer_boards_tie_are_joined_too_in_the_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """When nothing was looked at again; a photo that is astray after that is joined no more."""
    monkeypatch.setattr("fsinfer.poses.mapping._SURE_BOARDS", 3)
    truth, third = walked(), range(3)
    three = boards((0.8, 0, 0), (-0.7, 0.2, 0.3), (0.0, -0.6, 0.1))
    seen = sightings_of(truth, three, WITHIN) + sightings_of(truth, {0: three[0], 1: three[1]}, third)

    def parts() -> list[Any]:
        return [part_of(truth, FIRST), part_of(truth, SECOND, moved=True), part_of(truth, third, moved=True)]

    mapped = mapped_walk(tmp_path, monkeypatch, parts(), seen)
    assert mapped.joined == (*names(third), *names(SECOND))
    assert errors(mapped.model, truth).max() < 1e-3

    rounds: list[int] = []

    def triangulated(model: Any) -> Any:
        rounds.append(model.num_reg_images())
        return astray(model, "08.jpg") if len(rounds) == 2 else model

    (tmp_path / "again").mkdir()
    mapped = mapped_walk(tmp_path / "again", monkeypatch, parts(), seen, triangulated=triangulated)
    assert rounds == [7, 10]
    assert mapped.joined == (*names(third), "07.jpg", "09.jpg")
    assert mapped.misplaced["astray"] == ["08.jpg"]


def test_a_walk_is_mapped_and_judged_by_the_pairs_that_are_sure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    truth = walked()
    given = {name: tmp_path / f"{name}.db" for name in ("first", "first_matched", "more", "more_matched")}
    first = SurePairs(database=given["first"], matched=given["first_matched"], left_out=((1, 2), (1, 3)))
    second = SurePairs(database=given["more"], matched=given["more_matched"], left_out=((1, 2),))
    # A second map that has fewer photos is none.
    for more, photos in ((None, WITHIN), (second, WITHIN), (second, FIRST)):
        used: list[tuple[str, Any]] = []
        maps = {first.database: WITHIN, second.database: photos}

        def map_sure(
            sure: SurePairs, *_: Any, used: list[tuple[str, Any]] = used, maps: Any = maps, **__: Any
        ) -> list[Any]:
            used.append(("mapped", sure.database))
            return [part_of(truth, maps[sure.database])]

        def repair(model: Any, database: Path, *_: Any, used: list[tuple[str, Any]] = used, **__: Any) -> Any:
            used.append(("repaired", database))
            return model, {}

        def put_back(_model: Any, pairs: Any, database: Path, *_: Any, used: list[tuple[str, Any]] = used) -> int:
            used.append(("put back", (pairs, database)))
            return 0

        with monkeypatch.context() as patch:
            for step in ("extract_features", "match_features"):
                patch.setattr(f"fsinfer.poses.mapping.{step}", lambda *_: None)
            patch.setattr("fsinfer.poses.mapping.sure_pairs", lambda *_: first)
            patch.setattr("fsinfer.poses.mapping.with_more", lambda *_, more=more: more)
            patch.setattr("fsinfer.poses.mapping.find_boards", lambda *_, **__: [])
            for name, stub in (("map_sure", map_sure), ("repair", repair), ("put_back", put_back)):
                patch.setattr(f"fsinfer.poses.mapping.{name}", stub)
            files = tuple(names(WITHIN))
            settings = PoseSettings(threads=1)
            map_walk(Walk(files=files, cameras={"phone": files}), tmp_path, tmp_path, settings, silent)
        last = second if more is not None and photos == WITHIN else first
        assert used == [
            ("mapped", first.database),
            *([("mapped", more.database)] if more else []),
            ("repaired", last.matched),
            ("put back", (last.left_out, tmp_path / "database.db")),
        ]


def test_a_part_that_nothing_ties_is_named_by_its_photos(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    truth = walked()
    parts = [part_of(truth, FIRST), part_of(truth, SECOND, moved=True)]
    mapped = mapped_walk(tmp_path, monkeypatch, parts, sightings_of(truth, BOARDS, FIRST))
    assert files_of(mapped.model) == names(FIRST)
    assert (mapped.joined, mapped.apart) == ((), (tuple(names(SECOND)),))


def test_a_photo_that_is_astray_in_the_joined_model_is_taken_out_and_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def triangulated(model: Any) -> Any:
        """As the adjustment after joining may leave it: one photo kilometres away."""
        return astray(model, "08.jpg")

    truth = walked()
    parts = [part_of(truth, FIRST), part_of(truth, SECOND, moved=True)]
    seen = sightings_of(truth, BOARDS, WITHIN)
    mapped = mapped_walk(tmp_path, monkeypatch, parts, seen, triangulated=triangulated)
    assert files_of(mapped.model) == [file for file in names(WITHIN) if file != "08.jpg"]
    assert mapped.joined == ("07.jpg", "09.jpg")
    assert mapped.misplaced["astray"] == ["08.jpg"]
