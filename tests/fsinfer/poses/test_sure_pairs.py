"""A walk is mapped without the pairs that contradict it, and true ones among them come in afterwards."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fsinfer.poses.chain import Judged
from fsinfer.poses.colmap import reconstruct
from fsinfer.poses.colmap_calls import open_database
from fsinfer.poses.matches import inliers_by_rank
from fsinfer.poses.pairs import MIN_INLIERS, PairSettings
from fsinfer.poses.settings import PoseSettings
from fsinfer.poses.sure_pairs import SurePairs, map_sure, put_back, sure_pairs, with_more
from fsinfer.poses.verification.misplaced import without_pairs
from fsinfer.poses.verification.point_votes import PointVote
from fsinfer.poses.view_graph import pair_turns
from fsinfer.progress import silent
from tests.support.pairs_of_walk import FOCAL_PX, PHOTOS, names, pairs_of_walk, pixels, pose

pytest.importorskip("pycolmap")

FALSE = {(0, 13): 3, (1, 12): 2}
FURTHER = ((0, 9), (2, 11), (3, 12))
#: A walk, however few its photos are.
SETTINGS = PoseSettings(threads=1, pairs=PairSettings(overlap=4, exhaustive_up_to=5))


@pytest.fixture(autouse=True)
def images(tmp_path: Path) -> None:
    """COLMAP asks for the photos' folder and reads none of them."""
    (tmp_path / "images").mkdir()


def counting(database: Path) -> set[tuple[int, int]]:
    """Pairs of ranks that count."""
    return {pair for pair, found in inliers_by_rank(database, names()).items() if found >= MIN_INLIERS}


def test_the_mapper_is_given_the_pairs_that_do_not_contradict_each_other(tmp_path: Path) -> None:
    database = pairs_of_walk(tmp_path / "pairs.db", focal_px=0.8 * FOCAL_PX, further=FURTHER, false=FALSE)
    every = counting(database)
    sure = sure_pairs(database, names(), tmp_path, SETTINGS, silent)
    assert set(sure.left_out) == {(1, 14), (2, 13)}
    assert counting(sure.database) == every - set(FALSE)
    assert counting(database) == every  # the others are kept for later
    assert sure.beginnings


def test_pairs_that_are_known_to_be_false_are_gone_for_good_and_the_doubted_at_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    database = pairs_of_walk(tmp_path / "pairs.db", further=FURTHER, false=FALSE)
    every = counting(database)
    asked: list[Path] = []

    def turns(given: Path) -> Any:
        asked.append(given)
        return pair_turns(given)

    monkeypatch.setattr("fsinfer.poses.sure_pairs.pair_turns", turns)
    for known, matched, left_out in (
        (Judged(), every, {(1, 14), (2, 13)}),
        (Judged(false=frozenset({(1, 14)})), every - {(0, 13)}, {(1, 14), (2, 13)}),
        (Judged(true=frozenset({(1, 14)})), every, {(2, 13)}),  # whatever it turns
    ):
        monkeypatch.setattr("fsinfer.poses.sure_pairs.judge_pairs", lambda *_, known=known, **__: known)
        asked.clear()
        sure = sure_pairs(database, names(), tmp_path, SETTINGS, silent)
        assert set(sure.left_out) == left_out
        assert counting(sure.matched) == matched
        assert counting(sure.database) == every - {(first - 1, second - 1) for first, second in left_out}
        # Directions are told anew without what is false.
        assert asked == [database, *([sure.matched] if known.false else [])]


def test_a_pair_with_few_points_brings_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    few = PointVote(first=1, second=10, matches=100, points=7, error=0.0)
    monkeypatch.setattr("fsinfer.poses.sure_pairs.point_votes", lambda *_: [few])
    assert put_back(None, [(1, 10)], tmp_path / "pairs.db", tmp_path) == 0


@pytest.mark.parametrize("settings", [PoseSettings(threads=1, mapper="global"), PoseSettings(threads=1)])
def test_photos_in_no_order_and_the_global_mapper_keep_all_pairs(settings: PoseSettings, tmp_path: Path) -> None:
    # Those that follow each other match no better than others: no walk.
    across = [(i, j) for i in range(PHOTOS) for j in range(i + 2, PHOTOS, 2)]
    database = pairs_of_walk(tmp_path / "pairs.db", neighbours=0, further=across)
    assert sure_pairs(database, names(), tmp_path, settings, silent) == SurePairs(database=database, matched=database)


def test_the_order_of_walking_is_told_to_the_focal_length_and_none_where_there_is_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[dict[int, int] | None] = []
    monkeypatch.setattr("fsinfer.poses.sure_pairs.calibrate", lambda _database, _work, rank: told.append(rank))
    sure_pairs(pairs_of_walk(tmp_path / "walk.db"), names(), tmp_path, SETTINGS, silent)
    across = [(i, j) for i in range(PHOTOS) for j in range(i + 2, PHOTOS, 2)]
    heap = pairs_of_walk(tmp_path / "heap.db", neighbours=0, further=across)
    sure_pairs(heap, names(), tmp_path, PoseSettings(threads=1), silent)
    assert told == [{number + 1: number for number in range(PHOTOS)}, None]


def mapped(sure: SurePairs, work: Path) -> Any:
    (model,) = reconstruct(sure.database, work, work / "models", SETTINGS, silent, beginnings=sure.beginnings)
    return model


