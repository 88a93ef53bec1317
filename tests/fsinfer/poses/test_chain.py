"""A walk followed from photo to photo tells which of its other pairs are true."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from fsinfer.poses import colmap
from fsinfer.poses.chain import Judged, believed_share, follow_walk, judge_pairs, limit_of
from fsinfer.poses.colmap_calls import open_database
from fsinfer.poses.pairs import PairSettings
from fsinfer.poses.settings import PoseSettings
from fsinfer.poses.verification.point_votes import PointVote
from fsinfer.poses.view_graph import beginnings, pair_turns
from fsinfer.progress import silent
from tests.support.pairs_of_walk import FOCAL_PX, PHOTOS, POINTS, names, pairs_of_walk

pytest.importorskip("pycolmap")

RANK = {number + 1: number for number in range(PHOTOS)}
SETTINGS = PoseSettings(threads=1, pairs=PairSettings(overlap=4, exhaustive_up_to=5))
FURTHER = ((0, 9), (2, 11), (3, 12))


@pytest.fixture(autouse=True)
def images(tmp_path: Path) -> None:
    """COLMAP asks for the photos' folder and reads none of them."""
    (tmp_path / "images").mkdir()


def judged(database: Path, work: Path) -> Judged:
    begin = beginnings(pair_turns(database))
    return judge_pairs(database, RANK, names(), work, SETTINGS, silent, beginnings=begin)


def numbers(*pairs: tuple[int, int]) -> set[tuple[int, int]]:
    return {(first + 1, second + 1) for first, second in pairs}


@pytest.mark.parametrize("most", [None, 60])
def test_pairs_farther_apart_are_true_or_false_by_their_points(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, most: int | None
) -> None:
    """Of look-alikes elsewhere, and of litter that repeats along the epipolar lines, among neighbours too.

    The look-alikes have the first 60 points; a walk that is followed by few others must know those as well.
    """
    if most is not None:
        monkeypatch.setattr("fsinfer.poses.chain.MOST_MATCHES", most)
    along = {(0, 13): 2.0, (6, 10): 1.7}
    database = pairs_of_walk(tmp_path / "pairs.db", further=FURTHER, false={(1, 12): 2}, along=along)
    found = judged(database, tmp_path)
    # A photo of few neighbours has one pair that was written twice: the second one stands.
    assert found.false == numbers((1, 12), *along)
    near = [(i, j) for i in range(PHOTOS) for j in (i + 3, i + 4) if j < PHOTOS and (i, j) not in along]
    assert found.true == numbers(*near, *FURTHER)
    assert not list(tmp_path.glob("*close*"))


def test_a_walk_is_followed_over_a_weak_link_of_true_points(tmp_path: Path) -> None:
    """COLMAP asks for 30 points, and three photos in a row share 22 here."""
    few = {(6, 7): 22, (5, 7): 22, (6, 8): 22}
    database = pairs_of_walk(tmp_path / "pairs.db", known=True, few=few)
    parts = follow_walk(database, RANK, names(), tmp_path, SETTINGS, silent, beginnings=[])
    assert [part.num_reg_images() for part in parts] == [PHOTOS]


def test_a_walk_is_followed_by_few_matches_and_has_the_points_of_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[int] = []

    def reconstruct(database: Path, *arguments: Any, **options: Any) -> list[Any]:
        with open_database(database) as opened:
            given.append(max(len(geometry.inlier_matches) for geometry in opened.read_two_view_geometries()[1]))
        return list(colmap.reconstruct(database, *arguments, **options))

    monkeypatch.setattr("fsinfer.poses.chain.reconstruct", reconstruct)
    monkeypatch.setattr("fsinfer.poses.chain.MOST_MATCHES", 60)
    database = pairs_of_walk(tmp_path / "pairs.db", known=True)
    (part,) = follow_walk(database, RANK, names(), tmp_path, SETTINGS, silent, beginnings=[])
    assert given == [60]
    assert part.num_points3D() > 0.95 * POINTS
    assert [path.name for path in tmp_path.glob("*.db")] == ["pairs.db"]


