"""Pixels of a depth map whose depth is most likely wrong take over what the surer pixels round them say.

The weighted median of the inverse depths in a window, weighted by a power of the confidence (Ma et al. 2013, constant
time weighted median filtering for stereo, use the same filter with colour weights, which brought nothing here). A
median chooses a surface and does not average between two, so that pixels which hang between a trunk and what is behind
it fall on one of them. Sure pixels stay as they are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class UnsureSettings:
    """Constants of :func:`settle_unsure`; what was compared stands in models/README.md."""

    below: float = 0.35  # confidence; at 0.5 leaves lose more than walls gain
    radius_px: int = 3
    power: float = 4.0  # of the confidence
    least_weight: float = 1e-3  # where nobody is sure a plain median is left
    chunk: int = 100_000  # pixels at a time: 40 MB


def settle_unsure(depth: Float32, confidence: Float32, *, settings: UnsureSettings | None = None) -> Float32:
    """Depth map (h, w) with the unsure pixels replaced; ``confidence`` (h, w) in [0, 1], a depth of 0 is none.

    Pixels without depth have no say, and get one where their surroundings have.
    """
    s = settings or UnsureSettings()
    known = depth > 0
    inverse = np.divide(1.0, depth, out=np.zeros_like(depth), where=known)
    weight = np.where(known, confidence**s.power + s.least_weight, 0).astype(np.float32)
    r = s.radius_px
    inverse, weight = np.pad(inverse, r), np.pad(weight, r)
    rows, columns = np.nonzero(confidence < s.below)
    settled = depth.copy()
    for start in range(0, len(rows), s.chunk):
        y, x = rows[start : start + s.chunk], columns[start : start + s.chunk]
        median = _weighted_median(inverse, weight, y, x, 2 * r + 1)
        settled[y, x] = np.divide(1.0, median, out=np.zeros_like(median), where=median > 0)
    return settled


def _weighted_median(inverse: Float32, weight: Float32, y: NDArray[np.intp], x: NDArray[np.intp], size: int) -> Float32:
    """Median (n,) over the windows whose first corners are (y, x); 0 where a window weighs nothing."""
    values = np.empty((len(y), size * size), np.float32)
    weights = np.empty_like(values)
    for k in range(size * size):
        down, right = divmod(k, size)
        values[:, k] = inverse[y + down, x + right]
        weights[:, k] = weight[y + down, x + right]
    order = np.argsort(values, axis=1)
    total = np.cumsum(np.take_along_axis(weights, order, axis=1), axis=1)
    middle = (total >= 0.5 * total[:, -1:]).argmax(axis=1)
    chosen = np.take_along_axis(order, middle[:, None], axis=1)
    median = np.take_along_axis(values, chosen, axis=1)[:, 0]
    return np.where(total[:, -1] > 0, median, np.float32(0))
