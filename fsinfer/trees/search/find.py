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
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fsinfer.progress import Progress, silent
from fsinfer.trees.cylinder.axis import axis_coordinates
from fsinfer.trees.points.cells import PlanIndex, measured_spacing, rows, thin
from fsinfer.trees.search.hough import hough_seeds
from fsinfer.trees.search.stem import Stem, StemSettings
from fsinfer.trees.search.verify import Candidate, verify

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class StemSearch:
    """Stems found and what was turned down, for the diagnosis."""

    stems: tuple[Stem, ...]
    candidates: int
    rejected: dict[str, int]
    spacing_m: float


def find_stems(
    points: Floats, *, settings: StemSettings | None = None, progress: Progress = silent, seed: int = 0
) -> StemSearch:
    """Find stems among points (N, 3) of x, y, height above ground, in metres."""
    s = settings or StemSettings()
    slab = rows(points, (points[:, 2] >= s.heights_m[0]) & (points[:, 2] <= s.heights_m[1]))
    if len(slab) < 20:
        return StemSearch(stems=(), candidates=0, rejected={}, spacing_m=float("nan"))
    spacing = measured_spacing(slab, seed=seed)
    cell_m = float(max(s.cell_m, 1.2 * spacing))
    seeds = hough_seeds(slab, cell_m, s)
    thinned = thin(slab, max(0.5 * cell_m, 0.008))
    index = PlanIndex(thinned, s.index_cell_m)
    accepted, rejected = _search(seeds, index, cell_m, s, progress)
    stems = _resolve_overlaps(accepted, index, cell_m, s)
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
    seeds: Floats, index: PlanIndex, cell_m: float, s: StemSettings, progress: Progress
) -> tuple[list[Stem], dict[str, int]]:
    """The stems at seeds (K, 3) of x, y, height, strongest first, and how many were turned down for which reason.

    In rounds (:func:`_rounds`): a seed inside of a stem that an earlier round has found says nothing new. Nearly all
    stems are found in the first round, so the later ones are looked at ahead, many seeds at a time; what an earlier
    round's stem makes superfluous is dropped afterwards. The stems are those of one round after the other.
    """
    rounds = list(_rounds(seeds[:, :2], s.apart_m))
    order = np.concatenate([np.zeros(0, dtype=np.int64), *rounds])
    turn = np.repeat(np.arange(len(rounds)), [len(chosen) for chosen in rounds])
    first_turn = int(np.count_nonzero(turn == 0))
    bounds = [*range(0, first_turn, s.together), *range(first_turn, len(order), s.together), len(order)]
    places = seeds[order]
    covered = np.full(len(order), len(rounds))  # the first turn after which a stem stands there
    rejected: dict[str, int] = {}
    accepted: list[Stem] = []
    for first, last in pairwise(bounds):
        progress(first, len(seeds), "looking for stems")
        ahead = [row for row in range(first, last) if covered[row] >= turn[row]]
        candidates = [
            Candidate(near=index.near(seed[:2], s.radius_m[1] + 0.15), xy=seed[:2], height_m=float(seed[2]))
            for seed in places[ahead]
        ]
        for row, (stem, why) in zip(ahead, verify(candidates, cell_m, s), strict=True):
            if covered[row] < turn[row]:
                continue
            if stem is None:
                rejected[why] = rejected.get(why, 0) + 1
            else:
                accepted.append(stem)
                inside = _inside(stem, places)
                covered[inside] = np.minimum(covered[inside], turn[row])
    return accepted, rejected


def _inside(stem: Stem, seeds: Floats) -> Bools:
    """Which of the seeds (K, 3) of x, y, height lie inside the stem."""
    p = stem.axis.parameters
    gap = seeds[:, :2] - p[:2] - p[2:4] * (seeds[:, 2:] - stem.axis.height_m)
    return np.asarray((gap**2).sum(axis=1) <= (p[4] + 0.02) ** 2)


def _resolve_overlaps(stems: list[Stem], index: PlanIndex, cell_m: float, s: StemSettings) -> list[Stem]:
    """Let the better stem own its wall: a weaker one that touches it must stand without those points.

    Ordered by position, so that the numbering does not depend on the order of the points.
    """
    kept: list[Stem] = []
    for stem in sorted(stems, key=lambda item: -item.quality):
        center = stem.axis.center_at(1.3)
        reach = stem.axis.radius_m + 0.15
        rivals = [o for o in kept if np.linalg.norm(o.axis.center_at(1.3) - center) < reach + o.axis.radius_m]
        if rivals:
            near = index.near(center, s.radius_m[1] + 0.15)
            for other in rivals:
                offset, _ = axis_coordinates(near, other.axis.parameters, other.axis.height_m)
                own = other.axis.radius_m + max(4.0 * other.axis.sigma_m, 1.5 * cell_m)
                near = near[np.hypot(offset[:, 0], offset[:, 1]) > own]
            ((again, _),) = verify([Candidate(near=near, xy=center, height_m=1.3)], cell_m, s)
            if again is None or again.quality < 0.5 * stem.quality:
                continue
            shift = float(np.linalg.norm(again.axis.center_at(1.3) - center))
            clash = any(
                np.linalg.norm(o.axis.center_at(1.3) - again.axis.center_at(1.3))
                < 0.8 * (o.axis.radius_m + again.axis.radius_m)
                for o in rivals
            )
            # Branch whorls and ivy make short or thin arcs beside a stem; the second stem of a fork is long and round.
            feeble = again.length_m < s.min_fork_length_m or again.arc_coverage < s.min_fork_arc
            if clash or feeble or shift > 0.5 * stem.axis.radius_m:
                continue
            stem = again
        kept.append(stem)
    return sorted(kept, key=lambda item: (round(float(item.axis.center_at(1.3)[0]), 3), item.axis.parameters[1]))
