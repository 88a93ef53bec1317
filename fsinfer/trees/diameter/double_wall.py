"""An alarm for double walls: pose errors leave two surfaces of one stem, a few centimetres apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class WallSettings:
    """Constants of :func:`wall_gap` and :func:`blurred_gap`."""

    sectors: int = 12
    bin_m: float = 0.002
    reach_m: float = 0.08  # second walls farther away are other things
    min_gap_m: float = 0.012  # closer walls only thicken the surface, which the residual tells
    min_points: int = 40  # in a sector: a density of two peaks needs twenty points each
    second_peak: float = 0.35  # of the first: less is a tail
    valley: float = 0.55  # of the lower peak: a shoulder is no second wall
    min_share: float = 0.4  # of the seen sectors; one sector can be a branch or an ivy stem
    min_sectors: int = 2  # 60 degrees
    blur_sectors: int = 24
    blur_share: float = 0.25  # second harmonic of the variance over its mean; chance gives 0.03 with 5,000 points
    blur_gap_m: float = 0.02  # nearer walls cost less than a centimetre


def wall_gap(offsets: Floats, residuals: Floats, sigma: float, *, settings: WallSettings | None = None) -> float:
    """Distance in metres between two walls, 0 when there is one: offsets (N, 2) and residuals (N,) of the axis fit."""
    s = settings or WallSettings()
    near = np.abs(residuals) <= s.reach_m
    angle = np.arctan2(offsets[near, 1], offsets[near, 0])
    sector = np.minimum(((angle + np.pi) / (2.0 * np.pi) * s.sectors).astype(int), s.sectors - 1)
    residual = residuals[near]
    seen, gaps = 0, []
    for number in range(s.sectors):
        values = residual[sector == number]
        if len(values) < s.min_points:
            continue
        seen += 1
        gap = _two_peaks(values, s)
        if gap > max(s.min_gap_m, 1.0 * sigma):
            gaps.append(gap)
    if len(gaps) >= s.min_sectors and len(gaps) >= s.min_share * seen:
        return float(np.median(gaps))
    return 0.0


def _two_peaks(values: Floats, s: WallSettings) -> float:
    """Distance between the two main peaks of a kernel density, or 0."""
    bins = int(2 * s.reach_m / s.bin_m)
    bin_ = np.minimum(((values + s.reach_m) / s.bin_m).astype(np.int64), bins - 1)
    count = np.bincount(bin_, minlength=bins).astype(np.float64)
    ordered = np.sort(values)
    low, high = ordered[len(values) // 4], ordered[(3 * len(values)) // 4]
    width = float(np.clip(0.5 * (high - low) * len(values) ** -0.2, 0.002, 0.008))
    half = int(np.ceil(3 * width / s.bin_m))
    kernel = np.exp(-0.5 * (np.arange(-half, half + 1) * s.bin_m / width) ** 2)
    density = np.convolve(count, kernel / kernel.sum(), mode="same")
    peak = np.flatnonzero((density[1:-1] > density[:-2]) & (density[1:-1] >= density[2:])) + 1
    if len(peak) < 2:
        return 0.0
    first = peak[np.argmax(density[peak])]
    best = 0.0
    for other in peak[np.argsort(-density[peak])][1:4]:
        low_index, high_index = sorted((int(first), int(other)))
        valley = density[low_index : high_index + 1].min()
        if density[other] >= s.second_peak * density[first] and valley <= s.valley * density[other]:
            best = max(best, (high_index - low_index) * s.bin_m)
    return best


def blurred_gap(offsets: Floats, residuals: Floats, sigma: float, *, settings: WallSettings | None = None) -> float:
    """Distance between two walls that noise has run together, 0 where nothing speaks for two.

    A copy of the stem shifted by d thickens the wall where the shift is along the normal and not across it: the
    variance of the residuals goes as ``sigma^2 + d^2/4 cos^2``, a second harmonic over the angle. Noise that is worse
    on one side (the usual case in photogrammetry) is a first harmonic. ``offsets`` (N, 2) and ``residuals`` (N,) are of
    the axis fit.
    """
    s = settings or WallSettings()
    near = np.abs(residuals) <= 3.0 * sigma
    angle = np.arctan2(offsets[near, 1], offsets[near, 0])
    sector = np.minimum(((angle + np.pi) / (2.0 * np.pi) * s.blur_sectors).astype(int), s.blur_sectors - 1)
    count = np.bincount(sector, minlength=s.blur_sectors)
    if (count < s.min_points).sum() > 0.2 * s.blur_sectors:
        return 0.0
    seen = count >= s.min_points
    square = np.bincount(sector, weights=residuals[near] ** 2, minlength=s.blur_sectors)[seen] / count[seen]
    middle = ((np.arange(s.blur_sectors) + 0.5) / s.blur_sectors * 2.0 - 1.0)[seen] * np.pi
    design = np.column_stack(
        [np.ones(len(middle)), np.cos(middle), np.sin(middle), np.cos(2.0 * middle), np.sin(2.0 * middle)]
    )
    a, c1, s1, c2, s2 = np.linalg.lstsq(design, square, rcond=None)[0]
    second = float(np.hypot(c2, s2))
    if second < s.blur_share * a or second < 1.5 * np.hypot(c1, s1):
        return 0.0
    gap = 2.0 * float(np.sqrt(2.0 * second))
    return gap if gap >= s.blur_gap_m else 0.0
