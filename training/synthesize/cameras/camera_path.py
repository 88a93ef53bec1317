"""Where the phone is held and where it looks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fsinfer.scene import Camera


def intrinsics(width: int, height: int, hfov_deg: float) -> NDArray[np.float64]:
    """Pinhole K (3, 3) with square pixels and the principal point in the picture's middle."""
    focal = width / 2 / np.tan(np.radians(hfov_deg) / 2)
    return np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1.0]])


def look_at(center: NDArray[np.floating], target: NDArray[np.floating], roll_rad: float = 0.0) -> NDArray[np.float64]:
    """cam_from_world (4, 4) of a camera at ``center`` looking at ``target``, world z up, turned by ``roll_rad``."""
    forward = (target - center) / np.linalg.norm(target - center)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    c, s = np.cos(roll_rad), np.sin(roll_rad)
    rotation = np.stack([c * right + s * down, c * down - s * right, forward])
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = -rotation @ center
    return pose


def make_camera(intrinsic: NDArray[np.float64], pose: NDArray[np.float64]) -> Camera:
    """A camera whose depth range is set later, from the depth it sees."""
    return Camera(intrinsic=intrinsic, cam_from_world=pose, depth_min=0.1, depth_max=100.0)
