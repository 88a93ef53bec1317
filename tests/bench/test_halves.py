"""Two clouds of one surface: what their noise is comes out, however one of them was turned, moved and scaled."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tests.bench.halves import differences, registered

Floats = NDArray[np.float64]
NOISE_M = 0.002


def bark(rng: np.random.Generator, count: int = 20_000) -> Floats:
    """A half of a ribbed stem of half a metre's radius, whose surface fixes all seven parameters."""
    angle, z = rng.uniform(0, np.pi, count), rng.uniform(0, 1.5, count)
    radius = 0.5 + 0.03 * np.cos(9 * angle) + 0.03 * np.sin(8 * z) + NOISE_M * rng.standard_normal(count)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)


def test_clouds_are_put_on_each_other_and_their_noise_is_told() -> None:
    rng = np.random.default_rng(1)
    one, other = bark(rng), bark(rng)
    turned = 1.01 * Rotation.from_rotvec([0.01, -0.008, 0.012]).apply(one) + [0.004, -0.005, 0.003]
    cameras = np.array([[0.0, 4.0, z] for z in (0.5, 1.0)])
    before, _ = differences(turned, other, cameras)
    off, apart = differences(registered(turned, other), other, cameras)
    away = np.linalg.norm(one[:, None] - cameras, axis=2).min(axis=1)
    # The plane of twenty points has a fifth of their noise, beside the point's own.
    expected = 0.6745 * NOISE_M * np.sqrt(1 + 1 / 20) / np.median(away)
    assert np.median(off) == pytest.approx(expected, rel=0.15)
    assert np.median(before) > 2 * np.median(off)
    assert (apart < 0.01).all()


def test_what_one_cloud_lacks_has_no_partner() -> None:
    rng = np.random.default_rng(2)
    one, other = bark(rng), bark(rng)
    _, apart = differences(one, other[other[:, 2] < 0.75], np.array([[0.0, 4.0, 0.7]]))
    assert (apart > 0.01).mean() == pytest.approx(0.5, abs=0.06)
