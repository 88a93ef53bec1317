"""Pictures that lie on their side and do not say so: the ground tells what is up; all others are left alone."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fsinfer.placement.on_side import upright_axes
from fsinfer.placement.up import estimate_up

Floats = NDArray[np.float64]


def walk(*, pitch_deg: float, around_deg: float, seed: int) -> tuple[Floats, Floats, Floats, Floats]:
    """Points with z up, cameras that look inward, and the axes down and right of their upright photographs."""
    rng = np.random.default_rng(seed)
    parts = [np.column_stack([rng.uniform(-8, 8, (8000, 2)), rng.normal(0, 0.03, 8000)])]
    for _ in range(10):
        place, around = rng.uniform(-6, 6, 2), rng.uniform(0, 2 * np.pi, 600)
        ring = place + 0.15 * np.column_stack([np.cos(around), np.sin(around)])
        parts.append(np.column_stack([ring, rng.uniform(0, rng.uniform(3, 6), 600)]))
    angle = np.radians(np.linspace(0, around_deg, 30, endpoint=False))
    centers = np.column_stack([7 * np.cos(angle), 7 * np.sin(angle), rng.normal(1.5, 0.1, 30)])
    pitch = np.radians(rng.normal(pitch_deg, 5, 30))
    forward = np.column_stack([-np.cos(angle) * np.cos(pitch), -np.sin(angle) * np.cos(pitch), -np.sin(pitch)])
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    down = np.cross(forward, right)
    roll = np.radians(rng.normal(0, 3, 30))[:, None]
    return (
        np.concatenate(parts),
        centers,
        np.cos(roll) * down - np.sin(roll) * right,
        np.cos(roll) * right + np.sin(roll) * down,
    )


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("pitch_deg", "around_deg"), [(5.0, 360.0), (20.0, 360.0), (10.0, 180.0)])
@pytest.mark.parametrize("side", [1, -1])
def test_the_ground_rights_pictures_on_their_side(pitch_deg: float, around_deg: float, side: int, seed: int) -> None:
    turn = Rotation.random(random_state=seed).as_matrix()
    points, centers, down, right = (
        part @ turn.T for part in walk(pitch_deg=pitch_deg, around_deg=around_deg, seed=seed)
    )
    # A sensor on its side has the upright picture's down along its x axis, or against it.
    found_down, found_right = upright_axes(points, centers, -side * right, side * down)
    np.testing.assert_allclose(found_down, down, atol=1e-9)
    up, _ = estimate_up(points, None, found_right, found_down, camera_centers=centers)
    assert up @ turn[:, 2] > np.cos(np.radians(2))


@pytest.mark.parametrize(("pitch_deg", "around_deg"), [(5.0, 360.0), (20.0, 60.0), (30.0, 360.0), (85.0, 360.0)])
def test_upright_pictures_are_left_alone(pitch_deg: float, around_deg: float) -> None:
    points, centers, down, right = walk(pitch_deg=pitch_deg, around_deg=around_deg, seed=1)
    found = upright_axes(points, centers, down, right)
    assert found[0] is down
    assert found[1] is right


def test_where_no_side_has_more_ground_nothing_is_turned() -> None:
    points, centers, down, right = walk(pitch_deg=5.0, around_deg=360.0, seed=1)
    mirrored = np.concatenate([points, points * [1, 1, -1] + [0, 0, 3]])
    assert upright_axes(mirrored, centers, -right, down)[0] is not down
    np.testing.assert_array_equal(upright_axes(mirrored, centers, -right, down)[0], -right)