@pytest.mark.parametrize("mapper", ["incremental", "global"])
def test_sure_pairs_are_mapped_by_some_matches_and_have_the_points_of_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mapper: str
) -> None:
    """The global mapper is given all of them."""
    given: list[int] = []

    def counted(database: Path, *arguments: Any, **options: Any) -> list[Any]:
        with open_database(database) as opened:
            given.append(max(len(geometry.inlier_matches) for geometry in opened.read_two_view_geometries()[1]))
        return reconstruct(database, *arguments, **options)

    monkeypatch.setattr("fsinfer.poses.sure_pairs.reconstruct", counted)
    monkeypatch.setattr("fsinfer.poses.sure_pairs.MOST_MATCHES", 60)
    database = pairs_of_walk(tmp_path / "pairs.db", known=True)
    every = len(pixels(0))
    settings = replace(SETTINGS, mapper=mapper)
    sure = SurePairs(database=database, matched=database)
    (model,) = map_sure(sure, tmp_path / "images", tmp_path / "models", settings, silent)
    assert model.num_reg_images() == PHOTOS
    assert model.num_points3D() > 0.95 * every
    assert given == [60] if mapper == "incremental" else given[0] > 200
    assert [path.name for path in tmp_path.glob("*.db")] == ["pairs.db"]


def test_a_true_pair_that_was_left_out_brings_its_observations_and_a_false_one_none(tmp_path: Path) -> None:
    database = pairs_of_walk(tmp_path / "pairs.db", further=FURTHER, false=FALSE)
    sure = sure_pairs(database, names(), tmp_path, SETTINGS, silent)
    model = mapped(sure, tmp_path)
    assert model.num_reg_images() == PHOTOS
    before = model.compute_num_observations()
    assert put_back(model, sure.left_out, database, tmp_path) == 0
    assert model.compute_num_observations() == before
    # Most of photo 9 forgotten, its pair with photo 0, taken for one left out, tells where it sees the points.
    number = {model.images[i].name: i for i in model.reg_image_ids()}["09.jpg"]
    for index, feature in enumerate(model.images[number].points2D):
        if feature.has_point3D() and index < 200:
            model.delete_observation(number, index)
    assert put_back(model, [(1, 10), *sure.left_out], database, tmp_path) > 150
    assert model.images[number].num_points3D > 150


def test_a_beginning_is_taken_and_a_bad_one_passed_over(tmp_path: Path) -> None:
    database = pairs_of_walk(tmp_path / "pairs.db")
    placed: list[int] = []

    def progress(done: int, _total: int, _step: str) -> None:
        placed.append(done)

    # Photos that have no match cannot begin.
    given = [(1, 14), (1, 3)]
    models = reconstruct(database, tmp_path, tmp_path / "models", SETTINGS, progress, beginnings=given)
    assert [model.num_reg_images() for model in models] == [PHOTOS]
    assert max(placed) == PHOTOS
    for image_id in models[0].reg_image_ids():
        turn = models[0].images[image_id].cam_from_world().rotation.matrix()
        first = models[0].images[1].cam_from_world().rotation.matrix()
        true = pose(image_id - 1)[0] @ pose(0)[0].T
        np.testing.assert_allclose(turn @ first.T, true, atol=0.02)


def test_a_walk_is_mapped_again_with_true_pairs_that_its_drift_hid_and_not_for_a_few(tmp_path: Path) -> None:
    database = pairs_of_walk(tmp_path / "pairs.db", further=FURTHER, false=FALSE)
    sure = sure_pairs(database, names(), tmp_path, SETTINGS, silent)
    assert {(1, 14), (2, 13)} <= set(sure.left_out)
    model = mapped(sure, tmp_path)

    def more_of(given: SurePairs, settings: PoseSettings = SETTINGS) -> SurePairs | None:
        return with_more(model, given, database, names(), tmp_path, settings)

    assert more_of(sure) is None
    assert more_of(replace(sure, left_out=())) is None
    hidden = [(1, 10), (3, 12), (4, 13)]
    narrow = SurePairs(
        database=without_pairs(sure.database, hidden, tmp_path / "narrow.db"),
        matched=sure.matched,
        left_out=tuple(sorted([*sure.left_out, *hidden])),
        false=tuple(sorted([*sure.false, hidden[0]])),
        beginnings=sure.beginnings,
    )
    assert more_of(replace(narrow, left_out=tuple(hidden[:1]))) is None
    more = more_of(narrow)
    assert more is not None
    assert more.left_out == sure.left_out
    assert more.false == sure.false
    assert counting(more.database) == counting(sure.database)
    # What is doubted only is kept for later.
    assert counting(more.matched) == counting(database) - {(first - 1, second - 1) for first, second in sure.false}
    assert more.beginnings == sure.beginnings


def test_neighbours_come_back_by_the_narrower_limit_of_neighbours(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Those that close loops may be off by what drift is left."""
    database = pairs_of_walk(tmp_path / "pairs.db", further=FURTHER)
    votes = [PointVote(first=i, second=i + 4, matches=90, points=90, error=0.03) for i in range(1, 11)]
    monkeypatch.setattr("fsinfer.poses.sure_pairs.point_votes", lambda *_: votes)
    left_out = tuple((vote.first, vote.second) for vote in votes)
    sure = SurePairs(database=database, matched=database, left_out=left_out, false=left_out)
    assert with_more(None, sure, database, names(), tmp_path, SETTINGS) is None
    loose = replace(SETTINGS, pairs=PairSettings(overlap=3, exhaustive_up_to=5))
    more = with_more(None, sure, database, names(), tmp_path, loose)
    assert more is not None
    assert more.left_out == more.false == ()
