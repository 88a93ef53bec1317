"""Two stems that meet below breast height are one tree to whoever stands before it: that is told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fsinfer.notices.stems import StemCode
from fsinfer.trees import analyse_plot
from fsinfer.trees.diameter.section import Section, unmeasured_section
from fsinfer.trees.forks import forks
from fsinfer.trees.stem_measurement import tree_of
from fsinfer.trees.tree import Tree
from tests.support.stem_clouds import forked_stem
from tests.support.time_limit import within

DBH_M = 0.24


def stem(
    number: int, x_m: float, lean_deg: float, *, ground_m: float = 0.0, measured: bool = True
) -> tuple[Tree, Section]:
    """A stem whose centre at breast height is ``x_m``, leaning towards +x."""
    section = unmeasured_section(np.array([x_m, 0.0]), 1.3, (), radius_m=DBH_M / 2)
    section = replace(section, slope=np.array([np.tan(np.radians(lean_deg)), 0.0]))
    if measured:
        section = replace(section, dbh_m=DBH_M, sd_m=0.004, status="ok", reasons=())
    return replace(tree_of(section, ground_m, None, np.zeros(3)), tree_id=number), section


def told(*stems: tuple[Tree, Section]) -> list[tuple[int, int, float]]:
    trees, sections = zip(*stems, strict=True)
    found = forks(trees, sections)
    assert all(one.code == StemCode.forked for one in found)
    listed = []
    for one in found:
        first, second, height = (one.values[name] for name in ("tree_id", "other_id", "height_m"))
        assert isinstance(first, int)
        assert isinstance(second, int)
        assert isinstance(height, float)
        listed.append((first, second, height))
    return listed


def test_two_stems_of_one_root_are_named_with_the_height_at_which_they_part() -> None:
    apart = 2 * 0.8 * np.tan(np.radians(10))  # 10 degrees each way, from 0.5 m above the ground on
    ((one, other, height),) = told(stem(9, apart / 2, 10), stem(4, -apart / 2, -10), stem(1, 3.0, 0))
    assert (one, other) == (4, 9)
    assert height == pytest.approx(0.5, abs=0.01)


def test_stems_that_part_widely_are_a_fork_as_far_as_their_radii_allow() -> None:
    ((_, _, height),) = told(stem(1, -0.3, -20), stem(2, 0.3, 20))
    assert height == pytest.approx(1.3 - 0.3 / np.tan(np.radians(20)), abs=0.01)


@pytest.mark.parametrize(
    ("x_m", "lean_deg"),
    [
        (0.3, 0.0),  # side by side, upright
        (0.3, -10.0),  # leaning together: they meet above
        (1.5, 10.0),  # too far from each other
        (1.2, 25.0),  # too far from each other for stems so thin, though they meet at the ground
        (0.5, 3.0),  # would meet below the ground
    ],
)
def test_neighbours_are_no_fork(x_m: float, lean_deg: float) -> None:
    assert told(stem(1, -x_m / 2, -lean_deg), stem(2, x_m / 2, lean_deg)) == []


def test_on_a_slope_breast_heights_differ_and_the_fork_is_the_same() -> None:
    one, other = stem(1, -0.14, -10), stem(2, 0.14, 10)
    moved = 0.2 * np.tan(np.radians(10))
    raised = stem(2, 0.14 + moved, 10, ground_m=0.2)
    assert told(one, raised)[0][2] == pytest.approx(told(one, other)[0][2], abs=0.01)


def test_stems_without_a_diameter_are_not_compared() -> None:
    assert told(stem(1, -0.14, -10), stem(2, 0.14, 10, measured=False)) == []


def test_among_thousands_of_stems_a_fork_is_found_in_seconds() -> None:
    """Stems of a carried scanner's hectares: every pair looked at by itself would take a minute, with no word of it."""
    many = [stem(number, 3.0 * number, 0.0) for number in range(3, 3_500)]
    with within(20):
        ((one, other, _),) = told(*many, stem(1, -0.14, -10), stem(2, 0.14, 10))
    assert (one, other) == (1, 2)


@pytest.mark.parametrize("height_m", [0.9, 1.15, 1.2, 1.3, 1.4, 1.7])
def test_near_a_fork_no_diameter_of_one_of_its_stems_is_sure(height_m: float) -> None:
    rng = np.random.default_rng(1)
    ground = np.column_stack([rng.uniform(-2.0, 2.0, (12_000, 2)), rng.normal(0, 0.01, 12_000)])
    stem = forked_stem(rng, at=(0.2, 0.1), height_m=height_m)
    found = analyse_plot(np.concatenate([ground[np.hypot(*(ground[:, :2] - [0.2, 0.1]).T) > 0.22], stem]))
    sure = [tree.dbh_cm for tree in found.trees if tree.status == "ok"]
    if height_m < 1.2:
        assert sure == pytest.approx([28.0, 28.0], abs=0.6)
    elif height_m == 1.7:
        assert sure == pytest.approx([40.0], abs=0.3)
    else:
        (tree,) = found.trees
        assert sure == []
        assert {why.code for why in tree.reasons} <= {StemCode.forks_here, StemCode.double_wall}
