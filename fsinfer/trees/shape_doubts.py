"""Trees with what the shapes of sections say of their intervals: their own, and those of the plot's other stems."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from fsinfer.notices.notice import notice
from fsinfer.notices.stems import StemCode
from fsinfer.trees.common_shape import common_shape
from fsinfer.trees.diameter.budget import shared_std, total_std
from fsinfer.trees.diameter.dbh_settings import DbhSettings
from fsinfer.trees.diameter.roundness import misfit_std
from fsinfer.trees.diameter.section import Section
from fsinfer.trees.diameter.verdict import too_uncertain, wide_interval
from fsinfer.trees.settings import TreeSettings
from fsinfer.trees.stem_measurement import with_diameter
from fsinfer.trees.tree import Tree

Pair = tuple[Tree, Section]


def allow_for_shape(
    pairs: Sequence[Pair], *, beside: Sequence[Section] = (), settings: TreeSettings | None = None
) -> list[Pair]:
    """The trees of a plot with two parts more in their budgets, by :mod:`fsinfer.trees.diameter.roundness`.

    ``oval``: the section is farther from round than stems are. ``shape``: what it hides may be, since those of the
    plot are. Not before it is clear which entries are stems: a doubt about a shape is none about the stem. Those of
    the plot are ``beside``, too, which have both parts already.
    """
    s = settings or TreeSettings()
    ovals = [
        section.roundness.harmonics[0]
        for section in (*(section for _, section in pairs), *beside)
        # Stems that were refused may be anything, but for those that were refused here.
        if section.roundness is not None and _is_stem(section) and section.coverage >= s.shape.min_coverage
    ]
    factor = common_shape([oval for oval in ovals if oval is not None and oval.known], settings=s.shape)
    return [_allowed(tree, section, factor, s) for tree, section in pairs]


def _is_stem(section: Section) -> bool:
    return section.dbh_m is not None or any(why.code == StemCode.far_from_round for why in section.reasons)


def _allowed(tree: Tree, section: Section, factor: float, s: TreeSettings) -> Pair:
    if section.roundness is None:
        return tree, section
    radius_m = 0.5 * section.dbh_m if section.dbh_m is not None else float(section.circle_m[2])
    oval_m = misfit_std(section.roundness, s.roundness) * radius_m
    shape_m = float(np.sqrt(factor**2 - 1.0)) * section.roundness.left_open_m
    return _with_parts(tree, section, {"oval": oval_m, "shape": shape_m}, s.dbh)


def _with_parts(tree: Tree, section: Section, more_m: Mapping[str, float], limits: DbhSettings) -> Pair:
    """A tree whose radius has ``more_m`` in its budget, metres; doubted or refused where that is much."""
    parts = section.parts_m | dict(more_m)
    sd = 2.0 * total_std(parts)
    # They count as known: the others' degrees of freedom (JCGM 100:2008, G.2b) go with the square of the variance.
    dof = section.dof * (sd / section.sd_m) ** 4
    wider = replace(section, parts_m=parts, sd_m=sd, dof=dof, shared_sd_m=2.0 * shared_std(parts))
    if section.dbh_m is None:
        return tree, wider
    mostly = parts["oval"] > total_std({name: part for name, part in parts.items() if name != "oval"})
    because = (notice(StemCode.far_from_round),) if mostly else ()
    refused = too_uncertain(section.dbh_m, wider.half95_m, limits)
    if refused:
        wider = replace(wider, dbh_m=None, status="unmeasured", reasons=(*refused, *because), outline=None)
        return with_diameter(tree, wider), wider
    kept = tuple(why for why in section.reasons if why.code != StemCode.wide_interval)
    wide = wide_interval(section.dbh_m, wider.half95_m, limits)
    reasons = (*kept, *wide, *because) if wide else kept
    wider = replace(wider, reasons=reasons, status="doubtful" if reasons else section.status)
    return with_diameter(tree, wider), wider
