"""Depth error figures."""

from __future__ import annotations

import numpy as np
import pytest

from training.metrics import PixelErrors, depth_errors, flying_pixels, mean_errors, pool, pooled_errors


def test_a_sure_estimate_counts_and_a_missing_one_is_wrong() -> None:
    truth = np.full((10, 10), 4.0, np.float32)
    truth[0] = 0
    depth = truth.copy()
    depth[1:4] = 0  # missing, and known to be unsure
    confidence = (depth > 0).astype(np.float32)
    errors = depth_errors(depth, confidence, truth)
    assert errors is not None
    assert errors.pixels == 90
    assert errors.within_1pct == pytest.approx(60 / 90)
    assert errors.median_rel == 0
    assert errors.within_1pct_sure == pytest.approx(60 / 90)
    confidence[1] = 2.0
    surest = depth_errors(depth, confidence, truth)
    assert surest is not None
    assert surest.within_1pct_sure < 1
    assert depth_errors(depth, confidence, np.zeros_like(truth)) is None


def test_only_depths_between_two_surfaces_fly() -> None:
    truth = np.full((20, 30), 2.0, np.float32)
    truth[:, 15:] = 6.0
    depth = truth.copy()
    depth[:, 14] = 3.5  # between both
    depth[:, 15] = 2.01  # the silhouette is a pixel too wide: on the wrong surface, but on one
    depth[:, 3] = 3.5  # wrong, but not at the silhouette
    silhouette, flies = flying_pixels(depth, truth, radius_px=3)
    np.testing.assert_array_equal(np.flatnonzero(silhouette.any(axis=0)), np.arange(12, 18))
    np.testing.assert_array_equal(np.flatnonzero(flies.any(axis=0)), [14])
    errors = depth_errors(depth, np.ones_like(depth), truth)
    assert errors is not None
    assert errors.flying == pytest.approx(1 / 6)
    flat = depth_errors(depth[:, :10], np.ones((20, 10), np.float32), truth[:, :10])
    assert flat is not None
    assert np.isnan(flat.flying)
    assert mean_errors([errors, flat])["flying"] == pytest.approx(1 / 6)


def test_pooled_errors_rank_the_pixels_of_all_views_together() -> None:
    good = PixelErrors(
        confidence=np.full(70, 0.9, np.float32),
        absolute=np.full(70, 0.01, np.float32),
        relative=np.full(70, 0.005, np.float32),
    )
    bad = PixelErrors(
        confidence=np.full(30, 0.2, np.float32),
        absolute=np.full(30, 0.5, np.float32),
        relative=np.full(30, 0.1, np.float32),
    )
    errors = pooled_errors(pool([bad, good]))
    assert errors["within_1pct"] == pytest.approx(0.7)
    assert errors["within_1pct_sure"] == errors["within_3cm_sure"] == 1.0  # of view ``bad`` alone it would be 0
    assert errors["median_abs"] == errors["median_abs_sure"] == pytest.approx(0.01)


def test_a_band_of_depth_counts_alone() -> None:
    truth = np.repeat(np.array([[2.0, 5.9, 6.0, 9.0, 12.0]], np.float32), 3, axis=0)
    depth = truth * np.array([1.5, 1.5, 1.001, 1.003, 1.5], np.float32)
    errors = depth_errors(depth, np.ones_like(depth), truth, min_depth=6.0, max_depth=12.0)
    assert errors is not None
    assert errors.pixels == 6
    assert errors.median_rel == pytest.approx(0.002, rel=1e-3)
    assert depth_errors(depth, np.ones_like(depth), truth, min_depth=13.0) is None
