"""Unsure pixels take the confidence-weighted median of their surroundings."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from fsinfer.depth import median_filter
from fsinfer.depth.median_filter import settle_unsure
from fsinfer.depth.settings import UnsureSettings


def reference(depth: NDArray[np.float32], confidence: NDArray[np.float32], s: UnsureSettings) -> NDArray[np.float32]:
    """Pixel by pixel, from the definition of a weighted median; of a window every other pixel, as on a chessboard."""
    result = depth.copy()
    for y, x in zip(*np.nonzero(confidence < s.below), strict=True):
        down, right = np.mgrid[: depth.shape[0], : depth.shape[1]] - np.reshape([y, x], (2, 1, 1))
        near = np.maximum(abs(down), abs(right)) <= s.radius_px
        chosen = near & ((down + right) % 2 == 0) & (depth > 0)
        d, c = depth[chosen], confidence[chosen]
        if len(d) == 0:
            result[y, x] = 0
            continue
        order = np.argsort(1 / d)
        total = np.cumsum((c**s.power + s.least_weight)[order].astype(np.float32))
        result[y, x] = d[order][np.flatnonzero(total >= 0.5 * total[-1])[0]]
    return result


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), holes=st.floats(0, 0.6), threads=st.sampled_from([1, 3]), radius=st.integers(1, 3))
def test_is_the_weighted_median(seed: int, holes: float, threads: int, radius: int) -> None:
    small = UnsureSettings(radius_px=radius)
    rng = np.random.default_rng(seed)
    depth = rng.uniform(1, 20, (9, 11)).astype(np.float32)
    depth[rng.random(depth.shape) < holes] = 0
    confidence = rng.random(depth.shape).astype(np.float32)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(median_filter, "CHUNK_PIXELS", 7)
        settled = settle_unsure(depth, confidence, settings=small, threads=threads)
    np.testing.assert_allclose(settled, reference(depth, confidence, small), rtol=1e-6)


def test_flying_pixels_fall_on_a_surface_and_sure_ones_stay() -> None:
    depth = np.full((20, 20), 8.0, np.float32)
    depth[:, :10] = 3.0
    truth = depth.copy()
    depth[:, 9:11] = 5.0  # between the trunk and what is behind it
    confidence = np.full_like(depth, 0.9)
    confidence[:, 9:11] = 0.1
    settled = settle_unsure(depth, confidence)
    assert np.isin(settled, [3.0, 8.0]).all()
    np.testing.assert_array_equal(settled[:, [0, 8, 11, 19]], truth[:, [0, 8, 11, 19]])


def test_nothing_known_stays_unknown() -> None:
    nothing = np.zeros((8, 8), np.float32)
    np.testing.assert_array_equal(settle_unsure(nothing, nothing), nothing)
