"""Stems of parts in the plot's table: each once, the surer entry, contradictions said, what is not told left apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fsinfer.notices.notice import notice
from fsinfer.notices.stems import StemCode
from fsinfer.trees.pattern.join import JoinedStems, PartStems, join_parts
from fsinfer.trees.tree import OUTSIDE, Tree
from tests.support.stem_maps import seen_from_elsewhere, strewn, tree_of

FAR = notice(StemCode.outside_walk, nearest_m=11.0)


def wood(count: int = 20) -> list[Tree]:
    """Stems sorted along x, numbered anew: parts of a walk see stretches of it."""
    trees = sorted(strewn(count, seed=4), key=lambda tree: tree.x_m)
    return [replace(tree, tree_id=number) for number, tree in enumerate(trees, start=1)]


def part(trees: list[Tree], name: str = "part-2") -> PartStems:
    return PartStems(name=name, trees=tuple(seen_from_elsewhere(trees, turn_deg=75.0, shift=(9.0, 30.0, -2.0))))


def by_number(joined: JoinedStems) -> dict[int, Tree]:
    return {tree.tree_id: tree for tree in (*joined.stay, *joined.joined)}


def test_a_stem_that_both_saw_is_one_and_the_others_are_added() -> None:
    trees = wood()
    joined = join_parts(trees[:14], [part(trees[6:])])
    (told,) = joined.parts
    assert (told.name, told.common, told.new) == ("part-2", 8, 6)
    found = by_number(joined)
    assert sorted(found) == list(range(1, 21))
    # The new ones stand where they stand in the whole wood, in the order of the part.
    for tree in trees[14:]:
        same = found[tree.tree_id]
        assert same.part == "part-2"
        assert (same.x_m, same.y_m, same.z_ground_m) == pytest.approx((tree.x_m, tree.y_m, tree.z_ground_m), abs=0.01)
        assert joined.numbers[tree.tree_id] == tree.tree_id - 6
    assert [why.code for why in joined.warnings] == [StemCode.part_joined]
    assert joined.warnings[0].values == {
        "folder": "part-2", "common": 8, "new": 6, "apart_cm": pytest.approx(0.0, abs=0.01),
    }  # fmt: skip


@pytest.mark.parametrize("surer", ["rest", "part"])
def test_the_surer_entry_of_a_stem_stays_under_the_number_of_the_rest(surer: str) -> None:
    trees = wood()
    narrow, wide = (tree_of(8, (trees[7].x_m, trees[7].y_m, 0.1 * trees[7].x_m), 20.0, half_cm=h) for h in (0.3, 0.9))
    rest = [*trees[:7], narrow if surer == "rest" else wide, *trees[8:14]]
    theirs = [trees[6], replace(wide if surer == "rest" else narrow, dbh_cm=20.2), *trees[8:]]
    found = by_number(join_parts(rest, [part(theirs)]))
    assert found[8].part == (None if surer == "rest" else "part-2")
    assert found[8].dbh_cm == (20.0 if surer == "rest" else 20.2)
    assert found[8].status == "ok"


def test_a_stem_that_only_the_part_could_measure_is_measured() -> None:
    trees = wood()
    bare = replace(tree_of(9, (trees[8].x_m + 0.05, trees[8].y_m, 0.1 * trees[8].x_m), None))
    far = replace(bare, tree_id=10, x_m=trees[9].x_m, y_m=trees[9].y_m, status=OUTSIDE, reasons=(FAR,))
    joined = join_parts([*trees[:8], bare, far, *trees[10:14]], [part(trees[6:])])
    found = by_number(joined)
    for number in (9, 10):
        assert found[number].dbh_cm == trees[number - 1].dbh_cm
        assert (found[number].part, found[number].outside) == ("part-2", False)
    # What a part saw only from far off does not come into the plot, nor in the way of what the rest measured.
    theirs = [replace(tree, dbh_cm=None, status=OUTSIDE, reasons=(FAR,)) for tree in (trees[12], trees[17])]
    seen = by_number(join_parts(trees[:14], [part([*trees[4:12], theirs[0], *trees[14:17], theirs[1]])]))
    assert seen[13] == trees[12]
    assert sorted(seen) == list(range(1, 18))


def test_two_sound_diameters_that_contradict_each_other_are_doubtful_and_said() -> None:
    trees = wood()
    theirs = [*trees[6:8], replace(trees[8], dbh_cm=30.0, dbh_lo95_cm=29.4, dbh_hi95_cm=30.6), *trees[9:]]
    rest = [*trees[:8], replace(trees[8], dbh_cm=28.0, dbh_lo95_cm=27.7, dbh_hi95_cm=28.3), *trees[9:14]]
    found = by_number(join_parts(rest, [part(theirs)]))
    (said,) = found[9].reasons
    assert (found[9].status, said.code, said.values) == ("doubtful", StemCode.parts_disagree, {"other_cm": 30.0})
    assert (found[9].dbh_cm, found[9].dbh_lo95_cm, found[9].dbh_hi95_cm) == (28.0, 27.7, 30.6)
    # One that was doubtful already does not make the other so.
    theirs[2] = replace(theirs[2], status="doubtful")
    assert by_number(join_parts(rest, [part(theirs)]))[9] == rest[8]


def test_haze_beside_a_stem_is_no_second_one() -> None:
    """An unmeasured entry 0.25 m beside a stem of the rest, out of the pattern's reach."""
    trees = wood()
    haze = tree_of(99, (trees[3].x_m + 0.25, trees[3].y_m, 0.1 * trees[3].x_m), None)
    joined = join_parts(trees[:14], [part([*trees[5:], haze])])
    assert sorted(by_number(joined)) == list(range(1, 21))
    assert by_number(joined)[4] == trees[3]
    # Two entries of a part are two, however near.
    near = replace(trees[17], tree_id=98, x_m=trees[17].x_m + 0.25)
    assert len(by_number(join_parts(trees[:14], [part([*trees[6:], near])]))) == 21


