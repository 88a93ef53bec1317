"""Trees of a plot whose cloud is torn: intervals that hold what two halves apart do to a diameter, and a word of it.

The halves of a stem that slid along each other leave its girth as it was; pulled apart by d they add 2 d to it, pushed
together they take as much away. Which of it happened to a stem depends on the sides from which each part saw it, which
a cloud does not tell, and the outline only roughly: so nothing is corrected, and the mean square of the error over all
that the outline leaves open (:mod:`fsinfer.trees.common_shift`) goes into the budget as the part ``torn``. A stem that
one part alone saw has next to none.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fsinfer.notices.notice import Notice, notice
from fsinfer.notices.stems import StemCode
from fsinfer.trees.common_shift import find_shift
from fsinfer.trees.diameter.budget import shared_std, total_std
from fsinfer.trees.diameter.dbh import DbhSettings, too_uncertain, wide_interval
from fsinfer.trees.diameter.section import Section
from fsinfer.trees.diameter.two_halves import evidence_of_halves
from fsinfer.trees.settings import TreeSettings
from fsinfer.trees.stem_measurement import with_diameter
from fsinfer.trees.tree import Tree

Pairs = list[tuple[Tree, Section]]


def doubt_the_torn(pairs: Pairs, *, settings: TreeSettings | None = None) -> tuple[Pairs, tuple[Notice, ...]]:
    """The trees with intervals that hold the error of halves that are apart, and what to say of it.

    Where no shift shows the trees are those that were given, and there is nothing to say.
    """
    s = settings or TreeSettings()
    evidence = [
        None if section.profile is None else evidence_of_halves(section.profile, settings=s.shift.halves)
        for _, section in pairs
    ]
    # Stems that were refused may be anything.
    sure = [own for own, (_, section) in zip(evidence, pairs, strict=True) if own and section.dbh_m is not None]
    shift = find_shift(sure, settings=s.shift)
    if shift is None:
        return pairs, ()
    wider = [
        pair if own is None else _wider(*pair, s.shift.part_factor * shift.radius_std(own), s.dbh)
        for pair, own in zip(pairs, evidence, strict=True)
    ]
    azimuth = float(np.degrees(0.5 * np.pi - shift.direction_rad)) % 180.0
    said = notice(StemCode.halves_apart, stems=shift.stems, shift_cm=100.0 * shift.size_m, azimuth_deg=azimuth)
    return wider, (said,)


def _wider(tree: Tree, section: Section, torn_m: float, limits: DbhSettings) -> tuple[Tree, Section]:
    """A tree whose radius has the part ``torn`` in its budget, metres, and is doubted or refused where that is much."""
    parts = section.parts_m | {"torn": torn_m}
    sd = 2.0 * total_std(parts)
    # The part counts as known: the others' degrees of freedom (JCGM 100:2008, G.2b) go with the square of the variance.
    dof = section.dof * (sd / section.sd_m) ** 4
    wider = replace(section, parts_m=parts, sd_m=sd, dof=dof, shared_sd_m=2.0 * shared_std(parts))
    if section.dbh_m is None:
        return tree, wider
    refused = too_uncertain(section.dbh_m, wider.half95_m, limits)
    if refused:
        wider = replace(wider, dbh_m=None, status="unmeasured", reasons=refused, outline=None)
        return with_diameter(tree, wider), wider
    kept = tuple(why for why in section.reasons if why.code != StemCode.wide_interval)
    reasons = (*kept, *wide_interval(section.dbh_m, wider.half95_m, limits))
    wider = replace(wider, reasons=reasons, status="doubtful" if reasons else section.status)
    return with_diameter(tree, wider), wider
