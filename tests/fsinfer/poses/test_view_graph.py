"""What pairs say together: the focal length, which of them cannot be true, and where to begin."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fsinfer.poses.colmap_calls import open_database
from fsinfer.poses.view_graph import PairTurn, _Told, _told_focal, beginnings, calibrate, contradicting, pair_turns
from tests.support.pairs_of_walk import FOCAL_PX, PHOTOS, pairs_of_walk, pose

pytest.importorskip("pycolmap")

RANK = {number + 1: number for number in range(PHOTOS)}
#: Photo 13 shows what photo 3 sees, and 12 what 2 sees.
FALSE = {(0, 13): 3, (1, 12): 2}
FURTHER = ((0, 9), (2, 11), (3, 12))


def focal_px(database: Path) -> tuple[float, bool]:
    with open_database(database) as opened:
        (camera,) = opened.read_all_cameras()
    return float(camera.params[0]), bool(camera.has_prior_focal_length)


@pytest.mark.parametrize("rank", [None, RANK])
@pytest.mark.parametrize("guess", [0.8, 1.25])
def test_the_pairs_tell_a_focal_length_that_nobody_knows(
    guess: float, rank: dict[int, int] | None, tmp_path: Path
) -> None:
    database = pairs_of_walk(tmp_path / "pairs.db", focal_px=guess * FOCAL_PX)
    calibrate(database, tmp_path, rank)
    found, known = focal_px(database)
    assert found == pytest.approx(FOCAL_PX, rel=0.02)
    assert known
    assert sorted(tmp_path.iterdir()) == [database]


@pytest.mark.parametrize(
    ("by_all", "by_next", "taken"),
    [
        ((1.05, True), (1.0, True), 1.05),
        ((1.3, True), (1.0, True), 1.0),
        ((0.7, True), (1.0, True), 1.0),
        ((1.3, False), (1.0, True), 1.0),
        ((1.3, True), (1.0, False), 1.3),
        ((1.3, False), (1.0, False), None),
    ],
)
def test_photos_that_follow_each_other_are_believed_where_all_pairs_tell_another_focal_length(
    by_all: tuple[float, bool],
    by_next: tuple[float, bool],
    taken: float | None,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    database = pairs_of_walk(tmp_path / "pairs.db", focal_px=2.0 * FOCAL_PX)
    with open_database(database) as opened:
        (camera,) = opened.read_all_cameras()

    def told(_database: Path, _work: Path, counts: Callable[[tuple[int, int]], bool]) -> dict[int, _Told]:
        share, believed = by_all if counts((1, 3)) else by_next
        found = copy.deepcopy(camera)
        found.params = [share * FOCAL_PX, *camera.params[1:]]
        return {camera.camera_id: _Told(camera=found, believed=believed)}

    monkeypatch.setattr("fsinfer.poses.view_graph._told_focal", told)
    calibrate(database, tmp_path, RANK)
    assert focal_px(database) == ((2.0 if taken is None else taken) * FOCAL_PX, taken is not None)


def test_next_photos_alone_tell_the_focal_length_too(tmp_path: Path) -> None:
    database = pairs_of_walk(tmp_path / "pairs.db", focal_px=0.8 * FOCAL_PX)
    told = _told_focal(database, tmp_path, lambda pair: abs(RANK[pair[0]] - RANK[pair[1]]) == 1)
    (found,) = told.values()
    assert found.believed
    assert found.camera.params[0] == pytest.approx(FOCAL_PX, rel=0.03)
    assert sorted(tmp_path.iterdir()) == [database]


def test_a_focal_length_that_is_known_stays(tmp_path: Path) -> None:
    database = pairs_of_walk(tmp_path / "pairs.db", focal_px=1.1 * FOCAL_PX, known=True)
    calibrate(database, tmp_path)
    assert focal_px(database)[0] == 1.1 * FOCAL_PX


def test_few_pairs_tell_nothing(tmp_path: Path) -> None:
    database = pairs_of_walk(tmp_path / "pairs.db", focal_px=0.8 * FOCAL_PX, neighbours=0, further=((0, 2), (1, 4)))
    calibrate(database, tmp_path)
    assert focal_px(database) == (0.8 * FOCAL_PX, False)


def test_each_pair_tells_the_turn_between_its_photos(tmp_path: Path) -> None:
    turns = pair_turns(pairs_of_walk(tmp_path / "pairs.db"))
    assert len(turns) == 4 * PHOTOS - 10
    for turn in turns:
        first, second = pose(RANK[turn.first])[0], pose(RANK[turn.second])[0]
        np.testing.assert_allclose(turn.turn, second @ first.T, atol=0.01)
        assert turn.differs_deg < 1.0
        steps = RANK[turn.second] - RANK[turn.first]
        assert turn.angle_deg == pytest.approx(12 * steps, abs=3)
        assert not turn.flat


def test_pairs_that_turn_against_all_others_are_named_and_no_true_ones(tmp_path: Path) -> None:
    turns = pair_turns(pairs_of_walk(tmp_path / "pairs.db", further=FURTHER, false=FALSE))
    differs = {(RANK[turn.first], RANK[turn.second]): turn.differs_deg for turn in turns}
    assert min(differs[pair] for pair in FALSE) > 60
    assert max(differs[pair] for pair in FURTHER) < 3
    assert set(contradicting(turns, RANK, 4)) == {(1, 14), (2, 13)}


def test_neighbours_are_believed_whatever_they_turn(tmp_path: Path) -> None:
    turns = pair_turns(pairs_of_walk(tmp_path / "pairs.db", further=(*FURTHER, (0, 12), (1, 13)), false=FALSE))
    assert set(contradicting(turns, RANK, 10)) == {(1, 14), (2, 13)}
    assert contradicting(turns, RANK, 11) == [(1, 14)]


def test_where_most_contradict_it_is_the_directions_that_are_wrong(tmp_path: Path) -> None:
    turns = pair_turns(pairs_of_walk(tmp_path / "pairs.db", further=FURTHER[:1], false=FALSE))
    assert contradicting(turns, RANK, 4) == []


def turn_of(first: int, **changed: float) -> PairTurn:
    given = {"matches": 100, "ahead": 0.1, "angle_deg": 25.0, "flat": False, "differs_deg": 0.5} | changed
    return PairTurn(first=first, second=first + 1, turn=np.eye(3), **given)  # type: ignore[arg-type]


def test_a_mapper_begins_with_many_matches_at_a_wide_angle() -> None:
    good = [turn_of(1, matches=50), turn_of(2, matches=90), turn_of(3), turn_of(4, matches=20)]
    assert beginnings(good) == [(3, 4), (2, 3), (1, 2)]
    bad = [
        turn_of(5, matches=500, differs_deg=3.0),
        turn_of(6, matches=500, differs_deg=float("nan")),
        turn_of(7, matches=500, angle_deg=15.0),
        turn_of(8, matches=500, ahead=0.97),
        turn_of(9, matches=500, flat=True),
    ]
    assert beginnings([*bad, *good]) == beginnings(good)
