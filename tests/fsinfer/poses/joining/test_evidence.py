"""What is enough to believe the place of a part."""

from __future__ import annotations

from functools import partial

import pytest

from fsinfer.poses.joining.evidence import Evidence


def evidence(
    boards: int = 0,
    sightings: int = 0,
    missed: int = 0,
    points: int = 0,
    goes_on: bool | None = None,
    ordered: bool = True,
) -> Evidence:
    return Evidence(
        boards=boards, sightings=sightings, missed=missed, points=points, photos=5, goes_on=goes_on, ordered=ordered
    )


@pytest.mark.parametrize(
    ("goes_on", "ordered", "believed"),
    [(True, True, True), (None, True, False), (False, True, False), (None, False, True)],
)
def test_points_alone_are_believed_where_the_walk_goes_on(goes_on: bool | None, ordered: bool, believed: bool) -> None:
    """Trees that look alike have hundreds of points in common: a walk was put 15 m off by them, and nobody told."""
    assert evidence(points=300, goes_on=goes_on, ordered=ordered).enough(overlap=False) is believed


def test_few_points_are_none() -> None:
    assert not evidence(points=20, goes_on=True).enough(overlap=False)


def test_two_boards_are_enough_and_one_needs_something_beside_it() -> None:
    assert evidence(boards=2, sightings=6, goes_on=False).enough(overlap=False)
    assert not evidence(boards=2, sightings=2).enough(overlap=False)
    one = partial(evidence, boards=1, sightings=6)
    assert not one().enough(overlap=False)
    assert one().enough(overlap=True)
    assert one(goes_on=True).enough(overlap=False)
    assert one(points=12).enough(overlap=False)


def test_boards_that_mostly_disagree_are_evidence_against() -> None:
    assert not evidence(boards=2, sightings=5, missed=5, points=300, goes_on=True).enough(overlap=True)


def test_a_place_that_boards_contradict_is_no_rival_of_one_that_they_all_bear_out() -> None:
    """In a walk torn in three one board of three let 50 photographs lie elsewhere, too, and they were left out."""
    best = evidence(boards=3, sightings=52, points=82)
    assert not evidence(boards=1, sightings=36, missed=16, points=15).rivals(best)
    assert evidence(boards=2, sightings=36, points=15).rivals(best)
    assert not evidence(boards=2, sightings=30, points=15).rivals(best)
