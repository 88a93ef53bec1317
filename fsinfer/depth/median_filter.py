"""Pixels of a depth map whose depth is most likely wrong take over what the surer pixels round them say.

The weighted median of the inverse depths in a window, weighted by a power of the confidence (Ma et al. 2013, constant
time weighted median filtering for stereo, use the same filter with colour weights, which brought nothing here). A
median chooses a surface and does not average between two, so that pixels which hang between a trunk and what is behind
it fall on one of them. Sure pixels stay as they are.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from fsinfer.depth.blocks import over_blocks
from fsinfer.depth.settings import UnsureSettings
from fsinfer.threads import one_blas_thread

Float32 = NDArray[np.float32]


#: Pixels at a time: their windows stay in a processor's cache. Source: numerics.
CHUNK_PIXELS = 8_000
#: Bits of a float32. Source: format.
_HALF = np.uint64(32)


@one_blas_thread()
def settle_unsure(
    depth: Float32, confidence: Float32, *, settings: UnsureSettings | None = None, threads: int = 1
) -> Float32:
    """Depth map (h, w) with the unsure pixels replaced; ``confidence`` (h, w) in [0, 1], a depth of 0 is none.

    Pixels without depth have no say, and get one where their surroundings have.
    """
    s = settings or UnsureSettings()
    known = depth > 0
    inverse = np.divide(1.0, depth, out=np.zeros_like(depth), where=known)
    weight = np.where(known, confidence**s.power + s.least_weight, 0).astype(np.float32)
    r = s.radius_px
    # The bits of floats that are not negative are in their order: with the weight below its value, a pair is sorted as
    # one integer, four times faster than by an order that both are then taken in.
    pairs = (np.pad(inverse, r).view(np.uint32).astype(np.uint64) << _HALF) | np.pad(weight, r).view(np.uint32)
    # Every other pixel of a window, as the squares of one colour of a chessboard: as good, and half to be sorted.
    down, right = np.divmod(np.arange(0, (2 * r + 1) ** 2, 2), 2 * r + 1)
    in_window, flat = down * pairs.shape[1] + right, pairs.ravel()
    unsure = np.flatnonzero(confidence < s.below)
    settled = depth.copy()

    def settle(start: int) -> None:
        y, x = np.divmod(unsure[start : start + CHUNK_PIXELS], depth.shape[1])
        median = _weighted_median(flat.take((y * pairs.shape[1] + x)[:, None] + in_window))
        settled[y, x] = np.divide(1.0, median, out=np.zeros_like(median), where=median > 0)

    over_blocks(settle, len(unsure), CHUNK_PIXELS, threads)
    return settled


def _weighted_median(pairs: NDArray[np.uint64]) -> Float32:
    """Median (n,) of values whose bits stand above those of their weights, (n, k); 0 where a row weighs nothing."""
    pairs.sort(axis=1)
    count, width = pairs.shape
    # Sums so far as one product: a third of the time of adding them up along each row. Those before the middle are
    # counted by another.
    total = pairs.astype(np.uint32).view(np.float32) @ _sums_so_far(width)
    before = total < np.float32(0.5) * total[:, -1:]
    middle = (before.astype(np.float32) @ np.ones(width, np.float32)).astype(np.intp)
    median = (pairs[np.arange(count), middle] >> _HALF).astype(np.uint32).view(np.float32)
    return np.where(total[:, -1] > 0, median, np.float32(0))


@cache
def _sums_so_far(width: int) -> Float32:
    """(width, width): a row of values times this is what each and all before it add up to."""
    return np.triu(np.ones((width, width), np.float32))
