"""How each stem was seen, and the sentences and the directions that the check tells of it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.check.advice import advice, marker_lines
from fsinfer.check.compass import COMPASS_WORDS, MAP_WORDS, find_compass
from fsinfer.check.coverage import judge_stems, widest_gap
from fsinfer.check.map import seen_arcs
from fsinfer.check.settings import CoverageSettings
from fsinfer.check.sparse_stems import SparseStem
from fsinfer.check.visible_stems import VisibleStem, join_stems
from fsinfer.scale.scale import MarkerScale, RejectedMarker, Scale
from fsinfer.trees.cylinder.axis import Axis
from fsinfer.trees.search.stem import Stem
from tests.support.boards import board, scale_of_boards

NO_SCALE = Scale(m_per_unit=None, source="none", rel_std=None)
STEM = VisibleStem(center=np.array([2.0, 1.0]), radius=0.15, lean=np.zeros(2))
# A ring of photos, ten degrees apart; the first half of it sees the stem.
TURNS = np.radians(np.arange(0, 360, 10))
HALF = np.arange(36) < 19


def ring(reach_m: float | NDArray[np.float64] = 4.0) -> NDArray[np.float64]:
    toward = np.column_stack([np.cos(TURNS), np.sin(TURNS)])
    circle: NDArray[np.float64] = STEM.center + np.broadcast_to(reach_m, 36)[:, None] * toward
    return circle


def test_a_stem_seen_from_half_of_the_ring_is_one_sided() -> None:
    judged = judge_stems([STEM], HALF[None], ring(), np.array([True]))[0]
    assert judged.verdict == "one side"
    assert judged.gap_deg == pytest.approx(180)
    assert judged.gap_center_deg == pytest.approx(270)
    assert judged.one_sided
    # One photo from the other side is enough to see it by halves of a half.
    more = HALF.copy()
    more[27] = True
    assert judge_stems([STEM], more[None], ring(), np.array([True]))[0].verdict == "good"
    few = HALF & (np.arange(36) % 5 == 0)
    settings = CoverageSettings(few_share=0.3)
    assert judge_stems([STEM], few[None], ring(), np.array([True]), settings=settings)[0].verdict == "hardly seen"
    assert judge_stems([STEM], HALF[None], ring(), np.array([False]))[0].verdict == "outside"
    assert judge_stems([STEM], np.ones((1, 36), bool), ring(10.0), np.array([True]))[0].verdict == "far"


def test_one_photo_that_shows_a_stem_is_one() -> None:
    names = [f"p{index:02d}" for index in range(36)]
    compass = find_compass(ring(), {})
    told = []
    for photos in (1, 2):
        judged = judge_stems([STEM], (np.arange(36) < photos)[None], ring(), np.array([True]))
        told += advice(
            names=names, left_out=[], given=names, stems=judged, compass=compass, offsets_m=[ring() - STEM.center]
        )
    assert ["only 1 photo shows it" in told[0], "only 2 photos show it" in told[1]] == [True, True]


def test_a_stem_that_no_photo_shows_lacks_no_side_above_others() -> None:
    names = [f"p{index:02d}" for index in range(36)]
    judged = judge_stems([STEM], np.zeros((1, 36), bool), ring(), np.array([True]))
    (told,) = advice(
        names=names, left_out=[], given=names, stems=judged,
        compass=find_compass(ring(), {}), offsets_m=[ring() - STEM.center],
    )  # fmt: skip
    assert told.startswith("Photograph tree 1 again from nearer, all round: no photo shows it unhidden")


def test_stems_are_numbered_in_the_order_of_walking() -> None:
    cameras = np.column_stack([np.arange(36.0), np.zeros(36)])
    stems = [VisibleStem(center=np.array([x, 1.0]), radius=0.1, lean=np.zeros(2)) for x in (30.0, 3.0, 17.0, 9.0)]
    judged = judge_stems(stems, np.ones((4, 36), bool), cameras, np.array([True, True, False, True]))
    assert [(entry.number, entry.stem.center[0]) for entry in judged] == [(1, 3.0), (2, 9.0), (3, 30.0), (4, 17.0)]


def test_the_other_side_seen_from_too_far_is_said() -> None:
    told = []
    # Photos next to those that see it stand at the edge of the other side, and not on it.
    at_edge = HALF | np.roll(HALF, 1) | np.roll(HALF, -1)
    for near, other_side_m in ((HALF, 5.0), (HALF, 12.0), (at_edge, 12.0)):
        cameras = ring(np.where(near, 4.0, other_side_m))
        judged = judge_stems([STEM], HALF[None], cameras, np.array([True]))
        compass = find_compass(cameras, {})
        names = [f"p{index:02d}" for index in range(36)]
        told += advice(
            names=names, left_out=[], given=names, stems=judged, compass=compass, offsets_m=[cameras - STEM.center]
        )
    assert ["or from more than 9 m" in line for line in told] == [False, True, True]


def test_sparse_stems_are_added_where_the_surface_has_none() -> None:
    def sparse(x_m: float) -> SparseStem:
        return SparseStem(center=np.array([x_m, 0.0]), radius=0.1, lean=np.zeros(2), members=np.arange(3))

    assert [stem.center[0] for stem in join_stems([], [sparse(1.0), sparse(1.25), sparse(2.0)])] == [1.0, 1.25, 2.0]
    alone = join_stems([_surface(1.0)], [sparse(1.25), sparse(2.0)])
    assert [(stem.center[0], stem.radius) for stem in alone] == [(1.0, 0.2), (2.0, 0.1)]
    assert alone[0].lean[0] == pytest.approx(0.05)


def _surface(x_m: float) -> Stem:
    axis = Axis(parameters=np.array([x_m, 0.0, 0.05, 0.0, 0.2, 0.0]), height_m=1.3, sigma_m=0.01)
    return Stem(axis=axis, bottom_m=0.5, top_m=2.5, length_m=2.0, arc_coverage=0.5, quality=1.0)


def test_widest_gap_and_arcs() -> None:
    assert widest_gap(np.array([])) == (360.0, 0.0)
    assert widest_gap(np.array([10.0])) == (360.0, 190.0)
    assert widest_gap(np.array([350.0, 10.0, 100.0])) == pytest.approx((250.0, 225.0))
    assert seen_arcs(np.arange(0, 360, 20.0)) == [(0.0, 360.0)]
    assert seen_arcs(np.array([350.0, 0.0, 10.0])) == [(335.0, 385.0)]
    assert seen_arcs(np.array([0.0, 10.0, 180.0])) == [(165.0, 195.0), (-15.0, 25.0)]


def test_north_by_gnss_and_by_the_first_photo() -> None:
    rng = np.random.default_rng(1)
    angles = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    cameras = 15 * np.column_stack([np.cos(angles), np.sin(angles)])
    # The plan's x axis points north; the phone is 2 m off each time.
    north, east = cameras[:, 0], -cameras[:, 1]
    noise = rng.normal(0, 2, (40, 2))
    latitude = 48 + np.degrees((north + noise[:, 0]) / 6_371_000)
    longitude = 9 + np.degrees((east + noise[:, 1]) / 6_371_000 / np.cos(np.radians(48)))
    compass = find_compass(cameras, dict(enumerate(zip(latitude.tolist(), longitude.tolist(), strict=True))))
    assert compass.known
    assert compass.turn_deg == pytest.approx(90, abs=5)
    assert [compass.side(angle) for angle in (0, 90, 180, 270)] == [COMPASS_WORDS[i] for i in (2, 4, 6, 0)]
    # A plot no wider than the errors of a phone says nothing about north, and a scatter without sense neither.
    small = find_compass(cameras / 5, dict(enumerate(zip(latitude.tolist(), longitude.tolist(), strict=True))))
    wild = {rank: (48 + rng.normal(0, 1e-4), 9 + rng.normal(0, 1e-4)) for rank in range(40)}
    assert not small.known
    assert not find_compass(cameras, wild).known
    # Without north, what lies towards the first photo is at the bottom of the map.
    assert small.side(0.0) == MAP_WORDS[6] == "the bottom of the map"


def test_photos_that_did_not_join_are_told_by_stretches() -> None:
    given = [f"p{index}" for index in range(10)]
    lines = advice(
        names=[],
        left_out=["p2", "p3", "p4", "p8"],
        given=given,
        stems=[],
        compass=find_compass(np.array([[0.0, -1], [0, 1]]), {}),
        offsets_m=[],
    )
    assert lines[0].startswith("Photos p2 to p4 (3) did not join the others: walk this stretch again")
    assert lines[1].startswith("Photo p8 did not join")
    assert lines[2].startswith("4 of 10 photos are missing so: mend the walk first")


def test_a_few_lost_photos_are_no_torn_walk() -> None:
    given = [f"p{index:02}" for index in range(40)]
    compass = find_compass(np.array([[0.0, -1], [0, 1]]), {})
    lines = advice(names=[], left_out=given[7:11], given=given, stems=[], compass=compass, offsets_m=[])
    assert len(lines) == 1
    assert lines[0].startswith("Photos p07 to p10 (4) did not join")


def test_boards_seen_too_seldom_or_from_far() -> None:
    def entry(number: int, views: int, side_px: float) -> MarkerScale:
        return board(number, (0.0, 0.0, 0.0), [str(i) for i in range(views)], near_side_px=side_px)

    found = [entry(40, 12, 80.0), entry(41, 4, 80.0), entry(42, 12, 20.0)]
    rejected = tuple(RejectedMarker(id=number, reason="1 views") for number in (43, 40))
    scale = scale_of_boards(found, rejected=rejected)
    lines = marker_lines(scale, given=True)
    assert [line.split(":")[0] for line in lines] == [
        "Board 40",
        "Board 41",
        "Board 42",
        "Board 43 cannot be used (1 views)",
    ]
    assert [line.endswith("good.") for line in lines] == [True, False, False, False]
    # One from an arm's length says nothing of the others.
    assert lines[0].startswith("Board 40: in 12 photos, in the five nearest its side is at least 80 pixels: good")
    assert lines[1].startswith("Board 41: in 4 photos, in all of them its side is at least 80 pixels: pass it again")
    five = marker_lines(scale_of_boards([entry(40, 5, 60.0)]), given=True)[0]
    assert five == "Board 40: in 5 photos, in all of them its side is at least 60 pixels: good."
    one = marker_lines(scale_of_boards([entry(40, 1, 60.0)]), given=True)[0]
    assert one.startswith("Board 40: in 1 photo, in it its side is at least 60 pixels: pass it again")
    assert "fsinfer scale OUT --click" in marker_lines(NO_SCALE, given=False)[0]
    # Where none can be used they are told all the same, each once.
    reasons = [(43, "3 views: the corners do not make a square"), (43, "2 views: too few"), (44, "1 views: too few")]
    alone = [RejectedMarker(id=number, reason=reason) for number, reason in reasons]
    lines = marker_lines(NO_SCALE, alone, given=False)
    assert len(lines) == 3
    assert lines[0].startswith("Board 43 cannot be used (3 views: the corners do not make a square; 2 views: too few):")
    assert lines[1] == "Board 44 cannot be used (1 views: too few): pass it again at 2 to 3 m, facing it."
    assert lines[2].startswith("No board can be used")
    assert "--aruco-length-m" in marker_lines(scale, given=False)[-1]