def test_stretches_that_nothing_holds_together_are_followed_apart_and_judged_by_themselves(tmp_path: Path) -> None:
    few = {(i, j): 0 for i in range(PHOTOS) for j in range(i + 1, PHOTOS) if i < 7 <= j and j - i <= 2}
    database = pairs_of_walk(tmp_path / "pairs.db", known=True, few=few, further=((0, 9),), false={(0, 6): 9})
    # Begun with a pair that was given, COLMAP makes one stretch alone.
    for begin in ([], [(1, 3)]):
        parts = follow_walk(database, RANK, names(), tmp_path, SETTINGS, silent, beginnings=begin)
        assert sorted(part.num_reg_images() for part in parts) == [7, 7]
    found = judged(database, tmp_path)
    assert found.false == numbers((0, 6))
    assert all((first <= 7) == (second <= 7) for first, second in found.true)
    assert found.true


def test_a_map_that_most_neighbours_contradict_judges_nothing(tmp_path: Path) -> None:
    false = {(i, j): (i + 7) % PHOTOS for i in range(PHOTOS) for j in (i + 3, i + 4) if j < PHOTOS}
    database = pairs_of_walk(tmp_path / "pairs.db", known=True, neighbours=2, further=FURTHER, false=false)
    assert judged(database, tmp_path) == Judged()


def vote(first: int, second: int, **changed: float) -> PointVote:
    given = {"matches": 100, "points": 50, "error": 1.0 / FOCAL_PX} | changed
    return PointVote(first=first, second=second, **given)  # type: ignore[arg-type]


def test_what_few_points_say_is_neither_true_nor_false(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Part:
        def num_reg_images(self) -> int:
            return PHOTOS

    votes = [vote(1, 4), vote(2, 5, error=0.5), vote(3, 6, points=3), vote(4, 7, points=3, error=0.5), vote(1, 2)]
    monkeypatch.setattr("fsinfer.poses.chain.follow_walk", lambda *_, **__: [Part()])
    monkeypatch.setattr("fsinfer.poses.chain.point_votes", lambda *_: [*votes, vote(1, 5, matches=200)])
    found = judge_pairs(tmp_path / "pairs.db", RANK, names(), tmp_path, SETTINGS, silent, beginnings=[])
    assert found == Judged(true=frozenset({(1, 4), (1, 5)}), false=frozenset({(2, 5)}))


def test_a_pair_that_two_stretches_see_in_two_ways_is_not_judged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Part:
        def __init__(self, *votes: PointVote) -> None:
            self.votes = list(votes)

        def num_reg_images(self) -> int:
            return PHOTOS

    parts = [Part(vote(1, 4), vote(2, 5)), Part(vote(1, 4, error=0.5), vote(1, 5, matches=500))]
    monkeypatch.setattr("fsinfer.poses.chain.follow_walk", lambda *_, **__: parts)
    monkeypatch.setattr("fsinfer.poses.chain.point_votes", lambda part, _database: part.votes)
    found = judge_pairs(tmp_path / "pairs.db", RANK, names(), tmp_path, SETTINGS, silent, beginnings=[])
    assert found == Judged(true=frozenset({(2, 5), (1, 5)}))


def test_a_walk_is_begun_with_a_pair_that_it_has(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[dict[str, Any]] = []

    def reconstruct(*_: Any, **options: Any) -> list[Any]:
        asked.append(options)
        return []

    monkeypatch.setattr("fsinfer.poses.chain.reconstruct", reconstruct)
    database = pairs_of_walk(tmp_path / "pairs.db")
    given = [(1, 4), (5, 7), (1, 10), (3, 4)]
    assert follow_walk(database, RANK, names(), tmp_path, SETTINGS, silent, beginnings=given) == []
    (only,) = asked
    assert only["beginnings"] == [(5, 7), (3, 4)]


def test_the_share_that_is_believed_counts_matches_of_neighbours_with_points() -> None:
    assert believed_share([], RANK, 4) == 0.0
    votes = [vote(1, 4, matches=300), vote(2, 6, error=0.5), vote(1, 9, error=0.5), vote(3, 6, points=3, error=0.5)]
    assert believed_share(votes, RANK, 4) == 0.75


def test_who_walked_farther_may_have_drifted_by_more() -> None:
    assert limit_of(3, 8) == limit_of(8, 8) < limit_of(9, 8) == limit_of(100, 8) < limit_of(150, 8)
    assert limit_of(1000, 8) == limit_of(500, 8) <= 0.1
