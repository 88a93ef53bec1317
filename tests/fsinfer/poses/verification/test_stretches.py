"""A walk is cut where photos that follow each other contradict their places, and nowhere else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fsinfer.poses.verification.pair_votes import PairVote
from fsinfer.poses.verification.stretches import stretches_of_walk, torn_off

PHOTOS, NEIGHBOURS = 40, 8


def votes(wrong: set[int], *, matches: int = 60, loops: int = 0) -> list[PairVote]:
    """Every pair of neighbours, for its places unless a bend lies between them; and pairs far apart against theirs."""
    found = [
        PairVote(first=i, second=j, matches=matches, agrees=not any(i <= cut < j for cut in wrong))
        for i in range(PHOTOS)
        for j in range(i + 1, min(i + NEIGHBOURS + 1, PHOTOS))
    ]
    return found + [PairVote(first=0, second=PHOTOS - 1 - k, matches=900, agrees=False) for k in range(loops)]


def sizes(given: list[PairVote]) -> list[int]:
    stretch = stretches_of_walk(given, PHOTOS, NEIGHBOURS)
    assert (np.diff(stretch) >= 0).all()
    return [int(n) for n in np.bincount(stretch)]


def test_a_walk_without_contradiction_is_one_stretch() -> None:
    assert sizes(votes(set())) == [PHOTOS]


@pytest.mark.parametrize("bends", [{9}, {9, 20}, {0, 5, 6, 25}])
def test_it_is_cut_at_each_bend_and_not_beside_it(bends: set[int]) -> None:
    ends = [-1, *sorted(bends), PHOTOS - 1]
    assert sizes(votes(bends)) == [int(n) for n in np.diff(ends)]


def test_false_loops_are_no_cut_and_few_matches_are_none() -> None:
    assert sizes(votes(set(), loops=8)) == [PHOTOS]
    assert sizes(votes({9}, matches=2)) == [PHOTOS]


def test_what_speaks_for_a_place_is_weighed_against_what_speaks_against_it() -> None:
    # The false matches that bent the walk agree with the bend: as many as half of the true ones are too many to cut.
    for bent, left in ((600, [10, 30]), (1300, [PHOTOS])):
        false = [PairVote(first=8, second=11, matches=bent, agrees=True)]
        assert sizes(votes({9}) + false) == left


def test_a_single_photo_and_none() -> None:
    assert stretches_of_walk([], 1, NEIGHBOURS).tolist() == [0]
    assert stretches_of_walk([], 0, NEIGHBOURS).tolist() == []


def torn(given: list[PairVote]) -> list[int]:
    return [int(photo) for photo in np.flatnonzero(torn_off(given, PHOTOS, NEIGHBOURS))]


@pytest.mark.parametrize(
    ("bends", "expected"),
    [
        (set(), []),
        ({32}, list(range(33, 40))),  # the end of the walk, where something looks alike
        ({9, 16}, list(range(10, 17))),
        ({25}, []),  # more than a fifth: nobody knows which of the two is right
        ({3, 25}, [0, 1, 2, 3]),
    ],
)
def test_a_short_stretch_is_torn_off_by_its_neighbours(bends: set[int], expected: list[int]) -> None:
    """Seven photos stood 4.3 m off and vouched for each other; each by itself had most matches for its place."""
    assert torn(votes(bends)) == expected


@pytest.mark.parametrize(("matches", "expected"), [(15, []), (24, list(range(33, 40)))])
def test_a_walk_begun_anew_shares_little_with_what_came_before(matches: int, expected: list[int]) -> None:
    """Its false matches with the photos before contradict it, too: a quarter of what neighbours share is not enough."""
    given = [vote if vote.agrees else replace(vote, matches=matches) for vote in votes({32})]
    assert sizes(given) == [33, 7]
    assert torn(given) == expected


def test_one_pair_that_looks_alike_speaks_for_no_neighbours() -> None:
    given = [vote for vote in votes({32}) if vote.agrees]
    assert torn([*given, PairVote(first=32, second=33, matches=400, agrees=False)]) == []


def test_of_few_photos_none_is_torn_off() -> None:
    assert not torn_off([], 1, NEIGHBOURS).any()
    assert len(torn_off([], 0, NEIGHBOURS)) == 0
