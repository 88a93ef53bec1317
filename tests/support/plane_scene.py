"""A scene whose truth is known without a renderer: a textured plane, fronto-parallel to all views."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fsinfer.io.images import write_image
from fsinfer.io.pfm import write_pfm
from fsinfer.scene import Camera, write_camera, write_pairs

FOCAL_PX = 100.0
PLANE_DEPTH = 3.0


def write_plane_scene(folder: Path, *, views: int = 3, height: int = 108, width: int = 140, seed: int = 0) -> Path:
    """Views side by side, 10 pixels of parallax each (a baseline of 0.3 at depth 3), with exact ``depths``."""
    rng = np.random.default_rng(seed)
    coarse = rng.integers(0, 255, (height // 3 + 1, (width + 10 * views) // 3 + 1, 3), dtype=np.uint8)
    texture = coarse.repeat(3, axis=0).repeat(3, axis=1)
    intrinsic = np.array([[FOCAL_PX, 0, width / 2], [0, FOCAL_PX, height / 2], [0, 0, 1]])
    for i in range(views):
        write_image(folder / "images" / f"{i}.png", np.ascontiguousarray(texture[:height, 10 * i : 10 * i + width]))
        pose = np.eye(4)
        pose[0, 3] = -PLANE_DEPTH / FOCAL_PX * 10 * i
        camera = Camera(intrinsic=intrinsic, cam_from_world=pose, depth_min=1.5, depth_max=12.0)
        write_camera(folder / "cams" / f"{i}_cam.txt", camera)
        write_pfm(folder / "depths" / f"{i}.pfm", np.full((height, width), PLANE_DEPTH, np.float32))
    write_pairs(folder / "pair.txt", {i: [(j, 1.0) for j in range(views) if j != i] for i in range(views)})
    return folder
