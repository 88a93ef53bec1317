"""One stem, one entry: entries that stand in each other, and stems that only touch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fsinfer.notices.notice import notice
from fsinfer.notices.stems import StemCode
from fsinfer.trees.diameter.section import Section, unmeasured_section
from fsinfer.trees.diameter.silhouette import SilhouetteFit
from fsinfer.trees.one_entry import one_entry_a_stem
from fsinfer.trees.stem_measurement import tree_of
from fsinfer.trees.tree import Tree
from tests.support.time_limit import within

WALL = notice(StemCode.double_wall, gap_cm=3.0)
EDGES = SilhouetteFit(
    radius_m=0.063, std_m=0.001, shift_m=np.zeros(2), slope=np.zeros(2), taper=0.0, shape_m=np.zeros(6), rays=90.0,
    share=0.9, photos=39, sectors=0.8, noise_m=0.002, contrast=1.5, weight=np.zeros(0),
)  # fmt: skip


def entry(
    number: int, x_m: float, dbh_m: float | None, *, sd_m: float = 0.004, status: str = "ok"
) -> tuple[Tree, Section]:
    section = unmeasured_section(np.array([x_m, 0.0]), 1.3, (WALL,), radius_m=0.4)
    if dbh_m is not None:
        section = replace(section, dbh_m=dbh_m, sd_m=sd_m, status=status, reasons=())
    return replace(tree_of(section, 0.0, None, np.zeros(3)), tree_id=number), section


def numbers(pairs: list[tuple[Tree, Section]]) -> list[int]:
    return [tree.tree_id for tree, _ in pairs]


def test_three_entries_of_one_far_stem_are_one() -> None:
    """Two a centimetre apart and one a hand's breadth beside, as stood in a table; the surest stays, in its place."""
    pairs = [
        entry(1, 0.00, 0.31, sd_m=0.02),
        entry(2, 0.01, 0.30, sd_m=0.01),
        entry(3, 0.25, None),
        entry(4, 2.0, 0.30),
    ]
    left, told = one_entry_a_stem(pairs)
    assert numbers(left) == [2, 4]
    assert [why.code for why in told] == [StemCode.same_stem] * 2
    assert (told[0].values["x_m"], told[0].values["other_x_m"]) == (0.0, 0.01)


def test_thousands_of_stems_are_compared_in_seconds() -> None:
    many = [entry(number, 3.0 * number, 0.30) for number in range(1, 5_000)]
    with within(20):
        left, _ = one_entry_a_stem([*many, entry(5_000, 9.02, 0.2, status="doubtful")])
    assert numbers(left) == list(range(1, 5_000))


@pytest.mark.parametrize(("gap_m", "left"), [(-0.03, [1]), (-0.005, [1, 2]), (0.08, [1, 2])])
def test_stems_that_touch_are_two(gap_m: float, left: list[int]) -> None:
    """Surfaces 8 cm apart as in a fork, in each other by what the radii may be off, and by more."""
    pairs = [entry(1, 0.0, 0.30), entry(2, 0.15 + gap_m + 0.10, 0.20, status="doubtful")]
    assert numbers(one_entry_a_stem(pairs)[0]) == left


def test_a_measured_stem_stays_before_one_that_is_not_whatever_their_order() -> None:
    assert numbers(one_entry_a_stem([entry(1, 0.0, None), entry(2, 0.05, 0.2, status="doubtful")])[0]) == [2]
    # Without a DBH its circle may be anything: it does not swallow what stands 35 cm away.
    assert numbers(one_entry_a_stem([entry(1, 0.0, None), entry(2, 0.35, 0.2)])[0]) == [1, 2]


@pytest.mark.parametrize(
    ("status", "edges", "sides", "noise_m", "left"),
    [
        ("doubtful", False, 0.3, 0.015, [1]),
        ("ok", False, 0.3, 0.015, [1, 2]),
        ("doubtful", True, 0.3, 0.015, [1, 2]),
        # A neighbour that shows no edges: its bark is no haze, or it is seen from more than one side.
        ("doubtful", False, 0.3, 0.005, [1, 2]),
        ("doubtful", False, 0.6, 0.015, [1, 2]),
    ],
)
def test_a_doubtful_hazy_wall_beside_a_stem_whose_edges_are_seen_is_its_haze(
    status: str, edges: bool, sides: float, noise_m: float, left: list[int]
) -> None:
    """Three centimetres of air between them, as in a walk that was torn and joined."""
    stem, wall = entry(1, 0.0, 0.125), entry(2, 0.187, 0.188, sd_m=0.02, status=status)
    pairs = [
        (stem[0], replace(stem[1], silhouette=EDGES)),
        (wall[0], replace(wall[1], silhouette=EDGES if edges else None, coverage=sides, residual_m=noise_m)),
    ]
    assert numbers(one_entry_a_stem(pairs)[0]) == left
    # Without photographs nobody looked for edges.
    assert numbers(one_entry_a_stem([stem, wall])[0]) == [1, 2]


@pytest.mark.parametrize(
    ("apart_m", "status", "edges", "sides", "left"),
    [
        (0.386, "doubtful", False, 0.18, [1]),
        (0.410, "doubtful", False, 0.18, [1, 2]),
        (0.386, "ok", False, 0.18, [1, 2]),
        (0.386, "doubtful", True, 0.18, [1, 2]),
        (0.386, "doubtful", False, 0.5, [1, 2]),
    ],
)
def test_a_smooth_wall_seen_from_one_side_that_stands_in_a_stem_is_that_stem_s(
    apart_m: float, status: str, edges: bool, sides: float, left: list[int]
) -> None:
    """64 cm +- 14 cm and 0.9 cm rough, through the middle of a stem of 16 cm whose edges many photographs show."""
    stem, wall = entry(1, 0.0, 0.155), entry(2, apart_m, 0.642, sd_m=0.07, status=status)
    pairs = [
        (stem[0], replace(stem[1], silhouette=EDGES)),
        (wall[0], replace(wall[1], silhouette=EDGES if edges else None, coverage=sides, residual_m=0.0089)),
    ]
    assert numbers(one_entry_a_stem(pairs)[0]) == left


