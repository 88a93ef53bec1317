"""A walk is cut where photos that follow each other contradict their places, and nowhere else."""

from __future__ import annotations

import numpy as np
import pytest

from fsinfer.poses.verification.pair_votes import PairVote
from fsinfer.poses.verification.stretches import stretches_of_walk

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
