"""The place of a part by the pattern of its stems: found where it is told, and nothing claimed where it is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fsinfer.geometry.similarity import apply
from fsinfer.trees.pattern.match import PatternSettings, StemMap, match_stems
from fsinfer.trees.tree import Tree
from tests.support.stem_maps import seen_from_elsewhere, strewn, tree_of


def elsewhere(trees: list[Tree], *, noise_m: float = 0.0) -> StemMap:
    """The trees as a part of the walk has them."""
    return StemMap.of(seen_from_elsewhere(trees, turn_deg=130.0, shift=(40.0, -7.0, 3.0), noise_m=noise_m))


@given(st.integers(0, 10_000), st.floats(-180.0, 180.0), st.floats(-100.0, 100.0))
@settings(max_examples=8, deadline=None)
def test_a_part_is_put_where_it_was_taken_from(seed: int, turn_deg: float, shift_m: float) -> None:
    """Eight of 24 stems at one side, places off by 3 cm, and three stems beyond that the rest did not see."""
    plot = sorted(strewn(27, seed=seed), key=lambda tree: tree.x_m)
    rest, part = plot[:24], plot[16:]
    theirs = seen_from_elsewhere(part, turn_deg=turn_deg, shift=(shift_m, -shift_m, 5.0), noise_m=0.03, seed=seed)
    match = match_stems(StemMap.of(rest), StemMap.of(theirs))
    assert match is not None
    assert {(int(i), int(j)) for i, j in zip(match.ours, match.theirs, strict=True)} == {(16 + k, k) for k in range(8)}
    back = apply(match.rest_from_part, StemMap.of(theirs).xyz)
    np.testing.assert_allclose(back, StemMap.of(part).xyz, atol=0.15)
    assert match.rms_m < 0.08
    assert match.by_chance < 1e-3


def test_stems_without_a_diameter_tell_by_their_places() -> None:
    plot = [replace(tree, dbh_cm=None, status="unmeasured") for tree in strewn(24, seed=3)]
    match = match_stems(StemMap.of(plot), elsewhere(plot[:10], noise_m=0.03))
    assert match is not None
    assert len(match.ours) == 10
    # What diameters would add to the same places is much.
    measured = strewn(24, seed=3)
    sure = match_stems(StemMap.of(measured), elsewhere(measured[:10], noise_m=0.03))
    assert sure is not None
    assert sure.by_chance < 1e-3 * match.by_chance


def test_another_wood_is_no_part_of_this_one() -> None:
    """Sixty pairs of woods that have nothing in common; two hundred were tried."""
    for seed in range(60):
        one, other = strewn(24, seed=seed), strewn(14, seed=10_000 + seed)
        assert match_stems(StemMap.of(one), StemMap.of(other)) is None, seed


def test_too_few_stems_in_common_are_no_evidence() -> None:
    plot = strewn(40, seed=5, extent_m=20.0)
    theirs = elsewhere([*plot[:2], *plot[24:]])
    assert match_stems(StemMap.of(plot[:24]), theirs) is None
    assert match_stems(StemMap.of(plot[:2]), StemMap.of(plot[:2])) is None
    assert match_stems(StemMap.of([]), StemMap.of(plot)) is None


def test_rows_that_look_alike_after_a_step_are_not_told_apart() -> None:
    """A plantation in rows of 2 m, all stems alike: a part of it fits at many places."""
    rows = [tree_of(1 + i, (2.0 * (i % 6), 2.0 * (i // 6), 0.0), 20.0) for i in range(36)]
    part = elsewhere([tree for tree in rows if tree.x_m < 5.0 and tree.y_m < 5.0])
    assert match_stems(StemMap.of(rows), part) is None


def test_stems_that_look_the_same_turned_half_round_do_not_tell_which_way() -> None:
    """Each has its like on the other side of the middle: a part fits at two places, and no third one."""
    half = [tree for tree in strewn(24, seed=11) if tree.x_m > 8.5]
    assert len(half) > 8
    like = [replace(tree, tree_id=100 + tree.tree_id, x_m=16.0 - tree.x_m, y_m=16.0 - tree.y_m) for tree in half]
    both, part = StemMap.of([*half, *like]), elsewhere(half)
    assert match_stems(StemMap.of(half), part) is not None
    assert match_stems(both, part) is None


def test_stems_of_other_diameters_are_others() -> None:
    plot = strewn(24, seed=7)
    other = [replace(tree, dbh_cm=50.0 + 3.0 * k, dbh_lo95_cm=49.5, dbh_hi95_cm=50.5) for k, tree in enumerate(plot)]
    assert match_stems(StemMap.of(plot), elsewhere(other[:10])) is None
    # A doubtful diameter may be anything.
    doubtful = [replace(tree, status="doubtful") for tree in other]
    found = match_stems(StemMap.of(plot), elsewhere(doubtful[:10]))
    assert found is not None
    assert len(found.ours) == 10


def test_one_stem_of_another_diameter_is_not_among_those_that_agree() -> None:
    plot = strewn(24, seed=8)
    part = [replace(plot[0], dbh_cm=70.0, dbh_lo95_cm=69.0, dbh_hi95_cm=71.0), *plot[1:10]]
    match = match_stems(StemMap.of(plot), elsewhere(part))
    assert match is not None
    assert sorted(match.ours) == list(range(1, 10))


def test_a_stem_on_other_ground_is_not_the_same() -> None:
    plot = strewn(24, seed=8)
    part = [replace(plot[0], z_ground_m=plot[0].z_ground_m + 2.0), *plot[1:10]]
    match = match_stems(StemMap.of(plot), elsewhere(part))
    assert match is not None
    assert 0 not in match.ours
    assert len(match.ours) == 9


@pytest.mark.parametrize("missed", [4, 14])
def test_maps_that_miss_what_the_other_saw_do_not_lie_there(missed: int) -> None:
    """Six stems fall on each other; among them stand ``missed`` that only the rest measured."""
    corners = strewn(6, seed=9, extent_m=16.0, apart_m=5.0)
    among = [tree for tree in strewn(60, seed=10, extent_m=16.0, apart_m=1.0) if _between(tree.x_m, tree.y_m)][:missed]
    assert len(among) == missed
    match = match_stems(StemMap.of([*corners, *among]), elsewhere(corners))
    assert (match is not None) == (missed == 4)


def _between(x: float, y: float) -> bool:
    from scipy.spatial import Delaunay

    corners = StemMap.of(strewn(6, seed=9, extent_m=16.0, apart_m=5.0)).xyz[:, :2]
    far = np.hypot(*(corners - (x, y)).T).min() > 1.0
    return bool(far and Delaunay(corners).find_simplex([[x, y]])[0] >= 0)


def test_woods_without_anything_in_common_are_expected_by_chance() -> None:
    """Of 40 pairs of woods without diameters at most two may be called rarer than one in twenty."""
    loose = PatternSettings(by_chance=1e9, rival_share=1.0, seen_share=0.0)
    chances = []
    for seed in range(40):
        one, other = StemMap.of(strewn(24, seed=seed)), StemMap.of(strewn(14, seed=10_000 + seed))
        match = match_stems(*(replace(m, dbh_m=np.full(len(m), np.nan)) for m in (one, other)), settings=loose)
        assert match is not None
        chances.append(match.by_chance)
    assert np.count_nonzero(np.array(chances) < 0.05) <= 2
    # The bound is on the safe side, yet not so far that nothing could pass it.
    assert float(np.median(chances)) < 200.0
