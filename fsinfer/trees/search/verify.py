"""Whether a candidate is a stem: a leaning cylinder that is hollow, stands out from its surroundings, and persists."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsinfer.trees.cylinder.axis import Axis, AxisSettings, axis_coordinates
from fsinfer.trees.cylinder.batch import fit_axes
from fsinfer.trees.points.cells import rows
from fsinfer.trees.points.sums import lengths
from fsinfer.trees.search.stem import Stem, StemSettings

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """A place ``xy`` (2,) where a stem may stand at ``height_m``, with the points ``near`` (N, 3) it; metres."""

    near: Floats
    xy: Floats
    height_m: float


def verify(candidates: Sequence[Candidate], cell_m: float, s: StemSettings) -> list[tuple[Stem | None, str]]:
    """The stem at each candidate, or None and why there is none.

    Candidates do not know of each other; they are taken together because their axes are fitted at once.
    """
    result: list[tuple[Stem | None, str]] = [(None, "too few points")] * len(candidates)
    windows: dict[int, Floats] = {}
    radii: dict[int, list[float]] = {}
    for number, candidate in enumerate(candidates):
        window = rows(candidate.near, np.abs(candidate.near[:, 2] - candidate.height_m) <= 0.5 * s.window_m)
        if len(window) >= s.min_points:
            windows[number], radii[number] = window, _start_radii(window, candidate.xy, s)
            result[number] = None, "no ring"
    # All rings at once; the first that is a stem counts, else what the last one lacks.
    rings = [(n, radius) for n, found in radii.items() for radius in found]
    axes = _fit_rings([candidates[n] for n, _ in rings], [windows[n] for n, _ in rings], [r for _, r in rings], s)
    for (n, _), axis in zip(rings, axes, strict=True):
        if result[n][0] is None:
            result[n] = (None, axis) if isinstance(axis, str) else _judge(candidates[n].near, axis, cell_m, s)
    return result


def _fit_rings(
    candidates: Sequence[Candidate], windows: Sequence[Floats], radii: Sequence[float], s: StemSettings
) -> list[Axis | str]:
    """The axis of each candidate that starts from a ring of the given radius, or why there is none."""
    result: list[Axis | str] = ["radius out of range"] * len(candidates)

    def fit(those: list[int], axes: list[Axis], points: Sequence[Floats], most: int, steps: AxisSettings) -> list[Axis]:
        return fit_axes(
            [_around(points[row], axis, most) for row, axis in zip(those, axes, strict=True)],
            np.array([axis.parameters for axis in axes]).reshape(-1, 6),
            np.array([axis.height_m for axis in axes]),
            sigma_m=np.array([axis.sigma_m for axis in axes]),
            settings=steps,
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
        Axis(parameters=np.array([*c.xy, 0.0, 0.0, radius, 0.0]), height_m=c.height_m, sigma_m=s.start_sigma_m)
        for c, radius in zip(candidates, radii, strict=True)
    ]
    # Most candidates run away within a few steps on a few points; only the others are worth more.
    alive, axes = keep(alive, fit(alive, axes, windows, s.few_points, AxisSettings(iterations=s.few_steps)), 0.5, 1.3)
    alive, axes = keep(
        alive, fit(alive, axes, windows, s.more_points, AxisSettings(iterations=s.more_steps)), 0.75, 1.1
    )
    for row in alive:
        result[row] = "not round"
    round_ = [(row, axis) for row, axis in zip(alive, axes, strict=True) if axis.sigma_m <= s.max_sigma_m]
    alive, axes = [row for row, _ in round_], [axis for _, axis in round_]
    nears = [c.near for c in candidates]
    last = AxisSettings(tolerance=s.tolerance_m)
    for row, axis in zip(alive, fit(alive, axes, nears, s.fit_points, last), strict=True):
        if not s.radius_m[0] * 0.75 <= axis.radius_m <= s.radius_m[1] * 1.1:
            result[row] = "radius out of range"
        elif axis.lean_deg > s.max_lean_deg:
            result[row] = "leans too much"
        elif axis.sigma_m > min(s.max_noise * axis.radius_m, s.max_sigma_m):
            result[row] = "not round"
        else:
            result[row] = axis
    return result


def _judge(near: Floats, fit: Axis, cell_m: float, s: StemSettings) -> tuple[Stem | None, str]:
    """Whether the points show a stem about an axis: persistent, hollow, and standing out."""
    radius, sigma = fit.radius_m, fit.sigma_m
    offset, foot = axis_coordinates(near, fit.parameters, fit.height_m)
    residual = lengths(offset) - (radius + fit.parameters[5] * foot)
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
    window = window[:: max(len(window) // s.ring_points, 1)]
    x, y = window[:, 0] - xy[0], window[:, 1] - xy[1]
    bins = int(np.ceil((s.radius_m[1] + 0.05) / step))
    # The last ring takes all that lies beyond.
    ring = np.minimum((np.sqrt(x * x + y * y) / step).astype(np.int64), bins)
    sector = ((np.arctan2(y, x) / (2.0 * np.pi) + 0.5) * 16).astype(np.int64) % 16
    layer = ((window[:, 2] - window[:, 2].min()) / s.layer_m).astype(np.int64)
    layers = int(layer.max()) + 1
    table = np.zeros((layers, bins + 1, 16), dtype=bool)
    table.ravel()[(layer * (bins + 1) + ring) * 16 + sector] = True
    occupied = table[:, :bins]
    wide = occupied.copy()
    for shift in (1, 2):
        wide[:, shift:] |= occupied[:, :-shift]
        wide[:, :-shift] |= occupied[:, shift:]
    # Sectors that persist over the layers, not scattered hits.
    persistent = wide.sum(axis=0, dtype=np.uint8) / layers
    score = np.where(persistent >= 0.3, persistent, 0.0).mean(axis=1)
    count = np.cumsum(np.bincount(ring, minlength=bins + 1)[:bins]).astype(np.float64)
    inside = np.concatenate([np.zeros(3), count[:-3]])
    upto = np.concatenate([count[2:], np.full(2, count[-1])])
    score *= 1.0 - np.minimum(inside / np.maximum(upto, 1.0), 1.0)
    score[: int(s.radius_m[0] / step)] = 0.0
    best = int(np.argmax(score))
    found = [best]
    score_elsewhere = np.where(np.abs(np.arange(bins) - best) > max(3, 0.3 * best), score, 0.0)
    found.append(int(np.argmax(score_elsewhere)))
    return [(ring + 0.5) * step for ring in found if score[ring] > max(s.min_ring, 0.5 * score[best])]


def _around(points: Floats, axis: Axis, most: int) -> Floats:
    """Points within reach of the fit's window, thinned to at most ``most`` (every k-th, so deterministic)."""
    p = axis.parameters
    rise = points[:, 2] - axis.height_m
    x, y = points[:, 0] - p[0] - p[2] * rise, points[:, 1] - p[1] - p[3] * rise
    near = np.flatnonzero(x * x + y * y <= (p[4] + float(np.clip(0.8 * p[4], 0.05, 0.10))) ** 2)
    return points.take(near[:: -(-len(near) // most) or 1], axis=0)
