"""An alarm for double walls: pose errors leave two surfaces of one stem, a few centimetres apart."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

SECTORS = 12
BIN_M = 0.002
REACH_M = 0.08  # second walls farther away are other things
MIN_GAP_M = 0.012  # closer walls only thicken the surface, which the residual tells
MIN_POINTS = 40  # in a sector: a density of two peaks needs twenty points each
SECOND_PEAK = 0.35  # of the first: less is a tail
VALLEY = 0.55  # of the lower peak: a shoulder is no second wall
MIN_SHARE = 0.4  # of the seen sectors; one sector can be a branch or an ivy stem
MIN_SECTORS = 2  # 60 degrees
BLUR_SECTORS = 24
BLUR_SHARE = 0.25  # second harmonic of the variance over its mean; chance gives 0.03 with 5,000 points
BLUR_GAP_M = 0.02  # nearer walls cost less than a centimetre


def wall_gap(offsets: Floats, residuals: Floats, sigma: float) -> float:
    """Distance in metres between two walls, 0 when there is one: offsets (N, 2) and residuals (N,) of the axis fit."""
    near = np.abs(residuals) <= REACH_M
    angle = np.arctan2(offsets[near, 1], offsets[near, 0])
    sector = np.minimum(((angle + np.pi) / (2.0 * np.pi) * SECTORS).astype(int), SECTORS - 1)
    residual = residuals[near]
    seen, gaps = 0, []
    for number in range(SECTORS):
        values = residual[sector == number]
        if len(values) < MIN_POINTS:
            continue
        seen += 1
        gap = _two_peaks(values)
        if gap > max(MIN_GAP_M, 1.0 * sigma):
            gaps.append(gap)
    if len(gaps) >= MIN_SECTORS and len(gaps) >= MIN_SHARE * seen:
        return float(np.median(gaps))
    return 0.0


def _two_peaks(values: Floats) -> float:
    """Distance between the two main peaks of a kernel density, or 0."""
    count = np.histogram(values, bins=int(2 * REACH_M / BIN_M), range=(-REACH_M, REACH_M))[0].astype(np.float64)
    low, high = np.percentile(values, [25, 75])
    width = float(np.clip(0.5 * (high - low) * len(values) ** -0.2, 0.002, 0.008))
    half = int(np.ceil(3 * width / BIN_M))
    kernel = np.exp(-0.5 * (np.arange(-half, half + 1) * BIN_M / width) ** 2)
    density = np.convolve(count, kernel / kernel.sum(), mode="same")
    peak = np.flatnonzero((density[1:-1] > density[:-2]) & (density[1:-1] >= density[2:])) + 1
    if len(peak) < 2:
        return 0.0
    first = peak[np.argmax(density[peak])]
    best = 0.0
    for other in peak[np.argsort(-density[peak])][1:4]:
        low_index, high_index = sorted((int(first), int(other)))
        valley = density[low_index : high_index + 1].min()
        if density[other] >= SECOND_PEAK * density[first] and valley <= VALLEY * density[other]:
            best = max(best, (high_index - low_index) * BIN_M)
    return best


def blurred_gap(offsets: Floats, residuals: Floats, sigma: float) -> float:
    """Distance between two walls that noise has run together, 0 where nothing speaks for two.

    A copy of the stem shifted by d thickens the wall where the shift is along the normal and not across it: the
    variance of the residuals goes as ``sigma^2 + d^2/4 cos^2``, a second harmonic over the angle. Noise that is worse
    on one side (the usual case in photogrammetry) is a first harmonic. ``offsets`` (N, 2) and ``residuals`` (N,) are of
    the axis fit.
    """
    near = np.abs(residuals) <= 3.0 * sigma
    angle = np.arctan2(offsets[near, 1], offsets[near, 0])
    sector = np.minimum(((angle + np.pi) / (2.0 * np.pi) * BLUR_SECTORS).astype(int), BLUR_SECTORS - 1)
    count = np.bincount(sector, minlength=BLUR_SECTORS)
    if (count < MIN_POINTS).sum() > 0.2 * BLUR_SECTORS:
        return 0.0
    seen = count >= MIN_POINTS
    square = np.bincount(sector, weights=residuals[near] ** 2, minlength=BLUR_SECTORS)[seen] / count[seen]
    middle = ((np.arange(BLUR_SECTORS) + 0.5) / BLUR_SECTORS * 2.0 - 1.0)[seen] * np.pi
    design = np.column_stack(
        [np.ones(len(middle)), np.cos(middle), np.sin(middle), np.cos(2.0 * middle), np.sin(2.0 * middle)]
    )
    a, c1, s1, c2, s2 = np.linalg.lstsq(design, square, rcond=None)[0]
    second = float(np.hypot(c2, s2))
    if second < BLUR_SHARE * a or second < 1.5 * np.hypot(c1, s1):
        return 0.0
    gap = 2.0 * float(np.sqrt(2.0 * second))
    return gap if gap >= BLUR_GAP_M else 0.0
