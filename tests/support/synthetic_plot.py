"""Three round stems on flat ground, seen from a ring of cameras with the depth of patches: a plot in milliseconds.

The scene is written in model units (0.5 m each) and turned, as structure from motion would leave it.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fsinfer.io.files import write_text
from fsinfer.io.images import write_image
from fsinfer.io.pfm import write_pfm
from fsinfer.scene import Camera, Scene, write_camera, write_pairs
from fsinfer.trees.points.smoothing import MOST_OF_RADIUS, PATCH_PX

M_PER_UNIT = 0.5
# x_m, y_m, radius_m
STEMS = np.array([[-1.2, 0.0, 0.15], [1.0, 0.9, 0.11], [0.9, -1.1, 0.20]])
HEIGHT_M = 4.0
VIEWS = 12
SIZE = (160, 120)
FOCAL_PX = 120.0
_TURN = Rotation.from_euler("xyz", [100.0, 20.0, 30.0], degrees=True).as_matrix()


def cameras() -> list[Camera]:
    """Cameras on a ring of 4 m, 1.5 m above the ground, in turned model units."""
    result = []
    intrinsic = np.array([[FOCAL_PX, 0, (SIZE[0] - 1) / 2], [0, FOCAL_PX, (SIZE[1] - 1) / 2], [0, 0, 1]])
    for angle in np.arange(VIEWS) * 2 * np.pi / VIEWS:
        pose = np.eye(4)
        pose[:3, :3] = _rotation(angle) @ _TURN.T
        pose[:3, 3] = -_rotation(angle) @ _center_m(angle) / M_PER_UNIT
        result.append(Camera(intrinsic=intrinsic, cam_from_world=pose, depth_min=2.0, depth_max=24.0))
    return result


def _center_m(angle: float) -> NDArray[np.float64]:
    return np.array([4.0 * np.cos(angle), 4.0 * np.sin(angle), 1.5])


def _rotation(angle: float) -> NDArray[np.float64]:
    forward = -np.array([np.cos(angle), np.sin(angle), 0.0])
    down = np.array([0.0, 0.0, -1.0])
    return np.stack([np.cross(down, forward), down, forward])


def depth_map(index: int) -> NDArray[np.float32]:
    """z depth of view ``index``, (h, w), model units; 0 where nothing is within 12 m.

    That of the ground is exact; of stems it is the mean over a patch of pixels, as depth maps have it: thinner ones.
    """
    angle = index * 2 * np.pi / VIEWS
    u, v = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    rays = np.stack([(u - (SIZE[0] - 1) / 2) / FOCAL_PX, (v - (SIZE[1] - 1) / 2) / FOCAL_PX, np.ones(u.shape)], axis=-1)
    rays = rays @ _rotation(angle)  # world directions with unit z depth
    center = _center_m(angle)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.where(rays[..., 2] < 0, -center[2] / rays[..., 2], np.inf)
        for x_m, y_m, radius_m in STEMS:
            offset = center[:2] - (x_m, y_m)
            patch_m = min(PATCH_PX * float(np.linalg.norm(offset)) / FOCAL_PX, MOST_OF_RADIUS * radius_m)
            seen_m = radius_m - patch_m**2 / (2 * radius_m)
            a = (rays[..., :2] ** 2).sum(-1)
            b = rays[..., :2] @ offset
            root = b**2 - a * (offset @ offset - seen_m**2)
            hit = (-b - np.sqrt(root)) / a
            height = center[2] + hit * rays[..., 2]
            depth = np.where((root > 0) & (hit > 0) & (height > 0) & (height < HEIGHT_M), np.minimum(depth, hit), depth)
    return np.where(depth < 12.0, depth / M_PER_UNIT, 0).astype(np.float32)


def write_scene_folder(folder: Path) -> None:
    """Write images, cams and pair.txt; the images are grey noise, since depth is made without them."""
    rng = np.random.default_rng(0)
    for index, camera in enumerate(cameras()):
        name = f"view_{index:02d}"
        write_image(folder / "images" / f"{name}.jpg", rng.integers(80, 160, (SIZE[1], SIZE[0], 3), dtype=np.uint8))
        write_camera(folder / "cams" / f"{name}_cam.txt", camera)
    near = {i: [((i + step) % VIEWS, 1.0) for step in (1, -1, 2, -2)] for i in range(VIEWS)}
    write_pairs(folder / "pair.txt", near)


def write_depth_folder(scene: Scene, out: Path) -> None:
    """Write depth and full confidence as the depth stage does."""
    for index, view in enumerate(scene.views):
        depth = depth_map(index)
        write_pfm(out / "depth" / f"{view.name}.pfm", depth)
        write_pfm(out / "confidence" / f"{view.name}.pfm", np.ones_like(depth))
    grid = {"pixel_step_x": 1.0, "pixel_step_y": 1.0, "width": SIZE[0], "height": SIZE[1]}
    entry = {**grid, "offset_x_px": 0.0, "offset_y_px": 0.0}
    views = {view.name: entry for view in scene.views}
    write_text(out / "depth" / "depth.json", json.dumps({**grid, "model": "exact", "views": views}))
