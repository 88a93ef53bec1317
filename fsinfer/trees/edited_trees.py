"""Where trees stood that corrections by hand name by their numbers: another cloud has other trees of those numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

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
    """The edits without those whose trees stood elsewhere, and a notice of these.

    Parameters
    ----------
    trees: as they were found. stood: where the trees stood that the rows were written for, in their frame; a row that
        tells the place of its tree, ``x_m`` and ``y_m``, is believed.
    unit: of their frame, that a metre makes.
    """
    now = {tree.tree_id: (tree.x_m, tree.y_m) for tree in trees}
    kept: list[TreeEdit] = []
    left_out: list[TreeEdit] = []
    for edit in edits:
        before = stood.get(row_key(edit), {})
        if edit.action != "add" and edit.tree_id is not None and edit.x_m is not None and edit.y_m is not None:
            before = {edit.tree_id: (edit.x_m, edit.y_m)}
        gone = any(n not in now or math.dist(now[n], place) > ELSEWHERE_M * unit for n, place in before.items())
        (left_out if gone else kept).append(edit)
    if not left_out:
        return kept, ()
    rows = ", ".join(str(edit.row) for edit in left_out)
    named = sorted({n for edit in left_out for n in (edit.tree_id, edit.other_id) if n is not None})
    return kept, (notice(StemCode.edits_left_out, rows=rows, trees=", ".join(map(str, named))),)
