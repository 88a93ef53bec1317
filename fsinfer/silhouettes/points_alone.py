"""Stems that the points know and no photograph's edges do: how far their diameter is to be believed.

Where photographs show a stem clearly its edges are found. Where they are not, it stands far from the walk or behind
something, and what the depth maps have there is a haze: neighbouring maps err alike, so that the points' scatter, which
is what their interval is made of, tells too little.
"""

from __future__ import annotations

from dataclasses import replace

from fsinfer.notices.notice import notice
from fsinfer.notices.stems import StemCode
from fsinfer.silhouettes.support import said_by_hand
from fsinfer.trees import DbhSettings, Section, Tree
from fsinfer.trees.diameter.budget import shared_std, total_std
from fsinfer.trees.diameter.verdict import too_uncertain, wide_interval
from fsinfer.trees.stem_measurement import with_diameter

#: Parts of the budget that are none of the points' own. Source: the names in the budget.
NOT_OF_POINTS = frozenset({"level", "scale"})
#: Those that need no factor for haze: what unseen sides may be like, and what a haze made of the section's shape.
#: Source: the names in the budget.
OF_SHAPE = frozenset({"shape", "oval"})


def by_points_alone(tree: Tree, section: Section, factor: float, *, dbh: DbhSettings) -> tuple[Tree, Section]:
    """A stem whose points' part of the standard deviation is ``factor`` times as large: doubtful, or too uncertain.

    One that has no diameter stays as it is.
    """
    if section.dbh_m is None:
        return tree, section
    parts = {
        name: part * (1.0 if name in NOT_OF_POINTS | OF_SHAPE else factor) for name, part in section.parts_m.items()
    }
    sd = 2.0 * total_std(parts)
    wider = replace(section, sd_m=sd, parts_m=parts, shared_sd_m=2.0 * shared_std(parts))
    uncertain = too_uncertain(section.dbh_m, wider.half95_m, dbh)
    if uncertain:
        reasons = (*said_by_hand(section), *uncertain)
        refused = replace(wider, dbh_m=None, status="unmeasured", reasons=reasons, outline=None)
        return with_diameter(tree, refused), refused
    kept = tuple(why for why in section.reasons if why.code != StemCode.wide_interval)
    said = (*kept, notice(StemCode.points_alone), *wide_interval(section.dbh_m, wider.half95_m, dbh))
    doubtful = replace(wider, status="doubtful", reasons=said)
    return with_diameter(tree, doubtful), doubtful
