"""The similarity of a plot: its scale, its rotation, and what it does to points."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fsinfer.geometry.similarity import apply, compose, fit_similarity, rotation_of, scale_of, scaling

ROTATION = Rotation.from_euler("xyz", [20.0, -35.0, 110.0], degrees=True).as_matrix()
SHIFT = np.array([4.0, -2.0, 0.5])


def similarity(scale: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = scale * ROTATION
    matrix[:3, 3] = SHIFT
    return matrix


@pytest.mark.parametrize("scale", [0.037, 1.0, 42.0])
def test_a_similarity_falls_apart_into_scale_and_rotation(scale: float) -> None:
    assert scale_of(similarity(scale)) == pytest.approx(scale, rel=1e-14)
    np.testing.assert_allclose(rotation_of(similarity(scale)), ROTATION, atol=1e-14)


@pytest.mark.parametrize("shape", [(3,), (5, 3), (4, 2, 3)])
def test_points_are_turned_scaled_and_shifted(shape: tuple[int, ...]) -> None:
    points = np.random.default_rng(1).normal(size=shape)
    moved = apply(similarity(2.5), points)
    assert moved.shape == shape
    expected = [2.5 * ROTATION @ point + SHIFT for point in points.reshape(-1, 3)]
    np.testing.assert_allclose(moved.reshape(-1, 3), expected, atol=1e-13)


def test_of_composed_ones_the_last_acts_first() -> None:
    points = np.random.default_rng(2).normal(size=(6, 3))
    together = compose(scaling(3.0), similarity(2.0), scaling(0.5))
    np.testing.assert_allclose(apply(together, points), 3.0 * apply(similarity(2.0), 0.5 * points), atol=1e-13)
    assert scale_of(together) == pytest.approx(3.0)


@pytest.mark.parametrize("scale", [0.037, 42.0])
def test_the_fit_of_moved_points_is_what_moved_them(scale: float) -> None:
    points = np.random.default_rng(3).normal(size=(5, 3))
    found = fit_similarity(points, apply(similarity(scale), points))
    assert found is not None
    np.testing.assert_allclose(found, similarity(scale), rtol=1e-9, atol=1e-12)


def test_points_in_one_line_or_too_few_fix_no_turn() -> None:
    line = np.arange(4.0)[:, None] * [1.0, 2.0, -0.5]
    assert fit_similarity(line, line) is None
    assert fit_similarity(np.eye(3)[:2], np.eye(3)[:2]) is None
