"""The cameras' errors reach the radius of a stem as far as its edges do not balance them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.poses.adjustment.precision import CameraPrecision
from fsinfer.scene import Camera, Scene, View
from fsinfer.silhouettes.pose_errors import radius_std, ray_errors
from fsinfer.trees.diameter.edge_set import Edges
from fsinfer.trees.diameter.silhouette import fit_silhouette
from training.simulate.stem_edges import edges_from_rows

INTRINSIC = np.array([[1000.0, 0, 640], [0, 1000.0, 360], [0, 0, 1]])
STEM = np.array([0.0, 0.0, 5.0])
#: The scene is in units of half a metre.
METRES = np.diag([0.5, 0.5, 0.5, 1.0])
KNOWN = CameraPrecision(center_std=0.004, direction_std_rad=0.001)


def scene_of(*distances_m: float) -> Scene:
    views = []
    for number, distance in enumerate(distances_m):
        pose = np.eye(4)
        pose[2, 3] = 2 * (distance - STEM[2])
        camera = Camera(intrinsic=INTRINSIC, cam_from_world=pose, depth_min=1.0, depth_max=60.0)
        views.append(View(name=f"{number}", image_path=Path(f"{number}.jpg"), camera=camera, sources=()))
    return Scene(folder=Path(), views=tuple(views))


def test_rays_err_by_the_place_and_by_the_direction_times_the_distance() -> None:
    found = ray_errors(scene_of(4.0, 8.0, -3.0, 4.0), METRES, {"0": KNOWN, "1": KNOWN, "2": KNOWN})
    assert found is not None
    by_hand = [np.hypot(0.5 * 0.004, distance * 0.001) for distance in (4.0, 8.0)]
    np.testing.assert_allclose(found(STEM), [*by_hand, 0.0, 0.0])  # behind the camera; a camera of which none knows


def test_of_cameras_from_elsewhere_nothing_is_known() -> None:
    assert ray_errors(scene_of(3.0), METRES, {}) is None


def edges_of(sides: tuple[int, ...], moved_m: NDArray[np.float64]) -> Edges:
    """Edges of a stem of 0.3 m, of ``sides`` of each of V photographs; these are moved by ``moved_m`` (V, 2)."""
    rows = []
    for number, move in enumerate(moved_m):
        direction = np.radians(20.0 * number)
        for side in sides:
            angle = direction + (np.pi / 2 if side else -np.pi / 2)
            for band in range(4):
                support = 0.15 + move @ [np.cos(angle), np.sin(angle)]
                rows.append((support, angle, 0.05 * band, 8.0, 0.004, (number * 2 + side) * 4 + band, number))
    return edges_from_rows(rows)


@pytest.mark.parametrize("sides", [(0, 1), (0,)])
@pytest.mark.parametrize("photo", [0, 5])
def test_what_is_told_is_what_moved_cameras_do(sides: tuple[int, ...], photo: int) -> None:
    edges = edges_of(sides, np.zeros((12, 2)))
    fit = fit_silhouette(edges, 0.15, taper=0.0)
    assert fit is not None
    step = 0.0005
    off = []
    for axis in (0, 1):
        moved = np.zeros((12, 2))
        moved[photo, axis] = step
        after = fit_silhouette(edges_of(sides, moved), 0.15, taper=0.0)
        assert after is not None
        off.append(after.radius_m - fit.radius_m)
    std = step * (np.arange(12) == photo)
    assert np.hypot(off[0], off[1]) == pytest.approx(radius_std(edges, fit, std), rel=0.2, abs=1e-6)
    # Each camera errs for itself.
    all_std = [radius_std(edges, fit, step * (np.arange(12) == number)) for number in range(12)]
    assert radius_std(edges, fit, np.full(12, step)) == pytest.approx(np.linalg.norm(all_std))


def test_both_sides_of_a_photo_balance_its_error_and_one_does_not() -> None:
    std = np.full(12, 0.003)
    both, one = (edges_of(sides, np.zeros((12, 2))) for sides in ((0, 1), (0,)))
    balanced, half = (fit_silhouette(edges, 0.15, taper=0.0) for edges in (both, one))
    assert balanced is not None
    assert half is not None
    assert radius_std(both, balanced, std) < 1e-5
    assert radius_std(one, half, std) > 2e-4
