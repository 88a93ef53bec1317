"""Where the stems are: a vertical line model, point-to-line distances, and the persistence of arcs over height.

FS-MVSNet (Forests 2025, 16, 927) clusters points about vertical lines. Undergrowth, branches and double walls make
plain clusters run together, so the candidates come from a Hough transform instead: the points of each height band are
thinned to cells, each cell votes along its normal for the centres of all radii, and votes of bands add up over a metre
of height, where only vertical round things agree. Each peak is then verified by fitting a leaning cylinder
(:mod:`fsinfer.trees.verification`): it must be hollow, stand out from its surroundings, and hold on over several bands.
All counts are of cells, whose size follows the measured spacing, never of points.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fsinfer.progress import Progress, silent
from fsinfer.trees.axis import axis_coordinates
from fsinfer.trees.cells import PlanIndex, measured_spacing, thin
from fsinfer.trees.hough import hough_seeds
from fsinfer.trees.stem import Stem, StemSettings
from fsinfer.trees.verification import Candidate, verify

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


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
    slab = points[(points[:, 2] >= s.heights_m[0]) & (points[:, 2] <= s.heights_m[1])]
    if len(slab) < 20:
        return StemSearch(stems=(), candidates=0, rejected={}, spacing_m=float("nan"))
    spacing = measured_spacing(slab, seed=seed)
    cell_m = float(max(s.cell_m, 1.2 * spacing))
    seeds = hough_seeds(slab, cell_m, s)
    thinned = thin(slab, max(0.5 * cell_m, 0.008))
    index = PlanIndex(thinned, s.index_cell_m)
    rejected: dict[str, int] = {}
    accepted: list[Stem] = []
    done = 0
    for chosen in _rounds(seeds[:, :2], s.apart_m):
        progress(done, len(seeds), "looking for stems")
        done += len(chosen)
        # In the order of their votes: a seed inside of a stem that a stronger one has found says nothing new.
        candidates = [
            Candidate(near=index.near(seed[:2], s.radius_m[1] + 0.15), xy=seed[:2], height_m=float(seed[2]))
            for seed in seeds[chosen]
            if not _is_inside(accepted, seed[:2], float(seed[2]))
        ]
        for stem, why in verify(candidates, cell_m, s):
            if stem is None:
                rejected[why] = rejected.get(why, 0) + 1
            else:
                accepted.append(stem)
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


def _is_inside(stems: list[Stem], xy: Floats, height: float) -> bool:
    """Whether the position (2,) at ``height`` lies inside one of the stems."""
    if not stems:
        return False
    p = np.array([stem.axis.parameters[:5] for stem in stems])
    at = np.array([stem.axis.height_m for stem in stems])
    gap = p[:, :2] + p[:, 2:4] * (height - at)[:, None] - xy
    return bool((np.hypot(gap[:, 0], gap[:, 1]) <= p[:, 4] + 0.02).any())


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
