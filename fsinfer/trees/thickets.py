"""Circles through saplings and shoots that stand apart are no trees (:mod:`fsinfer.trees.diameter.pieces`).

Listed as trees without a diameter they would count in the stand with the mean section of the others.
"""

from __future__ import annotations

from collections.abc import Sequence

from fsinfer.notices.notice import Notice, notice
from fsinfer.notices.stems import StemCode
from fsinfer.trees.diameter.section import Section
from fsinfer.trees.tree import Tree

#: So many places are named; a thicket has dozens. Source: layout.
NAMED = 10


def without_thickets(
    pairs: Sequence[tuple[Tree, Section]],
) -> tuple[list[tuple[Tree, Section]], tuple[Notice, ...]]:
    """Trees with their sections but for those that are several thin things in a circle, and where these stand."""
    apart = {tree.tree_id for tree, section in pairs if any(why.code == StemCode.in_pieces for why in section.reasons)}
    if not apart:
        return list(pairs), ()
    places = [f"({tree.x_m:.1f}, {tree.y_m:.1f})" for tree, _ in pairs if tree.tree_id in apart]
    named = (*places[:NAMED], "...") if len(places) > NAMED else tuple(places)
    kept = [pair for pair in pairs if pair[0].tree_id not in apart]
    return kept, (notice(StemCode.thickets_left_out, count=len(places), places=named),)
