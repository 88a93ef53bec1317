"""What speaks against all stems of a plot alike: then none of them is sure."""

from __future__ import annotations

from dataclasses import replace

from fsinfer.notices.notice import Notice
from fsinfer.trees.diameter.section import Section
from fsinfer.trees.measure import PlotResult
from fsinfer.trees.tree import Tree


def all_doubtful(result: PlotResult, why: Notice) -> PlotResult:
    """The plot with every diameter doubtful for the reason ``why``, which follows the reasons that each has."""

    def doubted(tree: Tree) -> Tree:
        return tree if tree.dbh_cm is None else replace(tree, status="doubtful", reasons=(*tree.reasons, why))

    def of_section(tree: Tree, section: Section) -> Section:
        if tree.dbh_cm is None:
            return section
        return replace(section, status="doubtful", reasons=(*section.reasons, why))

    return replace(
        result,
        trees=tuple(doubted(tree) for tree in result.trees),
        sections=tuple(of_section(*pair) for pair in zip(result.trees, result.sections, strict=True)),
        joined=tuple(doubted(tree) for tree in result.joined),
    )