@pytest.mark.parametrize(
    ("gap_m", "noise_m", "edges", "left"),
    [(0.02, 0.012, True, [1]), (0.05, 0.012, True, [1, 2]), (0.02, 0.005, True, [1, 2]), (0.02, 0.012, False, [1, 2])],
)
def test_a_haze_without_a_diameter_beside_a_stem_is_no_stem(
    gap_m: float, noise_m: float, edges: bool, left: list[int]
) -> None:
    """Thirty-seven points, 17 cm +- 8 cm and 1.1 cm rough, stood a centimetre beside a stem of 18 cm."""
    stem, wall = entry(1, 0.0, 0.18), entry(2, 0.09 + gap_m + 0.085, None)
    wall = (wall[0], replace(wall[1], circle_m=np.array([0.0, 0.0, 0.085]), coverage=0.55, residual_m=noise_m))
    if edges:
        stem = (stem[0], replace(stem[1], silhouette=EDGES))
    assert numbers(one_entry_a_stem([stem, wall])[0]) == left


@pytest.mark.parametrize(
    ("gap_m", "noise_m", "by_points", "left"),
    [(0.02, 0.012, None, [1]), (0.06, 0.012, None, [1, 2]), (0.02, 0.005, None, [1, 2]), (0.02, 0.012, 0.16, [1, 2])],
)
def test_a_haze_with_the_edges_of_the_stem_beside_it_is_no_stem(
    gap_m: float, noise_m: float, by_points: float | None, left: list[int]
) -> None:
    """A wall whose points have no size, 1.2 cm from a stem of 17 cm, was given as 16 cm by its edges alone."""
    stem, wall = entry(1, 0.0, 0.171), entry(2, 0.0855 + gap_m + 0.082, 0.164, sd_m=0.006)
    pairs = [
        (stem[0], replace(stem[1], silhouette=EDGES, cloud_dbh_m=0.163, coverage=0.8)),
        (wall[0], replace(wall[1], silhouette=EDGES, cloud_dbh_m=by_points, coverage=0.5, residual_m=noise_m)),
    ]
    assert numbers(one_entry_a_stem(pairs)[0]) == left


@pytest.mark.parametrize(
    ("contrast", "other_contrast", "noise_m", "x_m", "left"),
    [
        (1.37, 1.73, 0.015, 0.19, [1]),
        (1.45, 1.73, 0.015, 0.19, [1, 2]),  # edges of its own
        (1.37, 1.38, 0.015, 0.19, [1, 2]),  # neither is the surer one
        (1.37, 1.73, 0.005, 0.19, [1, 2]),  # no haze
        (1.37, 1.73, 0.015, 0.23, [1, 2]),  # beyond its reach
    ],
)
def test_a_haze_with_faint_edges_beside_a_stem_with_clear_ones_is_its_haze(
    contrast: float, other_contrast: float, noise_m: float, x_m: float, left: list[int]
) -> None:
    # The stem's interval is the wider one: its points and edges contradict each other.
    stem, clear = entry(1, 0.0, 0.172, sd_m=0.014, status="doubtful")
    wall, faint = entry(2, x_m, 0.177, sd_m=0.004, status="doubtful")
    clear = replace(clear, silhouette=replace(EDGES, contrast=other_contrast), cloud_dbh_m=0.15, residual_m=noise_m)
    faint = replace(faint, silhouette=replace(EDGES, contrast=contrast), cloud_dbh_m=0.147, residual_m=noise_m)
    assert numbers(one_entry_a_stem([(stem, clear), (wall, faint)])[0]) == left


def test_what_a_person_put_there_stays() -> None:
    pairs = [entry(1, 0.0, 0.30), entry(2, 0.02, None)]
    assert numbers(one_entry_a_stem(pairs, kept={2})[0]) == [2]
    assert numbers(one_entry_a_stem(pairs, kept={1, 2})[0]) == [1, 2]


def leaning(pair: tuple[Tree, Section], slope: float) -> tuple[Tree, Section]:
    """Seen from several sides, its axis parting from the upright by so much."""
    return pair[0], replace(pair[1], slope=np.array([slope, 0.0]), coverage=0.8)


@pytest.mark.parametrize(("edges", "other_edges", "forks"), [(0, 0, True), (1, 1, True), (1, 0, False)])
def test_what_shows_no_edges_beside_a_stem_that_does_makes_no_fork(edges: int, other_edges: int, forks: bool) -> None:
    """As a haze of 15 cm in a stem of 10 cm, whose axis parts from it below breast height."""
    stem, other = leaning(entry(1, 0.0, 0.30), -0.1), leaning(entry(2, 0.06, 0.28, status="doubtful"), 0.1)
    pairs = [
        (tree, replace(section, silhouette=EDGES if has else None))
        for (tree, section), has in zip((stem, other), (edges, other_edges), strict=True)
    ]
    ((tree, _),) = one_entry_a_stem(pairs)[0]
    assert tree.tree_id == 1
    assert ([why.code for why in tree.reasons] == [StemCode.forks_here]) is forks
    assert tree.status == ("doubtful" if forks else "ok")
