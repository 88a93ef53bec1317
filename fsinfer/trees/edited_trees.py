"""Where trees stood that corrections by hand name by their numbers: another cloud has other trees of those numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from fsinfer.notices.notice import Notice, notice
from fsinfer.notices.stems import StemCode
from fsinfer.trees.edit_rows import TreeEdit
from fsinfer.trees.tree import Tree

#: Places x, y of trees by their numbers.
Places = Mapping[int, tuple[float, float]]
#: Those of the trees that a row names, by what the row says.
RowPlaces = Mapping[str, Places]
#: A tree is another one if it stands farther than this from where the one of its number stood, metres. Source:
#: judgement; another scale or depth moves a tree by less, and few stems of a stand are so near to each other.
ELSEWHERE_M = 1.0
#: The tree that stands as near to that place, metres, is the one that is meant, whatever its number is now. Source:
#: judgement; the same stem in another version's map is found within centimetres.
SAME_PLACE_M = 0.3


def row_key(edit: TreeEdit) -> str:
    """What a row says of trees by their numbers; "" where it names none."""
    return "" if edit.action == "add" else f"{edit.action} {edit.tree_id} {edit.other_id}"


def places_of(edit: TreeEdit, places: Places) -> Places:
    """The ``places`` of the trees that a row names, as far as they are known."""
    named = () if edit.action == "add" else (edit.tree_id, edit.other_id)
    return {number: places[number] for number in named if number is not None and number in places}


def of_these_trees(
    edits: Sequence[TreeEdit], trees: Sequence[Tree], stood: RowPlaces, *, unit: float = 1.0
) -> tuple[list[TreeEdit], tuple[Notice, ...]]:
    """The edits of the trees that stand where those of the rows stood, by their numbers now, and notices of the others.

    Another version, or other photographs, number the same stems anew: a row follows its tree. One whose tree stands
    nowhere near is left out.

    Parameters
    ----------
    trees: as they were found. stood: where the trees stood that the rows were written for, in their frame; a row that
        tells the place of its tree, ``x_m`` and ``y_m``, is believed.
    unit: of their frame, that a metre makes.
    """
    now = {tree.tree_id: (tree.x_m, tree.y_m) for tree in trees}
    kept: list[TreeEdit] = []
    left_out: list[TreeEdit] = []
    followed: list[str] = []
    for edit in edits:
        before = stood.get(row_key(edit), {})
        if edit.action != "add" and edit.tree_id is not None and edit.x_m is not None and edit.y_m is not None:
            before = {edit.tree_id: (edit.x_m, edit.y_m)}
        found = {number: _number_at(number, place, now, unit) for number, place in before.items()}
        if None in found.values() or len(set(found.values())) < len(found):
            left_out.append(edit)
            continue
        first, other = ((None if n is None else found.get(n, n)) for n in (edit.tree_id, edit.other_id))
        kept.append(replace(edit, tree_id=first, other_id=other))
        followed += [f"{n} is {to}" for n, to in found.items() if n != to]
    told: list[Notice] = []
    if followed:
        told.append(notice(StemCode.edits_followed, trees=", ".join(dict.fromkeys(followed))))
    if left_out:
        rows = ", ".join(str(edit.row) for edit in left_out)
        named = sorted({n for edit in left_out for n in (edit.tree_id, edit.other_id) if n is not None})
        told.append(notice(StemCode.edits_left_out, rows=rows, trees=", ".join(map(str, named))))
    return kept, tuple(told)


def _number_at(number: int, place: tuple[float, float], now: Places, unit: float) -> int | None:
    """The number that a tree has now which stood at ``place`` and had ``number``; None where it is gone."""
    away = {other: math.dist(at, place) for other, at in now.items()}
    nearest = min(away, key=lambda other: (away[other], other != number), default=None)
    if nearest is not None and away[nearest] <= SAME_PLACE_M * unit:
        return nearest
    return number if away.get(number, math.inf) <= ELSEWHERE_M * unit else None
