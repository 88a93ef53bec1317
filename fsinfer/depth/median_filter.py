"""Pixels of a depth map whose depth is most likely wrong take over what the surer pixels round them say.

The weighted median of the inverse depths in a window, weighted by a power of the confidence (Ma et al. 2013, constant
time weighted median filtering for stereo, use the same filter with colour weights, which brought nothing here). A
median chooses a surface and does not average between two, so that pixels which hang between a trunk and what is behind
it fall on one of them. Sure pixels stay as they are.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fsinfer.depth.settings import UnsureSettings

Float32 = NDArray[np.float32]


#: Pixels at a time: 40 MB. Source: numerics.
CHUNK_PIXELS = 100_000


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
    for start in range(0, len(rows), CHUNK_PIXELS):
        y, x = rows[start : start + CHUNK_PIXELS], columns[start : start + CHUNK_PIXELS]
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