def test_two_entries_of_a_part_beside_one_stem_are_not_both_it() -> None:
    trees = wood()
    other = [replace(trees[8], tree_id=60 + k, dbh_cm=55.0 + k, dbh_lo95_cm=54.0, dbh_hi95_cm=57.0) for k in (0, 1)]
    beside = [replace(tree, x_m=tree.x_m + shift) for tree, shift in zip(other, (0.25, -0.25), strict=True)]
    joined = join_parts(trees[:14], [part([*trees[6:8], *beside, *trees[9:]])])
    assert sorted(by_number(joined)) == list(range(1, 22))


def test_stems_outside_of_a_walk_neither_tie_a_part_nor_stand_before_what_was_walked_to() -> None:
    trees = wood()
    far = [replace(tree, reasons=(FAR,)) for tree in trees]  # measured all the same, as the user may ask for
    apart = join_parts([*trees[:6], *far[6:14]], [part(trees[6:])])
    assert apart.parts == ()
    wide = [replace(tree, dbh_lo95_cm=(tree.dbh_cm or 0) - 1.5, dbh_hi95_cm=(tree.dbh_cm or 0) + 1.5) for tree in trees]
    found = by_number(join_parts([*trees[:13], far[13]], [part([*trees[6:13], *wide[13:]])]))
    assert (found[14].part, found[14].outside) == ("part-2", False)


def test_one_part_ties_the_next() -> None:
    """The third part has nothing in common with the rest, but with the second."""
    trees = wood(36)
    parts = [part(trees[20:], "part-2"), part(trees[8:28], "part-3")]
    alone = join_parts(trees[:16], parts[:1])
    assert (alone.parts, alone.joined, alone.stay) == ((), (), tuple(trees[:16]))
    joined = join_parts(trees[:16], parts)
    assert [one.name for one in joined.parts] == ["part-3", "part-2"]
    found = by_number(joined)
    assert sorted(found) == list(range(1, 37))
    np.testing.assert_allclose(sorted(tree.x_m for tree in found.values()), [tree.x_m for tree in trees], atol=0.02)
