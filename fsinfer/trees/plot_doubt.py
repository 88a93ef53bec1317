"""What speaks against all stems of a plot alike: then none of them is sure."""

from __future__ import annotations

from dataclasses import replace

from fsinfer.notices.notice import Notice
from fsinfer.trees.measure import PlotResult


def all_doubtful(result: PlotResult, why: Notice) -> PlotResult:
    """The plot with every diameter doubtful for the reason ``why``, which follows the reasons that each has."""
    trees, sections = [], []
    for tree, section in zip(result.trees, result.sections, strict=True):
        if tree.dbh_cm is None:
            trees.append(tree)
            sections.append(section)
        else:
            trees.append(replace(tree, status="doubtful", reasons=(*tree.reasons, why)))
            sections.append(replace(section, status="doubtful", reasons=(*section.reasons, why)))
    return replace(result, trees=tuple(trees), sections=tuple(sections))
