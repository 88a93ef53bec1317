"""Whether a candidate is a stem: a leaning cylinder that is hollow, stands out from its surroundings, and persists."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fsinfer.trees.axis import AxisSettings, axis_coordinates, fit_axis
from fsinfer.trees.stem import Stem, StemSettings

Floats = NDArray[np.float64]


def verify(near: Floats, xy: Floats, height: float, cell_m: float, s: StemSettings) -> tuple[Stem | None, str]:
    """The stem at the candidate ``xy`` (2,) among the points ``near`` (N, 3), or None and why there is none."""
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
