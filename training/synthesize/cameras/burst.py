"""Bursts: photographs of one place from beside each other, a few per cent of the depth apart."""

from __future__ import annotations

import cv2
import numpy as np

from fsinfer.scene import Camera
from training.synthesize.cameras.camera_path import make_camera

#: From one photograph to the next, shares of the median depth; drawn evenly in their logarithm.
STEP = (0.01, 0.04)
#: Scatter of the steps' logarithm, of their direction and of the gaze, radians.
STEP_STD, TURN_STD, GAZE_STD = 0.2, 0.3, 0.015


def burst_cameras(rng: np.random.Generator, camera: Camera, median_depth_m: float, views: int) -> list[Camera]:
    """``views`` cameras along a line through that of ``camera``, which is one of them, and about facing its way."""
    step = median_depth_m * float(np.exp(rng.uniform(*np.log(STEP))))
    heading = rng.uniform(0, 2 * np.pi)
    cameras = [camera]
    for number in range(1, views):
        away = (1 if number % 2 else -1) * ((number + 1) // 2) * step * np.exp(rng.normal(0, STEP_STD))
        along = heading + rng.normal(0, TURN_STD)
        # A hand moves to the side more than up, and to the front a little.
        offset = away * np.array([np.cos(along), 0.5 * np.sin(along), 0.3 * rng.normal()])
        turned = np.eye(4)
        turned[:3, :3] = cv2.Rodrigues(rng.normal(0, GAZE_STD, 3))[0]
        turned[:3, 3] = -turned[:3, :3] @ offset
        cameras.append(make_camera(camera.intrinsic, turned @ camera.cam_from_world))
    line = cameras[1].center - camera.center
    return sorted(cameras, key=lambda one: float((one.center - camera.center) @ line))
