"""The semi-global matcher that stands in for a classic MVS: its depth on a textured wall."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.scene import Camera
from tests.bench.sgm import depth_of_pair, rectify

INTRINSIC = np.array([[300.0, 0, 159.5], [0, 300.0, 119.5], [0, 0, 1]])
SIZE = (320, 240)
#: A whole number of pixels of disparity with 0.3 m: SGBM likes those.
DISTANCE = 4.5


def camera(place: tuple[float, float, float], turn_deg: float = 0.0) -> Camera:
    """A camera looking at the wall, rolled by so many degrees."""
    rotation, _ = cv2.Rodrigues(np.array([0.0, 0.0, np.radians(turn_deg)]))
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ np.array(place)
    return Camera(intrinsic=INTRINSIC, cam_from_world=pose, depth_min=1.0, depth_max=20.0)


def picture(of: Camera) -> NDArray[np.uint8]:
    """What it sees of a wall of noise at :data:`DISTANCE`, 100 pixels a metre."""
    noise = np.random.default_rng(4).integers(0, 256, (1000, 1000, 3), dtype=np.uint8)
    wall = cv2.GaussianBlur(noise, (0, 0), 1.5)
    pixels_from_wall = np.array([[0.01, 0, -5], [0, 0.01, -5], [0, 0, DISTANCE]])
    pose = of.cam_from_world
    to_camera = pose[:3, :3] @ pixels_from_wall + pose[:3, 3:] @ np.array([[0.0, 0, 1]])
    return np.asarray(cv2.warpPerspective(wall, INTRINSIC @ to_camera, SIZE, flags=cv2.INTER_LINEAR), dtype=np.uint8)


@pytest.mark.parametrize(
    "beside", [(0.3, 0.0, 0.0), (-0.3, 0.02, 0.05), (0.01, 0.3, 0.0)], ids=["right", "left", "below"]
)
@pytest.mark.parametrize("turn_deg", [0.0, 8.0])
def test_the_depth_of_a_wall_is_found_from_any_side(beside: tuple[float, float, float], turn_deg: float) -> None:
    cameras = (camera((0, 0, 0)), camera(beside, turn_deg))
    depth = depth_of_pair((picture(cameras[0]), picture(cameras[1])), cameras)
    seen_by_both = depth[50:-50, 50:-50]
    error = np.abs(seen_by_both / DISTANCE - 1)
    # Half a pixel of disparity is 2.5 % of this depth.
    assert (error < 0.025).mean() > 0.95
    assert np.nanmedian(error) < 0.01


def test_one_behind_the_other_is_no_pair() -> None:
    assert rectify(camera((0, 0, 0)), camera((0, 0, 0.5)), SIZE) is None
