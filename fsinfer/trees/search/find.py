"""Where the stems are: a vertical line model, point-to-line distances, and the persistence of arcs over height.

FS-MVSNet (Forests 2025, 16, 927) clusters points about vertical lines. Undergrowth, branches and double walls make
plain clusters run together, so the candidates come from a Hough transform instead: the points of each height band are
thinned to cells, each cell votes along its normal for the centres of all radii, and votes of bands add up over a metre
of height, where only vertical round things agree. Each peak is then verified by fitting a leaning cylinder
(:mod:`fsinfer.trees.search.verify`): it must be hollow, stand out from its surroundings, and hold on over several
bands. All counts are of cells, whose size follows the measured spacing, never of points.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fsinfer.conventions.breast_height import BREAST_HEIGHT_M
from fsinfer.notices.stems import StemCode
from fsinfer.progress import Progress, silent
from fsinfer.trees.cylinder.axis import axis_coordinates
from fsinfer.trees.points.cells import PlanIndex, measured_spacing, rows, thin
from fsinfer.trees.search.blurred import with_blurred
from fsinfer.trees.search.giants import find_giants
from fsinfer.trees.search.hough import hough_seeds
from fsinfer.trees.search.stem import Stem, StemSettings
from fsinfer.trees.search.verify import BESIDE_M, INDEX_CELL_M, Gradient, candidates_at, verify

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
#: Least points between the heights of the search. Source: not recorded.
LEAST_POINTS = 20
#: Candidates looked at at once: bounds the memory, and fills the batches of the fits. Source: numerics.
TOGETHER = 256
#: Candidates farther apart are looked at together; both may find one stem, which is resolved. Metres. Source: numerics.
APART_M = 0.3
#: Cells grow with the spacing of a sparse cloud. Source: not recorded.
CELL_OF_SPACING = 1.2
#: Points are thinned to half a cell, but not below so many metres. Source: numerics.
LEAST_THINNING_M = 0.008
#: The wall of a stem that another touches: its noise, and cells, whichever is more. Source: not recorded.
OWN_SIGMAS, OWN_CELLS = 4.0, 1.5
#: A weaker stem that touches another must keep this share of its quality without the other's points, stay within this
#: share of its radius, and apart by this share of both radii. Source: not recorded.
KEPT_QUALITY, KEPT_PLACE, KEPT_APART = 0.5, 0.5, 0.8


@dataclass(frozen=True, kw_only=True)
class StemSearch:
    """Stems found and what was turned down, for the diagnosis."""

    stems: tuple[Stem, ...]
    candidates: int
    rejected: dict[StemCode, int]
    spacing_m: float


def find_stems(
    points: Floats,
    *,
    bh_m: float = BREAST_HEIGHT_M,
    settings: StemSettings | None = None,
    progress: Progress = silent,
    seed: int = 0,
    gradient_at: Gradient | None = None,
) -> StemSearch:
    """Find stems among points (N, 3) of x, y, height above ground, in metres; neighbours meet at ``bh_m``.

    ``gradient_at`` gives the slope (N, 2) of that ground at places (N, 2); level without it.
    """
    gradient_at = gradient_at or np.zeros_like
    s = settings or StemSettings()
    slab = rows(points, (points[:, 2] >= s.heights_m[0]) & (points[:, 2] <= s.heights_m[1]))
    if len(slab) < LEAST_POINTS:
        return StemSearch(stems=(), candidates=0, rejected={}, spacing_m=float("nan"))
    spacing = measured_spacing(slab, seed=seed)
    cell_m = float(max(s.cell_m, CELL_OF_SPACING * spacing))
    seeds = hough_seeds(slab, cell_m, s)
    thinned = thin(slab, max(0.5 * cell_m, LEAST_THINNING_M))
    index = PlanIndex(thinned, INDEX_CELL_M)
    accepted, rejected = _search(seeds, index, cell_m, s, progress, gradient_at)
    stems = _resolve_overlaps(accepted, index, cell_m, bh_m, s, gradient_at)
    stems += find_giants(slab, stems, spacing, s, gradient_at)
    stems = _in_order(with_blurred(thinned, stems, cell_m, s, gradient_at), bh_m)
    return StemSearch(stems=tuple(stems), candidates=len(seeds), rejected=rejected, spacing_m=spacing)


def _rounds(xy: Floats, apart_m: float) -> Iterator[Ints]:
    """Rows of places (K, 2), strongest first, in rounds: none has a stronger one nearer than ``apart_m`` still to come.

    Places of one round lie apart, so that seldom two of them find the same stem.
    """
    pairs = cKDTree(xy).query_pairs(apart_m, output_type="ndarray") if len(xy) else np.zeros((0, 2), dtype=np.int64)
    number = np.zeros(len(xy), dtype=np.int64)
    # By the weaker of the two, so that the stronger one's round is known.
    stronger, weaker = pairs.min(axis=1), pairs.max(axis=1)
    order = np.lexsort((stronger, weaker))
    for first, second in zip(stronger[order].tolist(), weaker[order].tolist(), strict=True):
        number[second] = max(number[second], number[first] + 1)
    for this in range(int(number.max(initial=-1)) + 1):
        yield np.flatnonzero(number == this)


def _search(
    seeds: Floats, index: PlanIndex, cell_m: float, s: StemSettings, progress: Progress, gradient_at: Gradient
) -> tuple[list[Stem], dict[StemCode, int]]:
    """The stems at seeds (K, 3) of x, y, height, strongest first, and how many were turned down for which reason.

    In rounds (:func:`_rounds`): a seed inside of a stem that an earlier round has found says nothing new. Nearly all
    stems are found in the first round, so the later ones are looked at ahead, many seeds at a time; what an earlier
    round's stem makes superfluous is dropped afterwards. The stems are those of one round after the other.
    """
    rounds = list(_rounds(seeds[:, :2], APART_M))
    order = np.concatenate([np.zeros(0, dtype=np.int64), *rounds])
    turn = np.repeat(np.arange(len(rounds)), [len(chosen) for chosen in rounds])
    first_turn = int(np.count_nonzero(turn == 0))
    bounds = [*range(0, first_turn, TOGETHER), *range(first_turn, len(order), TOGETHER), len(order)]
    places = seeds[order]
    covered = np.full(len(order), len(rounds))  # the first turn after which a stem stands there
    rejected: dict[StemCode, int] = {}
    accepted: list[Stem] = []
    for first, last in pairwise(bounds):
        progress(first, len(seeds), "looking for stems")
        ahead = [row for row in range(first, last) if covered[row] >= turn[row]]
        candidates = candidates_at(places[ahead], index, s, gradient_at)
        for row, found in zip(ahead, verify(candidates, cell_m, s), strict=True):
            if covered[row] < turn[row]:
                continue
            if isinstance(found, StemCode):
                rejected[found] = rejected.get(found, 0) + 1
            else:
                accepted.append(found)
                inside = _inside(found, places, s.radius_m[0])
                covered[inside] = np.minimum(covered[inside], turn[row])
    return accepted, rejected


def _inside(stem: Stem, seeds: Floats, least_radius_m: float) -> Bools:
    """Which of the seeds (K, 3) of x, y, height lie inside the stem, or within the least radius of it."""
    p = stem.axis.parameters
    gap = seeds[:, :2] - p[:2] - p[2:4] * (seeds[:, 2:] - stem.axis.height_m)
    return np.asarray((gap**2).sum(axis=1) <= (p[4] + least_radius_m) ** 2)


def _in_order(stems: list[Stem], bh_m: float) -> list[Stem]:
    """By position, so that the numbering does not depend on the order of the points."""
    return sorted(stems, key=lambda item: (round(float(item.axis.center_at(bh_m)[0]), 3), item.axis.parameters[1]))


def _resolve_overlaps(
    stems: list[Stem],
    index: PlanIndex,
    cell_m: float,
    bh_m: float,
    s: StemSettings,
    gradient_at: Gradient = np.zeros_like,
) -> list[Stem]:
    """Let the better stem own its wall: a weaker one that touches it must stand without those points."""
    kept: list[Stem] = []
    places, radii = np.empty((len(stems), 2)), np.empty(len(stems))  # of those kept
    for stem in sorted(stems, key=lambda item: -item.quality):
        center = stem.axis.center_at(bh_m)
        reach = stem.axis.radius_m + BESIDE_M
        apart = np.hypot(*(places[: len(kept)] - center).T)
        rivals = [kept[row] for row in np.flatnonzero(apart < reach + radii[: len(kept)])]
        if rivals:
            (alone,) = candidates_at(np.append(center, bh_m)[None], index, s, gradient_at)
            near = alone.near
            for other in rivals:
                offset, _ = axis_coordinates(near, other.axis.parameters, other.axis.height_m)
                own = other.axis.radius_m + max(OWN_SIGMAS * other.axis.sigma_m, OWN_CELLS * cell_m)
                near = near[np.hypot(offset[:, 0], offset[:, 1]) > own]
            (again,) = verify([replace(alone, near=near)], cell_m, s)
            if isinstance(again, StemCode) or again.quality < KEPT_QUALITY * stem.quality:
                continue
            shift = float(np.linalg.norm(again.axis.center_at(bh_m) - center))
            clash = any(
                np.linalg.norm(o.axis.center_at(bh_m) - again.axis.center_at(bh_m))
                < KEPT_APART * (o.axis.radius_m + again.axis.radius_m)
                for o in rivals
            )
            # Branch whorls and ivy make short or thin arcs beside a stem; the second stem of a fork is long and round.
            feeble = again.length_m < s.sure_length_m or again.arc_coverage < s.sure_arc
            if clash or feeble or shift > KEPT_PLACE * stem.axis.radius_m:
                continue
            stem = again
        places[len(kept)], radii[len(kept)] = stem.axis.center_at(bh_m), stem.axis.radius_m
        kept.append(stem)
    return kept
