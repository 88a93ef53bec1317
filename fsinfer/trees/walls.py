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
