"""Where the stems are: a vertical line model, point-to-line distances, and the persistence of arcs over height.

FS-MVSNet (Forests 2025, 16, 927) clusters points about vertical lines. Undergrowth, branches and double walls make
plain clusters run together, so the candidates come from a Hough transform instead: the points of each height band are
thinned to cells, each cell votes along its normal for the centres of all radii, and votes of bands add up over a metre
of height, where only vertical round things agree. Each peak is then verified by fitting a leaning cylinder
(:mod:`fsinfer.trees.axis`): it must be hollow, stand out from its surroundings, and hold on over several bands.
All counts are of cells, whose size follows the measured spacing, never of points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, uniform_filter
from scipy.spatial import cKDTree

from fsinfer.progress import Progress, silent
from fsinfer.trees.axis import AxisFit, AxisSettings, axis_coordinates, fit_axis

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class StemSettings:
    """Constants of :func:`find_stems`."""

    heights_m: tuple[float, float] = (0.5, 2.5)  # above most herbs, below most crowns
    band_m: float = 0.25  # thick enough to hold every row of a sparse scan, thin enough for leaning stems
    window_m: float = 1.0  # bands that vote together; 6 degrees of lean shift a centre by 10 cm over it
    cell_m: float = 0.015  # of the order of the noise; grows with the spacing of sparse clouds
    vote_cell_m: float = 0.03
    radius_m: tuple[float, float] = (0.02, 0.60)
    min_votes: float = 2.5  # cells per band: a third of what a stem of 6 cm diameter seen from one side gives
    max_lean_deg: float = 25.0
    layer_m: float = 0.10  # layers of the persistence check
    min_length_m: float = 0.7  # of supported layers; the bands span 2 m and undergrowth may hide half of them
    min_arc: float = 0.12  # 43 degrees: a stem seen by a sliver is found, though not measured
    max_filled: float = 0.35  # share of points well inside: stems are hollow to the eye, shrubs are not
    min_contrast: float = 1.6  # density on the wall against the density just outside of it
    max_noise: float = 0.40  # sigma over radius; more is a bush
    max_sigma_m: float = 0.028  # the fit's own bound is 3 cm: whoever reaches it has found no wall
    rough_m: float = 0.017  # noisier than the usual photogrammetric cloud (1.5 cm): a shrub, unless it shows ...
    min_rough_length_m: float = 1.2  # ... this much of a stem
    thin_m: float = 0.06  # posts and boards: thinner than this and ...
    post_top_m: float = 2.0  # ... ending below this is no tree
    min_fork_length_m: float = 1.2  # a stem that touches another must show itself more clearly:
    min_fork_arc: float = 0.25
    max_seeds_per_m2: float = 3.0  # 30,000 candidates a hectare bound the time in a thicket


@dataclass(frozen=True, kw_only=True)
class Stem:
    """A verified stem: its axis (heights above ground), the supported height range, and the evidence."""

    axis: AxisFit
    bottom_m: float
    top_m: float
    length_m: float
    arc_coverage: float
    quality: float


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
    seeds = _hough_seeds(slab, cell_m, s)
    thinned = thin(slab, max(0.5 * cell_m, 0.008))
    tree = cKDTree(thinned[:, :2])
    rejected: dict[str, int] = {}
    accepted: list[Stem] = []
    for number, (x, y, height) in enumerate(seeds):
        progress(number, len(seeds), "looking for stems")
        if any(_inside(stem, np.array([x, y]), float(height)) for stem in accepted):
            continue
        near = thinned[tree.query_ball_point([x, y], s.radius_m[1] + 0.15)]
        stem, why = _verify(near, np.array([x, y]), float(height), cell_m, s)
        if stem is None:
            rejected[why] = rejected.get(why, 0) + 1
        else:
            accepted.append(stem)
    stems = _resolve_overlaps(accepted, thinned, tree, cell_m, s)
    return StemSearch(stems=tuple(stems), candidates=len(seeds), rejected=rejected, spacing_m=spacing)


def measured_spacing(points: Floats, *, seed: int = 0) -> float:
    """Median distance to the nearest neighbour, from a random two thousand of the points (N, 3)."""
    rng = np.random.default_rng(seed)
    index = rng.choice(len(points), min(len(points), 2000), replace=False)
    distance = cKDTree(points).query(points[index], k=2)[0][:, 1]
    return float(np.median(distance))


def thin(points: Floats, cell_m: float) -> Floats:
    """One point of each occupied cubic cell of points (N, 3), in their order."""
    if len(points) == 0:
        return points
    cells = np.floor((points - points.min(axis=0)) / cell_m).astype(np.int64)
    extent = cells.max(axis=0) + 1
    key = (cells[:, 0] * extent[1] + cells[:, 1]) * extent[2] + cells[:, 2]
    return points[np.sort(np.unique(key, return_index=True)[1])]


def _hough_seeds(slab: Floats, cell_m: float, s: StemSettings) -> Floats:
    """Candidate centres (K, 3) as x, y, mid height of the window, strongest first."""
    origin = slab[:, :2].min(axis=0) - s.radius_m[1]
    extent = slab[:, :2].max(axis=0) + s.radius_m[1] - origin
    vote_cell = float(max(s.vote_cell_m, np.sqrt(extent[0] * extent[1] / 12e6)))  # bounds the memory to ~100 MB
    shape = tuple(int(v) for v in np.ceil(extent / vote_cell)[::-1] + 1)
    band = np.floor((slab[:, 2] - s.heights_m[0]) / s.band_m).astype(np.int64)
    bands = int(np.ceil((s.heights_m[1] - s.heights_m[0]) / s.band_m))
    votes: list[tuple[Ints, Floats]] = []
    for number in range(bands):
        center, normal, weight = _wall_cells(slab[band == number], cell_m, s.band_m)
        votes.append(_votes(center - origin, normal, weight, vote_cell, shape, s))
    per_window = max(round(s.window_m / s.band_m), 1)
    found = []
    for first in range(0, max(bands - per_window, 0) + 1, max(per_window // 2, 1)):
        chosen = votes[first : first + per_window]
        index = np.concatenate([v[0] for v in chosen])
        weight = np.concatenate([v[1] for v in chosen])
        image = np.bincount(index, weights=weight, minlength=shape[0] * shape[1]).reshape(shape) / per_window
        image = uniform_filter(image, size=3, mode="constant") * 9.0
        peak = (image >= s.min_votes) & (image == maximum_filter(image, size=5, mode="constant"))
        row, column = np.nonzero(peak)
        xy = origin + (np.column_stack([column, row]) + 0.5) * vote_cell
        height = s.heights_m[0] + (first + 0.5 * per_window) * s.band_m
        found.append(np.column_stack([xy, np.full(len(xy), height), image[row, column]]))
    seeds = np.concatenate(found)
    limit = int(np.ceil(s.max_seeds_per_m2 * extent[0] * extent[1])) + 50
    order = np.lexsort((seeds[:, 1], seeds[:, 0], -seeds[:, 3]))[:limit]
    return seeds[order, :3]


def _wall_cells(points: Floats, cell_m: float, band_m: float) -> tuple[Floats, Floats, Floats]:
    """Occupied cells of one band: centre (C, 2), horizontal normal (C, 2), weight (C,).

    The weight is the share of the band's height that the cell fills times how line-like its surroundings are, so that
    vertical walls count and level twigs hardly do.
    """
    if len(points) < 5:
        return np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0)
    steps = 5
    low = points.min(axis=0)
    cells = np.floor((points[:, :2] - low[:2]) / cell_m).astype(np.int64)
    rise = np.minimum((points[:, 2] - low[2]) / (band_m / steps), steps - 1).astype(np.int64)
    width = int(cells[:, 1].max()) + 1
    key = np.unique((cells[:, 0] * width + cells[:, 1]) * steps + rise) // steps
    key, filled = np.unique(key, return_counts=True)
    center = low[:2] + (np.column_stack([key // width, key % width]) + 0.5) * cell_m
    share = filled / steps
    k = min(28, len(center))
    distance, index = cKDTree(center).query(center, k=k, distance_upper_bound=3.6 * cell_m)
    if k == 1:
        return np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0)
    valid = np.isfinite(distance)
    index = np.where(valid, index, 0)
    weight = np.where(valid, share[index], 0.0)
    total = np.maximum(weight.sum(axis=1), 1e-9)
    neighbours = center[index]
    mean = (weight[..., None] * neighbours).sum(axis=1) / total[:, None]
    offset = neighbours - mean[:, None]
    xx = (weight * offset[..., 0] ** 2).sum(axis=1) / total
    yy = (weight * offset[..., 1] ** 2).sum(axis=1) / total
    xy = (weight * offset[..., 0] * offset[..., 1]).sum(axis=1) / total
    # Closed-form eigenvectors of 2x2 matrices: the normal is perpendicular to the major axis.
    angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    difference = np.hypot(xx - yy, 2.0 * xy)
    linear = difference / np.maximum(xx + yy + difference, 1e-12) * 2.0
    normal = np.column_stack([-np.sin(angle), np.cos(angle)])
    alone = valid.sum(axis=1) < 3
    return center[~alone], normal[~alone], (share * np.minimum(linear, 1.0))[~alone]


def _votes(
    center: Floats, normal: Floats, weight: Floats, vote_cell: float, shape: tuple[int, ...], s: StemSettings
) -> tuple[Ints, Floats]:
    radii = np.arange(s.radius_m[0] + 0.5 * vote_cell, s.radius_m[1], vote_cell)
    radii = np.concatenate([-radii, radii])
    position = (center[:, None] + radii[None, :, None] * normal[:, None]) / vote_cell
    column, row = position[..., 0].astype(np.int64), position[..., 1].astype(np.int64)
    inside = (column >= 0) & (row >= 0) & (column < shape[1]) & (row < shape[0])
    return (row * shape[1] + column)[inside], np.broadcast_to(weight[:, None], row.shape)[inside]


def _verify(near: Floats, xy: Floats, height: float, cell_m: float, s: StemSettings) -> tuple[Stem | None, str]:
    window = near[np.abs(near[:, 2] - height) <= 0.5 * s.window_m]
    if len(window) < 8:
        return None, "too few points"
    why = "no ring"
    for radius in _start_radii(window, xy, s):
        stem, why = _verify_ring(near, window, xy, height, radius, cell_m, s)
        if stem is not None:
            return stem, ""
    return None, why


def _verify_ring(
    near: Floats, window: Floats, xy: Floats, height: float, radius: float, cell_m: float, s: StemSettings
) -> tuple[Stem | None, str]:
    start = np.array([xy[0], xy[1], 0.0, 0.0, radius, 0.0])
    # Most candidates run away within a few steps on a few points; only the others are worth more.
    few = fit_axis(_around(window, start, height, radius, 150), start, height, settings=AxisSettings(iterations=7))
    if not s.radius_m[0] * 0.5 <= few.radius_m <= s.radius_m[1] * 1.3:
        return None, "radius out of range"
    around = _around(window, start, height, radius, 600)
    fit = fit_axis(around, few.parameters, height, sigma_m=few.sigma_m, settings=AxisSettings(iterations=14))
    if not s.radius_m[0] * 0.75 <= fit.radius_m <= s.radius_m[1] * 1.1:
        return None, "radius out of range"
    if fit.sigma_m > s.max_sigma_m:
        return None, "not round"
    around = _around(near, fit.parameters, height, fit.radius_m, 600)
    fit = fit_axis(around, fit.parameters, height, sigma_m=fit.sigma_m)
    radius, sigma = fit.radius_m, fit.sigma_m
    if not s.radius_m[0] * 0.75 <= radius <= s.radius_m[1] * 1.1:
        return None, "radius out of range"
    if fit.lean_deg > s.max_lean_deg:
        return None, "leans too much"
    if sigma > min(s.max_noise * radius, s.max_sigma_m):
        return None, "not round"
    offset, foot = axis_coordinates(near, fit.parameters, height)
    distance = np.hypot(offset[:, 0], offset[:, 1])
    residual = distance - (radius + fit.parameters[5] * foot)
    limit = max(2.5 * sigma, 0.6 * cell_m)
    wall = np.abs(residual) <= limit
    layer = np.floor((near[:, 2] - s.heights_m[0]) / s.layer_m).astype(np.int64)
    layers = round((s.heights_m[1] - s.heights_m[0]) / s.layer_m)
    sectors = int(np.clip(2.0 * np.pi * radius / (2.5 * cell_m), 8, 36))
    sector = np.floor((np.arctan2(offset[:, 1], offset[:, 0]) / (2.0 * np.pi) + 0.5) * sectors).astype(np.int64)
    sector = np.clip(sector, 0, sectors - 1)
    seen = np.zeros((layers, sectors), dtype=bool)
    seen[np.clip(layer[wall], 0, layers - 1), sector[wall]] = True
    # A sector belongs to the stem when it is seen in a third of the layers in which anything of the stem is seen.
    active = seen.sum(axis=1) >= max(2, round(0.5 * s.min_arc * sectors))
    if active.sum() * s.layer_m < s.min_length_m:
        return None, "too short"
    own = seen[active].mean(axis=0) >= 1.0 / 3.0
    coverage = float(own.mean())
    if coverage < s.min_arc:
        return None, "arc too small"
    supported = seen[:, own].mean(axis=1) >= 0.4
    length = float(supported.sum() * s.layer_m)
    if length < s.min_length_m:
        return None, "too short"
    if sigma > s.rough_m and length < s.min_rough_length_m:
        return None, "rough and short"
    used = supported[np.clip(layer, 0, layers - 1)]
    deep = used & (residual < -max(3.0 * sigma, 1.2 * cell_m)) & own[sector]
    on_wall = used & wall & own[sector]
    if deep.sum() > s.max_filled * (deep.sum() + on_wall.sum()):
        return None, "filled inside"
    outer = used & own[sector] & (residual > limit) & (residual <= 3.0 * limit)
    wall_area = (radius + limit) ** 2 - max(radius - limit, 0.0) ** 2
    outer_area = (radius + 3.0 * limit) ** 2 - (radius + limit) ** 2
    contrast = (on_wall.sum() / wall_area) / max(outer.sum() / outer_area, 1e-9)
    if contrast < s.min_contrast:
        return None, "does not stand out"
    heights = s.heights_m[0] + (np.flatnonzero(supported) + 0.5) * s.layer_m
    top = float(heights.max() + 0.5 * s.layer_m)
    if top < s.post_top_m and (2.0 * (radius - sigma) < s.thin_m or _is_flat(offset[on_wall], coverage, s)):
        return None, "post or board"
    quality = length * min(coverage, 0.5) * min(contrast, 5.0) / (1.0 + sigma / 0.01)
    bottom = float(heights.min() - 0.5 * s.layer_m)
    stem = Stem(axis=fit, bottom_m=bottom, top_m=top, length_m=length, arc_coverage=coverage, quality=quality)
    return stem, ""


def _is_flat(offsets: Floats, coverage: float, s: StemSettings) -> bool:
    """Whether a line explains the wall as well as the circle does: a board or a plate, no stem."""
    if coverage > 0.35 or len(offsets) < 6:
        return False
    values = np.linalg.eigvalsh(np.cov(offsets.T))
    length = float(np.sqrt(12.0 * values[1]))
    radius = float(np.median(np.hypot(offsets[:, 0], offsets[:, 1])))
    bulge = length**2 / (8.0 * max(radius, 1e-6))
    return bool(4.0 * np.sqrt(max(values[0], 0.0)) < s.thin_m and bulge < 0.5 * s.thin_m)


def _start_radii(window: Floats, xy: Floats, s: StemSettings) -> list[float]:
    """Radii (at most two) whose rings are occupied in most (sector, layer) bins while their insides are empty."""
    step = 0.01
    offset = window[:, :2] - xy
    distance = np.hypot(offset[:, 0], offset[:, 1])
    bins = int(np.ceil((s.radius_m[1] + 0.05) / step))
    ring = np.floor(distance / step).astype(np.int64)
    sector = np.floor((np.arctan2(offset[:, 1], offset[:, 0]) / (2.0 * np.pi) + 0.5) * 16).astype(np.int64) % 16
    layer = np.floor((window[:, 2] - window[:, 2].min()) / s.layer_m).astype(np.int64)
    layers = int(layer.max()) + 1
    use = ring < bins
    occupied = np.zeros((bins, 16, layers), dtype=bool)
    occupied[ring[use], sector[use], layer[use]] = True
    wide = occupied.copy()
    for shift in (1, 2):
        wide[shift:] |= occupied[:-shift]
        wide[:-shift] |= occupied[shift:]
    # Sectors that persist over the layers, not scattered hits.
    persistent = wide.mean(axis=2)
    score = np.where(persistent >= 0.3, persistent, 0.0).mean(axis=1)
    count = np.bincount(ring[use], minlength=bins).astype(np.float64)
    inside = np.concatenate([np.zeros(3), np.cumsum(count)[:-3]])
    upto = np.concatenate([np.cumsum(count)[2:], np.full(2, count.sum())])
    score *= 1.0 - np.minimum(inside / np.maximum(upto, 1.0), 1.0)
    score[: int(s.radius_m[0] / step)] = 0.0
    best = int(np.argmax(score))
    found = [best]
    score_elsewhere = np.where(np.abs(np.arange(bins) - best) > max(3, 0.3 * best), score, 0.0)
    found.append(int(np.argmax(score_elsewhere)))
    return [(ring + 0.5) * step for ring in found if score[ring] > max(0.03, 0.5 * score[best])]


def _around(points: Floats, parameters: Floats, height: float, radius: float, most: int) -> Floats:
    """Points within reach of the fit's window, thinned to about ``most`` (every k-th, so deterministic)."""
    center = parameters[:2] + parameters[2:4] * (points[:, 2:3] - height)
    distance = np.hypot(points[:, 0] - center[:, 0], points[:, 1] - center[:, 1])
    near = points[distance <= radius + float(np.clip(0.8 * radius, 0.05, 0.10))]
    return near[:: max(len(near) // most, 1)]


def _inside(stem: Stem, xy: Floats, height: float) -> bool:
    return bool(np.linalg.norm(stem.axis.center_at(height) - xy) <= stem.axis.radius_m + 0.02)


def _resolve_overlaps(stems: list[Stem], points: Floats, tree: cKDTree, cell_m: float, s: StemSettings) -> list[Stem]:
    """Let the better stem own its wall: a weaker one that touches it must stand without those points.

    Ordered by position, so that the numbering does not depend on the order of the points.
    """
    kept: list[Stem] = []
    for stem in sorted(stems, key=lambda item: -item.quality):
        center = stem.axis.center_at(1.3)
        reach = stem.axis.radius_m + 0.15
        rivals = [o for o in kept if np.linalg.norm(o.axis.center_at(1.3) - center) < reach + o.axis.radius_m]
        if rivals:
            near = points[tree.query_ball_point(center, s.radius_m[1] + 0.15)]
            for other in rivals:
                offset, _ = axis_coordinates(near, other.axis.parameters, other.axis.height_m)
                own = other.axis.radius_m + max(4.0 * other.axis.sigma_m, 1.5 * cell_m)
                near = near[np.hypot(offset[:, 0], offset[:, 1]) > own]
            again, _ = _verify(near, center, 1.3, cell_m, s)
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
