"""One stem, one entry: two stems cannot stand nearer to each other than the sum of their radii.

The search lets the better stem own its wall, but a stem far from all cameras is a haze with several axes, and
measuring moves axes: two entries may end a centimetre apart. Stems grown together, and the stems of a fork, touch; they
do not stand in each other. Where they do and part above, the tree forks at breast height: it has no round section
there, and neither of them is its diameter.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fsinfer.notices.notice import Notice, notice
from fsinfer.notices.stems import StemCode
from fsinfer.trees.diameter.section import Section
from fsinfer.trees.diameter.silhouette import FAINT_CONTRAST
from fsinfer.trees.forks import fork_height
from fsinfer.trees.tree import Tree

Pair = tuple[Tree, Section]
#: How far two entries with a DBH may stand in each other for the errors of their radii, standard deviations of their
#: sum. Source: statistics, 95 %.
IN_EACH_OTHER = 2.0
#: Without a DBH a radius may be anything; it counts for so much at most, metres. Source: geometry, a stem of 30 cm.
UNMEASURED_M = 0.15
#: What is hazy, doubtful or without a DBH, and has no edges in the photographs beside a stem that has, is a haze of
#: that stem, and so is what is hazy and has its DBH by edges alone, which may be that stem's, as far as this share of
#: its radius from it. Source: development plots: torn in three and joined, a wall 18.7 cm beside a stem of 12.5 cm,
#: taken for one of 18.8 cm, 3 cm from it; of some ninety entries without a DBH of ten others two, 1 and 2 cm from a
#: stem, both nothing; undergrown, seed 955025, a wall 1.2 cm from a stem of 17 cm, 16 cm by its edges; renders only.
HAZE_SHARE = 0.5
#: Hazy is a wall whose noise is larger than this, metres, and of which, if it has a DBH, less than this share of a
#: circumference is seen. Source: judgement; the haze of a stem lies on one side of it and is centimetres thick. A
#: neighbour that stands behind something and shows no edges has a bark of millimetres, or is seen from more sides.
HAZE_COVERAGE, HAZE_NOISE_M = 0.4, 0.01
#: The status words in the order of trust; what has none of these comes last.
TRUST = ("ok", "doubtful")


def one_entry_a_stem(pairs: Sequence[Pair], kept: Collection[int] = ()) -> tuple[list[Pair], tuple[Notice, ...]]:
    """The ``pairs`` in their order without those that stand in a better one, and what to say of it.

    A stem whose tree forks at breast height, by the one that stands in it, is doubtful.

    The better one is what a person put there (``kept``, numbers of trees), then the surer one by its status, by
    edges that stand out, by its relative interval, by the share of the stem that was seen. Positions and radii are in
    metres.
    """
    order = sorted(range(len(pairs)), key=lambda i: _rank(pairs[i], kept))
    places = np.array([[tree.x_m, tree.y_m] for tree, _ in pairs]).reshape(-1, 2)
    radii = np.array([_radius_m(section) for _, section in pairs])
    standing: list[int] = []
    forks: dict[int, Pair] = {}
    told = []
    for i in order:
        tree = pairs[i][0]
        # Of thousands of stems only those that reach so far can be the same (:func:`_same`).
        near = np.hypot(*(places - places[i]).T) < (1.0 + HAZE_SHARE) * radii[i] + radii
        inside = next((j for j in standing if near[j] and _same(pairs[i], pairs[j], places[i] - places[j])), None)
        if inside is None or tree.tree_id in kept:
            standing.append(i)
            continue
        better = pairs[inside][0]
        if _is_fork(pairs[i], pairs[inside]):
            forks.setdefault(inside, pairs[i])
        told.append(notice(StemCode.same_stem, x_m=tree.x_m, y_m=tree.y_m, other_x_m=better.x_m, other_y_m=better.y_m))
    return [_forked(pairs[i], forks[i]) if i in forks else pairs[i] for i in sorted(standing)], tuple(told)


def _is_fork(worse: Pair, better: Pair) -> bool:
    """Whether both are stems that are seen from several sides, and part: haze has axes of any direction.

    What no photograph shows edges of, beside a stem that has some, is no stem.
    """
    seen = all(section.dbh_m is not None and section.coverage >= HAZE_COVERAGE for _, section in (worse, better))
    shown = worse[1].silhouette is not None or better[1].silhouette is None
    return seen and shown and fork_height(worse, better) is not None


def _forked(stem: Pair, other: Pair) -> Pair:
    """The stem, doubtful by the one that stands in it."""
    tree, section = stem
    if any(why.code == StemCode.forks_here for why in section.reasons):
        return stem
    reasons = (*section.reasons, notice(StemCode.forks_here, dbh_cm=100.0 * (other[1].dbh_m or 0.0)))
    return replace(tree, status="doubtful", reasons=reasons), replace(section, status="doubtful", reasons=reasons)


def trust_rank(tree: Tree) -> int:
    """Place of the tree's status in the order of trust: the lower, the surer."""
    return TRUST.index(tree.status) if tree.status in TRUST else len(TRUST)


def _rank(pair: Pair, kept: Collection[int]) -> tuple[bool, int, bool, float, float]:
    tree, section = pair
    width = float("inf") if section.dbh_m is None else section.half95_m / section.dbh_m
    return tree.tree_id not in kept, trust_rank(tree), _is_faint(section), width, -tree.arc_coverage


def _is_faint(section: Section) -> bool:
    """Whether its edges stand out only a little."""
    return section.silhouette is not None and section.silhouette.contrast < FAINT_CONTRAST


def _same(worse: Pair, better: Pair, apart: NDArray[np.float64]) -> bool:
    """Whether the worse entry stands in the better one, or is a haze of it."""
    section, other = worse[1], better[1]
    if _in_each_other(section, other, apart):
        return True
    if other.silhouette is None or other.dbh_m is None:
        return False
    if section.silhouette is None:
        one_sided = section.coverage < HAZE_COVERAGE and worse[0].status == "doubtful"
        sizeless = section.dbh_m is None or one_sided
    else:
        by_edges_alone = section.cloud_dbh_m is None and other.cloud_dbh_m is not None
        sizeless = by_edges_alone or (_is_faint(section) and not _is_faint(other))
    gap = float(np.hypot(*apart)) - other.dbh_m / 2.0
    # What one side tells of, and stands in such a stem at all, is its wall, however smooth. Source: development
    # plot, seed 900101: one of 64 +- 14 cm, 0.9 cm rough, through the middle of a stem of 16 cm.
    if sizeless and section.silhouette is None and gap < _radius_m(section):
        return True
    hazy = section.residual_m > HAZE_NOISE_M and sizeless
    return hazy and gap < (1.0 + HAZE_SHARE) * _radius_m(section)


def _radius_m(section: Section) -> float:
    return min(float(section.circle_m[2]), UNMEASURED_M) if section.dbh_m is None else section.dbh_m / 2.0


def _in_each_other(one: Section, other: Section, apart: NDArray[np.float64]) -> bool:
    """Whether two sections whose centres are ``apart`` (2,) overlap by more than their errors; metres."""
    reach = _radius_m(one) + _radius_m(other)
    variance = sum((section.sd_m / 2.0) ** 2 for section in (one, other) if section.dbh_m is not None)
    return float(np.hypot(*apart)) < reach - IN_EACH_OTHER * float(np.sqrt(variance))
