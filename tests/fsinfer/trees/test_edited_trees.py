"""Corrections by hand follow the trees that they were written for, or are left out."""

from __future__ import annotations

from dataclasses import replace

import pytest

from fsinfer.notices.stems import StemCode
from fsinfer.trees import Tree, analyse_plot
from fsinfer.trees.edit_rows import TreeEdit
from fsinfer.trees.edited_trees import of_these_trees, row_key
from tests.support.stem_clouds import stem_plot

DELETE = TreeEdit(action="delete", row=2, tree_id=2)
MERGE = TreeEdit(action="merge", row=3, tree_id=2, other_id=3)


@pytest.fixture(scope="module")
def some_tree() -> Tree:
    return analyse_plot(stem_plot(seed=4, trees=1, spacing_m=0.02).points).trees[0]


def at(some_tree: Tree, *places: tuple[float, float]) -> list[Tree]:
    """Trees numbered from 1."""
    return [replace(some_tree, tree_id=n, x_m=x, y_m=y) for n, (x, y) in enumerate(places, start=1)]


def test_a_row_follows_its_tree_to_another_number(some_tree: Tree) -> None:
    trees = at(some_tree, (0.0, 0.0), (5.0, 0.0), (2.1, 3.0))
    stood = {row_key(DELETE): {2: (2.0, 3.0)}, row_key(MERGE): {2: (2.0, 3.0), 3: (5.0, 0.1)}}
    kept, (told,) = of_these_trees([DELETE, MERGE], trees, stood)
    assert [(edit.tree_id, edit.other_id) for edit in kept] == [(3, None), (3, 2)]
    assert told.code == StemCode.edits_followed
    assert told.values["trees"] == "2 is 3, 3 is 2"
    # In another unit they stand as near.
    far = [replace(tree, x_m=10.0 * tree.x_m, y_m=10.0 * tree.y_m) for tree in trees]
    wide = {key: {n: (10.0 * x, 10.0 * y) for n, (x, y) in places.items()} for key, places in stood.items()}
    assert of_these_trees([DELETE, MERGE], far, wide, unit=10.0)[0] == kept


@pytest.mark.parametrize(
    ("other", "number"),
    [
        ((2.2, 3.0), 3),  # another stands where it stood
        ((2.4, 3.0), 2),  # none does, and that of the number not far
    ],
)
def test_the_tree_at_the_place_is_meant_before_that_of_the_number(
    some_tree: Tree, other: tuple[float, float], number: int
) -> None:
    trees = at(some_tree, (0.0, 0.0), (2.0, 3.9), other)
    kept, told = of_these_trees([DELETE], trees, {row_key(DELETE): {2: (2.0, 3.0)}})
    assert [edit.tree_id for edit in kept] == [number]
    assert len(told) == (number != 2)


def test_a_tree_that_stays_is_not_told_of(some_tree: Tree) -> None:
    trees = at(some_tree, (0.0, 0.0), (2.0, 3.0), (2.0, 3.0))  # two entries of one stem
    assert of_these_trees([DELETE], trees, {row_key(DELETE): {2: (2.0, 3.0)}}) == ([DELETE], ())
    assert of_these_trees([DELETE], trees, {}) == ([DELETE], ())


def test_a_row_without_its_tree_is_left_out(some_tree: Tree) -> None:
    trees = at(some_tree, (0.0, 0.0), (2.0, 4.1), (2.0, 3.0))
    nowhere = {row_key(DELETE): {2: (2.0, 5.2)}, row_key(MERGE): {2: (2.1, 3.0), 3: (2.0, 2.9)}}
    kept, (told,) = of_these_trees([DELETE, MERGE], trees, nowhere)
    assert kept == []
    assert (told.code, told.values["rows"], told.values["trees"]) == (StemCode.edits_left_out, "2, 3", "2, 3")
    placed = replace(DELETE, x_m=2.0, y_m=3.0)  # what the row says itself is believed
    assert [edit.tree_id for edit in of_these_trees([placed], trees, nowhere)[0]] == [3]
    assert of_these_trees([DELETE], [], nowhere)[0] == []
