"""An alarm for double walls: pose errors leave two surfaces of one stem, a few centimetres apart.

Two copies of a stem that lie a shift apart are farthest apart along it and in each other across it. What is as far
apart all round is bark that stands off, ivy, or anything else that has two sizes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsinfer.trees.diameter.sides import NOISE_SECTORS, noise_sector
from fsinfer.trees.points.surface import OUTSIDE_SIGMAS, sector_of

Floats = NDArray[np.float64]


#: Bins of the density across a wall, and limits of its kernel, metres. Source: numerics.
BIN_M, KERNEL_M = 0.002, (0.002, 0.008)
#: Peaks beside the highest that are looked at. Source: numerics.
OTHER_PEAKS = 3


@dataclass(frozen=True, kw_only=True)
class WallSettings:
    """Constants of :func:`two_walls` and :func:`blurred_gap`.

    Attributes
    ----------
    sectors: in which second walls are looked for. Source: chosen on simulated stems.
    reach_m: second walls farther away are other things. Source: chosen on simulated stems.
    min_gap_m: closer walls only thicken the surface, which the residual tells. Source: chosen on simulated stems.
    min_points: in a sector. Source: statistics, a density of two peaks needs twenty points each.
    second_peak: height of the second peak, share of the first: less is a tail. Source: chosen on simulated stems.
    valley: between them, share of the lower peak: a shoulder is no second wall. Source: chosen on simulated stems.
    min_share: of the seen sectors; one sector can be a branch or an ivy stem. Source: chosen on simulated stems.
    min_sectors: 60 degrees. Source: chosen on simulated stems.
    blur_share: second harmonic of the variance over its mean. Source: simulated stems, chance gives 0.03 with 5,000
        points.
    blur_over_haze: second harmonic over the first, which is haze on one side. Source: chosen on simulated stems.
    blur_gap_m: nearer walls cost less than a centimetre. Source: not recorded.
    blur_unseen: share of the circumference that may be unseen. Source: not recorded.
    shift_misfit: of a shift, sum of squares over that of walls as far apart everywhere, up to which it is one. Source:
        simulated stems; scanned twice 2 to 5 cm apart all round 0 to 0.4, from two sides each 0 to 2.5; one wall in
        the other, all round or in part, above 9.
    shift_sectors: with a gap, that a shift must show in. Source: judgement; two or three have the same gap by chance.
    whole_share: of the sectors with a gap, those whose opposite has one, from which on both copies are whole. Source:
        judgement.
    """

    sectors: int = 12
    reach_m: float = 0.08
    min_gap_m: float = 0.012
    min_points: int = 40
    second_peak: float = 0.35
    valley: float = 0.55
    min_share: float = 0.4
    min_sectors: int = 2
    blur_share: float = 0.25
    blur_over_haze: float = 1.5
    blur_gap_m: float = 0.02
    blur_unseen: float = 0.2
    shift_misfit: float = 4.0
    shift_sectors: int = 4
    whole_share: float = 0.75


@dataclass(frozen=True, kw_only=True)
class TwoWalls:
    """Two surfaces of one stem.

    gap_m: how far apart, 0 where there is one only. shifted: whether they are copies of a stem a shift apart.
    whole: whether both are seen all round, as far as the gaps tell.
    """

    gap_m: float = 0.0
    shifted: bool = False
    whole: bool = False


def two_walls(offsets: Floats, residuals: Floats, sigma: float, *, settings: WallSettings | None = None) -> TwoWalls:
    """Two walls, if there are: offsets (N, 2) and residuals (N,) in metres of the axis fit."""
    s = settings or WallSettings()
    near = np.abs(residuals) <= s.reach_m
    sector = sector_of(offsets[near], s.sectors)
    residual = residuals[near]
    gaps = np.full(s.sectors, np.nan)
    for number in range(s.sectors):
        values = residual[sector == number]
        if len(values) >= s.min_points:
            gap = _two_peaks(values, s)
            gaps[number] = gap if gap > max(s.min_gap_m, sigma) else 0.0
    apart = gaps[gaps > 0.0]
    if len(apart) < s.min_sectors or len(apart) < s.min_share * np.isfinite(gaps).sum():
        return TwoWalls()
    shows = gaps > 0.0
    # Copies that are whole are as far apart on one side as on the other.
    whole = bool(
        np.isfinite(gaps).all() and (shows & np.roll(shows, s.sectors // 2)).sum() >= s.whole_share * shows.sum()
    )
    shifted = _is_shift(gaps, max(s.min_gap_m, sigma), s)
    return TwoWalls(gap_m=float(np.median(apart)), shifted=shifted, whole=shifted and whole)


def _is_shift(gaps: Floats, least: float, s: WallSettings) -> bool:
    """Whether gaps (sectors,), NaN where nothing is seen, are those of a shift, which shows from ``least`` on."""
    seen = np.isfinite(gaps)
    middle = (np.arange(len(gaps)) + 0.5) / len(gaps) * 2.0 * np.pi
    found = gaps[seen]
    shows = found > 0.0
    if shows.sum() < s.shift_sectors:
        return False
    # Where there is one wall, only a shift has something to say. Gaps are told in whole bins.
    same = float(((found[shows] - found[shows].mean()) ** 2).sum()) + shows.sum() * BIN_M**2
    best = np.inf
    for direction in np.arange(len(gaps)) / len(gaps) * np.pi:
        share = np.abs(np.cos(middle[seen] - direction))
        shift = float((share * found)[shows].sum() / (share[shows] ** 2).sum())
        # Two walls run together where they are nearer than twice what shows at best.
        told = np.where(shows, shift * share, np.maximum(shift * share - 2.0 * least, 0.0))
        best = min(best, float(((found - told) ** 2).sum()))
    return bool(best <= s.shift_misfit * same)


def _two_peaks(values: Floats, s: WallSettings) -> float:
    """Distance between the two main peaks of a kernel density, or 0."""
    bins = int(2 * s.reach_m / BIN_M)
    bin_ = np.minimum(((values + s.reach_m) / BIN_M).astype(np.int64), bins - 1)
    count = np.bincount(bin_, minlength=bins).astype(np.float64)
    ordered = np.sort(values)
    low, high = ordered[len(values) // 4], ordered[(3 * len(values)) // 4]
    width = float(np.clip(0.5 * (high - low) * len(values) ** -0.2, *KERNEL_M))
    half = int(np.ceil(3 * width / BIN_M))
    kernel = np.exp(-0.5 * (np.arange(-half, half + 1) * BIN_M / width) ** 2)
    density = np.convolve(count, kernel / kernel.sum(), mode="same")
    peak = np.flatnonzero((density[1:-1] > density[:-2]) & (density[1:-1] >= density[2:])) + 1
    if len(peak) < 2:
        return 0.0
    first = peak[np.argmax(density[peak])]
    best = 0.0
    for other in peak[np.argsort(-density[peak])][1 : 1 + OTHER_PEAKS]:
        low_index, high_index = sorted((int(first), int(other)))
        valley = density[low_index : high_index + 1].min()
        if density[other] >= s.second_peak * density[first] and valley <= s.valley * density[other]:
            best = max(best, (high_index - low_index) * BIN_M)
    return best


def blurred_gap(offsets: Floats, residuals: Floats, sigma: float, *, settings: WallSettings | None = None) -> float:
    """Distance between two walls that noise has run together, 0 where nothing speaks for two.

    A copy of the stem shifted by d thickens the wall where the shift is along the normal and not across it: the
    variance of the residuals goes as ``sigma^2 + d^2/4 cos^2``, a second harmonic over the angle. Noise that is worse
    on one side (the usual case in photogrammetry) is a first harmonic. ``offsets`` (N, 2) and ``residuals`` (N,) are of
    the axis fit.
    """
    s = settings or WallSettings()
    near = np.abs(residuals) <= OUTSIDE_SIGMAS * sigma
    sector = noise_sector(offsets[near])
    count = np.bincount(sector, minlength=NOISE_SECTORS)
    if (count < s.min_points).sum() > s.blur_unseen * NOISE_SECTORS:
        return 0.0
    seen = count >= s.min_points
    square = np.bincount(sector, weights=residuals[near] ** 2, minlength=NOISE_SECTORS)[seen] / count[seen]
    middle = ((np.arange(NOISE_SECTORS) + 0.5) / NOISE_SECTORS * 2.0 - 1.0)[seen] * np.pi
    design = np.column_stack(
        [np.ones(len(middle)), np.cos(middle), np.sin(middle), np.cos(2.0 * middle), np.sin(2.0 * middle)]
    )
    a, c1, s1, c2, s2 = np.linalg.lstsq(design, square, rcond=None)[0]
    second = float(np.hypot(c2, s2))
    if second < s.blur_share * a or second < s.blur_over_haze * np.hypot(c1, s1):
        return 0.0
    gap = 2.0 * float(np.sqrt(2.0 * second))
    return gap if gap >= s.blur_gap_m else 0.0
