"""Intervals of stems whose section, or whose plot's sections, are farther from round than stems usually are."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from fsinfer.notices.stems import StemCode
from fsinfer.trees.diameter.dbh import measure_together
from fsinfer.trees.diameter.section import Section
from fsinfer.trees.shape_doubts import allow_for_shape
from fsinfer.trees.stem_measurement import tree_of
from fsinfer.trees.tree import Tree
from tests.support.bark import bark, stem_of

RADIUS = 0.15
#: Of the 2nd harmonic, part of the radius: what 24 % of stems have more of, and what next to none have.
ROUND, OVAL = 0.027, 0.056

Pair = tuple[Tree, Section]


def pair(seed: int, oval: float, *, arc_deg: float = 360.0, sigma_m: float = 0.002) -> Pair:
    """A stem of 30 cm as it is measured, longer one way by ``oval`` of its radius; the way is drawn."""
    rng = np.random.default_rng(seed)
    turn = rng.uniform(0.0, 2.0 * np.pi)
    shape = [(2, oval * np.cos(turn), oval * np.sin(turn))]
    points = bark(rng, RADIUS, shape=shape, arc_deg=arc_deg, sigma_m=sigma_m)
    (section,) = measure_together([points], [stem_of(RADIUS)])
    assert section.dbh_m is not None
    return tree_of(section, 0.0, None, np.zeros(3)), section


def half_cm(tree: Tree) -> float:
    assert tree.dbh_lo95_cm is not None
    assert tree.dbh_hi95_cm is not None
    return 0.5 * (tree.dbh_hi95_cm - tree.dbh_lo95_cm)


def stand(oval: float, stems: int = 10) -> list[Pair]:
    return [pair(seed, oval) for seed in range(stems)]


def widened(pairs: Sequence[Pair], number: int) -> float:
    """By how much the interval of one is wider for the shapes."""
    (after, section), (before, _) = allow_for_shape(pairs)[number], pairs[number]
    assert after.dbh_cm == before.dbh_cm
    assert half_cm(after) == pytest.approx(100.0 * section.half95_m)
    return half_cm(after) / half_cm(before)


def test_half_a_stem_among_oval_ones_is_less_sure_than_among_round_ones() -> None:
    half = pair(99, 0.0, arc_deg=170.0)
    among_round, among_oval = widened([*stand(ROUND), half], 10), widened([*stand(OVAL), half], 10)
    assert 1.0 <= among_round < 1.1
    assert among_oval > 1.3


def test_what_is_seen_all_round_is_not_less_sure_for_its_neighbours() -> None:
    assert widened([*stand(OVAL), pair(99, 0.0)], 10) == pytest.approx(1.0, abs=0.02)


def test_a_section_far_from_round_is_less_sure_in_any_company() -> None:
    assert widened([*stand(ROUND), pair(99, OVAL)], 10) > 2.0
    assert widened([*stand(ROUND), pair(99, ROUND)], 10) == pytest.approx(1.0, abs=0.02)


def test_a_wide_interval_is_a_doubt_and_one_too_wide_no_measurement() -> None:
    tree, section = allow_for_shape([pair(99, 0.15)])[0]
    assert (tree.status, section.status) == ("doubtful", "doubtful")
    assert [why.code for why in tree.reasons] == [StemCode.wide_interval, StemCode.far_from_round]
    refused, section = allow_for_shape([pair(99, 0.40)])[0]
    assert (refused.status, refused.dbh_cm, section.dbh_m) == ("unmeasured", None, None)
    assert [why.code for why in refused.reasons] == [StemCode.too_uncertain, StemCode.far_from_round]


def test_a_wide_interval_is_not_put_down_to_a_round_section() -> None:
    (tree, _), (before, _) = allow_for_shape([pair(99, 0.0, arc_deg=80.0)])[0], pair(99, 0.0, arc_deg=80.0)
    assert StemCode.wide_interval in [why.code for why in before.reasons]
    assert [why.code for why in tree.reasons].count(StemCode.wide_interval) == 1
    assert StemCode.far_from_round not in [why.code for why in tree.reasons]


def test_its_parts_are_named_and_add_up() -> None:
    _, section = allow_for_shape([*stand(OVAL), pair(99, 0.0, arc_deg=170.0)])[10]
    assert section.roundness is not None
    assert section.parts_m["oval"] == 0.0
    assert section.parts_m["shape"] > section.roundness.left_open_m
    assert section.sd_m == pytest.approx(2.0 * np.sqrt(sum(part**2 for part in section.parts_m.values())))


def test_stems_beside_tell_as_those_that_are_asked_with_it_and_are_left_as_they_are() -> None:
    # One that was refused for its shape tells as it did before.
    pairs = [*stand(OVAL), pair(98, 0.40), pair(99, 0.0, arc_deg=170.0)]
    *others, (tree, section) = allow_for_shape(pairs)
    assert others[10][1].dbh_m is None
    ((again, same),) = allow_for_shape(pairs[11:], beside=[other for _, other in others])
    assert (again, same.parts_m) == (tree, section.parts_m)
