"""Whether a candidate is a stem: a leaning cylinder that is hollow, stands out from its surroundings, and persists."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsinfer.notices.stems import StemCode
from fsinfer.trees.cylinder.axis import (
    START_SIGMA_M,
    STEPS,
    TOLERANCE,
    Axis,
    AxisSettings,
    above_ground,
    axis_coordinates,
)
from fsinfer.trees.cylinder.batch import fit_axes
from fsinfer.trees.points.cells import PlanIndex, rows
from fsinfer.trees.points.sums import lengths
from fsinfer.trees.points.surface import (
    LAYER_M,
    OUTSIDE_SIGMAS,
    SECTORS,
    SEEN_LAYERS,
    WALL_SIGMAS,
    reach_about_wall,
    sector_of,
)
from fsinfer.trees.search.stem import Stem, StemSettings

Floats = NDArray[np.float64]
#: The slopes (N, 2), dz/dx and dz/dy, of the ground that heights count from at places (N, 2).
Gradient = Callable[[Floats], Floats]
#: Cell of the index, metres, half of the reach of a look around. Source: numerics.
INDEX_CELL_M = 0.375
#: Points this far outside the widest stem are looked at, metres: what it has to stand out from. Source: not recorded.
BESIDE_M = 0.15
#: Points of a candidate, and steps of its fit. In the first most candidates run away, after the next most of the
#: others are not round; only what is left is fitted to the end. Source: numerics.
FIRST_POINTS, FIRST_STEPS, NEXT_POINTS, NEXT_STEPS, LAST_POINTS = 150, 7, 300, 10, 700
#: Where the last fit has arrived, metres: finer than any limit of the search. Source: numerics.
LAST_TOLERANCE = 5e-5
#: Shares of the least and of the greatest radius between which a candidate goes on after the first steps, and after
#: the next. Source: numerics.
FIRST_RANGE, NEXT_RANGE = (0.5, 1.3), (0.75, 1.1)
#: What is looked at about a wall, at most, metres: less than in the measurement. Source: not recorded.
WINDOW_M = 0.10
#: Points of which rings are looked for, some twenty in each sector and layer of a stem; width of a ring in metres,
#: sectors, and rings beyond the greatest radius. Source: numerics.
RING_POINTS, RING_M, RING_SECTORS, RINGS_BEYOND = 3000, 0.01, 16, 5
#: Where fits start: from sectors of a ring that are seen in this share of the layers, and from a second ring, so
#: many rings or this share of the radius away, that has this share of the first one's score. Source: numerics.
RING_LAYERS, RINGS_APART, RINGS_APART_SHARE, SECOND_RING = 0.3, 3, 0.3, 0.5
#: Width of a sector about an axis, in cells. Source: not recorded.
SECTOR_CELLS = 2.5
#: The wall is at least so wide to either side, and the inside begins at least so far from it, in cells.
#: Source: not recorded.
WALL_CELLS, DEEP_CELLS = 0.6, 1.2
#: A layer belongs to the stem when this share of its sectors is seen in it. Source: not recorded.
SEEN_SECTORS = 0.4
#: What lies just outside of a wall: so many times its width. Source: not recorded.
OUTSIDE = 3.0
#: Of coverage and contrast more than this does not make a stem any better; nor does noise far below this make it so,
#: metres. Source: not recorded.
ENOUGH_COVERAGE, ENOUGH_CONTRAST, QUALITY_SIGMA_M = 0.5, 5.0, 0.01
#: Boards show no more of a circle than this. Source: not recorded.
FLAT_COVERAGE = 0.35


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """A place ``xy`` (2,) where a stem may stand at ``height_m``, with the points ``near`` (N, 3) it; metres.

    ``gradient`` is dz/dx and dz/dy of the ground that heights count from: they shear a stem that leans with or against
    the slope, whose section is no circle then.
    """

    near: Floats
    xy: Floats
    height_m: float
    gradient: tuple[float, float] = (0.0, 0.0)

    @property
    def upright(self) -> Floats:
        """``near`` with heights above the level of the ground at ``xy``."""
        if not any(self.gradient):
            return self.near
        plan = self.near[:, :2]
        return np.column_stack([plan, self.near[:, 2] + (plan - self.xy) @ np.asarray(self.gradient)])


def candidates_at(seeds: Floats, index: PlanIndex, s: StemSettings, gradient_at: Gradient) -> list[Candidate]:
    """The candidates at seeds (K, 3) of x, y, height above ground, metres, with the points of the index near them."""
    return [
        Candidate(
            near=index.near(seed[:2], s.radius_m[1] + BESIDE_M),
            xy=seed[:2],
            height_m=float(seed[2]),
            gradient=(float(slope[0]), float(slope[1])),
        )
        for seed, slope in zip(seeds, gradient_at(seeds[:, :2]), strict=True)
    ]


def verify(
    candidates: Sequence[Candidate], cell_m: float, s: StemSettings, *, axis: AxisSettings | None = None
) -> list[Stem | StemCode]:
    """The stem at each candidate, or why there is none; ``axis`` are the constants of the fits.

    Candidates do not know of each other; they are taken together because their axes are fitted at once.
    """
    result: list[Stem | StemCode] = [StemCode.candidate_few_points] * len(candidates)
    nears: dict[int, Floats] = {}
    windows: dict[int, Floats] = {}
    radii: dict[int, list[float]] = {}
    for number, candidate in enumerate(candidates):
        near = candidate.upright
        window = rows(near, np.abs(near[:, 2] - candidate.height_m) <= 0.5 * s.window_m)
        if len(window) >= s.min_points:
            nears[number], windows[number], radii[number] = near, window, _start_radii(window, candidate.xy, s)
            result[number] = StemCode.candidate_no_ring
    # All rings at once; the first that is a stem counts, else what the last one lacks.
    rings = [(n, radius) for n, found in radii.items() for radius in found]
    axes = _fit_rings(
        [candidates[n] for n, _ in rings],
        [windows[n] for n, _ in rings],
        [nears[n] for n, _ in rings],
        [r for _, r in rings],
        s,
        axis,
    )
    for (n, _), fit in zip(rings, axes, strict=True):
        if isinstance(result[n], StemCode):
            result[n] = fit if isinstance(fit, StemCode) else _judge(candidates[n], nears[n], fit, cell_m, s)
    return result


def _fit_rings(
    candidates: Sequence[Candidate],
    windows: Sequence[Floats],
    nears: Sequence[Floats],
    radii: Sequence[float],
    s: StemSettings,
    settings: AxisSettings | None,
) -> list[Axis | StemCode]:
    """The axis of each candidate that starts from a ring of the given radius, or why there is none.

    The axes, the points near each, and those of them in the window about its height, are :attr:`Candidate.upright`.
    """
    result: list[Axis | StemCode] = [StemCode.candidate_radius] * len(candidates)

    def fit(
        those: list[int],
        axes: list[Axis],
        points: Sequence[Floats],
        most: int,
        steps: int = STEPS,
        tolerance: float = TOLERANCE,
    ) -> list[Axis]:
        return fit_axes(
            [_around(points[row], axis, most) for row, axis in zip(those, axes, strict=True)],
            np.array([axis.parameters for axis in axes]).reshape(-1, 6),
            np.array([axis.height_m for axis in axes]),
            sigma_m=np.array([axis.sigma_m for axis in axes]),
            steps=steps,
            tolerance=tolerance,
            settings=settings,
        )

    def keep(those: list[int], axes: list[Axis], low: float, high: float) -> tuple[list[int], list[Axis]]:
        kept = [
            (row, axis)
            for row, axis in zip(those, axes, strict=True)
            if s.radius_m[0] * low <= axis.radius_m <= s.radius_m[1] * high
        ]
        return [row for row, _ in kept], [axis for _, axis in kept]

    alive = list(range(len(candidates)))
    axes = [
        Axis(parameters=np.array([*c.xy, 0.0, 0.0, radius, 0.0]), height_m=c.height_m, sigma_m=START_SIGMA_M)
        for c, radius in zip(candidates, radii, strict=True)
    ]
    # Most candidates run away within a few steps on a few points; only the others are worth more.
    alive, axes = keep(alive, fit(alive, axes, windows, FIRST_POINTS, FIRST_STEPS), *FIRST_RANGE)
    alive, axes = keep(alive, fit(alive, axes, windows, NEXT_POINTS, NEXT_STEPS), *NEXT_RANGE)
    for row in alive:
        result[row] = StemCode.candidate_not_round
    round_ = [(row, axis) for row, axis in zip(alive, axes, strict=True) if axis.sigma_m <= s.max_sigma_m]
    alive, axes = [row for row, _ in round_], [axis for _, axis in round_]
    low, high = NEXT_RANGE
    last = fit(alive, axes, nears, LAST_POINTS, tolerance=LAST_TOLERANCE)
    for row, axis in zip(alive, last, strict=True):
        if not s.radius_m[0] * low <= axis.radius_m <= s.radius_m[1] * high:
            result[row] = StemCode.candidate_radius
        elif axis.lean_deg > s.max_lean_deg:
            result[row] = StemCode.candidate_leans
        elif axis.sigma_m > min(s.max_noise * axis.radius_m, s.max_sigma_m):
            result[row] = StemCode.candidate_not_round
        else:
            result[row] = axis
    return result


def _judge(candidate: Candidate, near: Floats, fit: Axis, cell_m: float, s: StemSettings) -> Stem | StemCode:
    """The stem, if the points show one about an axis: persistent, hollow, and standing out; else why it is none.

    ``near`` (N, 3) are the candidate's points, upright, and so is the axis.
    """
    axis = above_ground(fit, candidate.xy, np.asarray(candidate.gradient))
    if axis is None:
        return StemCode.candidate_leans
    radius, sigma = fit.radius_m, fit.sigma_m
    offset, foot = axis_coordinates(near, fit.parameters, fit.height_m)
    residual = lengths(offset) - (radius + fit.parameters[5] * foot)
    limit = max(WALL_SIGMAS * sigma, WALL_CELLS * cell_m)
    wall = np.abs(residual) <= limit
    layer = np.floor((candidate.near[:, 2] - s.heights_m[0]) / LAYER_M).astype(np.int64)
    layers = round((s.heights_m[1] - s.heights_m[0]) / LAYER_M)
    sectors = int(np.clip(2.0 * np.pi * radius / (SECTOR_CELLS * cell_m), *SECTORS))
    sector = sector_of(offset, sectors)
    seen = np.zeros((layers, sectors), dtype=bool)
    seen[np.clip(layer[wall], 0, layers - 1), sector[wall]] = True
    active = seen.sum(axis=1) >= max(2, round(0.5 * s.min_arc * sectors))
    if active.sum() * LAYER_M < s.min_length_m:
        return StemCode.candidate_short
    own = seen[active].mean(axis=0) >= SEEN_LAYERS
    coverage = float(own.mean())
    if coverage < s.min_arc:
        return StemCode.candidate_small_arc
    supported = seen[:, own].mean(axis=1) >= SEEN_SECTORS
    length = float(supported.sum() * LAYER_M)
    if length < s.min_length_m:
        return StemCode.candidate_short
    if sigma > s.rough_m and length < s.sure_length_m:
        return StemCode.candidate_rough_and_short
    used = supported[np.clip(layer, 0, layers - 1)]
    deep = used & (residual < -max(OUTSIDE_SIGMAS * sigma, DEEP_CELLS * cell_m)) & own[sector]
    on_wall = used & wall & own[sector]
    if deep.sum() > s.max_filled * (deep.sum() + on_wall.sum()):
        return StemCode.candidate_filled
    outer = used & own[sector] & (residual > limit) & (residual <= OUTSIDE * limit)
    wall_area = (radius + limit) ** 2 - max(radius - limit, 0.0) ** 2
    outer_area = (radius + OUTSIDE * limit) ** 2 - (radius + limit) ** 2
    contrast = (on_wall.sum() / wall_area) / max(outer.sum() / outer_area, 1e-9)
    if contrast < s.min_contrast:
        return StemCode.candidate_flush
    heights = s.heights_m[0] + (np.flatnonzero(supported) + 0.5) * LAYER_M
    top = float(heights.max() + 0.5 * LAYER_M)
    if top < s.post_top_m and (2.0 * (radius - sigma) < s.thin_m or _is_flat(offset[on_wall], coverage, s)):
        return StemCode.candidate_post
    quality = length * min(coverage, ENOUGH_COVERAGE) * min(contrast, ENOUGH_CONTRAST) / (1.0 + sigma / QUALITY_SIGMA_M)
    bottom = float(heights.min() - 0.5 * LAYER_M)
    return Stem(axis=axis, bottom_m=bottom, top_m=top, length_m=length, arc_coverage=coverage, quality=quality)


def _is_flat(offsets: Floats, coverage: float, s: StemSettings) -> bool:
    """Whether a line explains the wall as well as the circle does: a board or a plate, no stem."""
    if coverage > FLAT_COVERAGE or len(offsets) < 6:
        return False
    values = np.linalg.eigvalsh(np.cov(offsets.T))
    length = float(np.sqrt(12.0 * values[1]))
    radius = float(np.median(np.hypot(offsets[:, 0], offsets[:, 1])))
    bulge = length**2 / (8.0 * max(radius, 1e-6))
    return bool(4.0 * np.sqrt(max(values[0], 0.0)) < s.thin_m and bulge < 0.5 * s.thin_m)


def _start_radii(window: Floats, xy: Floats, s: StemSettings) -> list[float]:
    """Radii (at most two) whose rings are occupied in most (sector, layer) bins while their insides are empty."""
    window = window[:: max(len(window) // RING_POINTS, 1)]
    x, y = window[:, 0] - xy[0], window[:, 1] - xy[1]
    bins = int(np.ceil(s.radius_m[1] / RING_M)) + RINGS_BEYOND
    # The last ring takes all that lies beyond.
    ring = np.minimum((np.sqrt(x * x + y * y) / RING_M).astype(np.int64), bins)
    sector = sector_of(np.column_stack([x, y]), RING_SECTORS)
    layer = ((window[:, 2] - window[:, 2].min()) / LAYER_M).astype(np.int64)
    layers = int(layer.max()) + 1
    table = np.zeros((layers, bins + 1, RING_SECTORS), dtype=bool)
    table.ravel()[(layer * (bins + 1) + ring) * RING_SECTORS + sector] = True
    occupied = table[:, :bins]
    wide = occupied.copy()
    for shift in (1, 2):
        wide[:, shift:] |= occupied[:, :-shift]
        wide[:, :-shift] |= occupied[:, shift:]
    # Sectors that persist over the layers, not scattered hits.
    persistent = wide.sum(axis=0, dtype=np.uint8) / layers
    score = np.where(persistent >= RING_LAYERS, persistent, 0.0).mean(axis=1)
    count = np.cumsum(np.bincount(ring, minlength=bins + 1)[:bins]).astype(np.float64)
    inside = np.concatenate([np.zeros(3), count[:-3]])
    upto = np.concatenate([count[2:], np.full(2, count[-1])])
    score *= 1.0 - np.minimum(inside / np.maximum(upto, 1.0), 1.0)
    score[: int(s.radius_m[0] / RING_M)] = 0.0
    best = int(np.argmax(score))
    found = [best]
    score_elsewhere = np.where(np.abs(np.arange(bins) - best) > max(RINGS_APART, RINGS_APART_SHARE * best), score, 0.0)
    found.append(int(np.argmax(score_elsewhere)))
    return [(ring + 0.5) * RING_M for ring in found if score[ring] > max(s.min_ring, SECOND_RING * score[best])]


def _around(points: Floats, axis: Axis, most: int) -> Floats:
    """Points within reach of the fit's window, thinned to at most ``most`` (every k-th, so deterministic)."""
    p = axis.parameters
    rise = points[:, 2] - axis.height_m
    x, y = points[:, 0] - p[0] - p[2] * rise, points[:, 1] - p[1] - p[3] * rise
    near = np.flatnonzero(x * x + y * y <= (p[4] + reach_about_wall(p[4], WINDOW_M)) ** 2)
    return points.take(near[:: -(-len(near) // most) or 1], axis=0)
