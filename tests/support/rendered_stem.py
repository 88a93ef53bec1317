"""Photographs and exact depth maps of one leaning, tapering stem, half of it seen."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fsinfer.io.images import write_image
from fsinfer.io.pfm import write_pfm
from fsinfer.scene import Camera, write_camera, write_pairs

WIDTH, HEIGHT, FOCAL = 360, 240, 520.0
#: Of the stem, at breast height.
RADIUS, LEAN, TAPER = 0.14, np.array([0.03, -0.02]), -0.008
BREAST = np.array([0.3, -0.2, 1.3])
PHOTOS = 9
M_PER_UNIT = 0.5


def camera(angle: float, distance: float) -> Camera:
    """A level camera that looks at the stem from ``angle``, a little above breast height."""
    center = np.array([BREAST[0] + distance * np.cos(angle), BREAST[1] + distance * np.sin(angle), 1.6])
    forward = np.array([BREAST[0], BREAST[1], 1.35]) - center
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ center
    intrinsic = np.array([[FOCAL, 0, (WIDTH - 1) / 2], [0, FOCAL, (HEIGHT - 1) / 2], [0, 0, 1]])
    return Camera(intrinsic=intrinsic, cam_from_world=pose, depth_min=1.0, depth_max=60.0)


def render(cam: Camera, rng: np.random.Generator) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Photograph (H, W, 3) and depth map (H, W) of a leaning, tapering stem before a mottled background."""
    fine = 3
    u, v = np.meshgrid(np.arange(WIDTH * fine), np.arange(HEIGHT * fine))
    pixels = np.stack([(u - 1) / fine, (v - 1) / fine, np.ones_like(u)], axis=-1).reshape(-1, 3)
    rays = (pixels @ np.linalg.inv(cam.intrinsic).T) @ cam.cam_from_world[:3, :3]  # z depth 1, world axes
    offset = cam.center - BREAST
    # Distance from the axis at height h equals the radius there: a quadratic in the depth t.
    level, slope = rays[:, :2] - rays[:, 2:] * LEAN, offset[:2] - offset[2] * LEAN
    r0, r1 = RADIUS + TAPER * offset[2], TAPER * rays[:, 2]
    a = (level**2).sum(1) - r1**2
    b = level @ slope - r0 * r1
    inside = b**2 - a * (slope @ slope - r0**2)
    hit = inside > 0
    depth = np.full(len(rays), 40.0)
    depth[hit] = (-b[hit] - np.sqrt(inside[hit])) / a[hit]
    cell = rng.integers(0, 255, (40, 60, 3))
    background = 0.4 * cell[(v.reshape(-1) // 18) % 40, (u.reshape(-1) // 18) % 60] + np.array([70.0, 110.0, 90.0])
    surface = offset + depth[:, None] * rays
    along = np.arctan2(surface[:, 1], surface[:, 0])
    bark = np.array([95.0, 70.0, 55.0]) * (1 + 0.25 * np.sin(23 * along + 40 * surface[:, 2]))[:, None]
    image = np.where(hit[:, None], bark, background).reshape(HEIGHT, fine, WIDTH, fine, 3).mean(axis=(1, 3))
    return image.clip(0, 255).astype(np.uint8), depth.reshape(HEIGHT, fine, WIDTH, fine)[:, 1, :, 1].astype(np.float32)


def write_photographs(scene: Path, out: Path) -> None:
    """Photographs from half of all sides at 6 to 8 m, where a pixel is 1.2 to 1.5 cm; scene units are half metres.

    The depth maps go into ``out``.
    """
    rng = np.random.default_rng(1)
    to_units = np.diag([1 / M_PER_UNIT] * 3 + [1.0])
    for index in range(PHOTOS):
        cam = camera(np.pi * index / PHOTOS, 6.0 + 2.0 * (index % 3) / 2)
        image, depth = render(cam, rng)
        write_image(scene / "images" / f"p{index}.png", image)
        pose = to_units @ cam.cam_from_world @ np.linalg.inv(to_units)
        write_camera(
            scene / "cams" / f"p{index}_cam.txt", replace(cam, cam_from_world=pose, depth_min=2.0, depth_max=120.0)
        )
        write_pfm(out / "depth" / f"p{index}.pfm", np.float32(1 / M_PER_UNIT) * depth)
        write_pfm(out / "confidence" / f"p{index}.pfm", np.ones_like(depth))
    write_pairs(scene / "pair.txt", {i: [((i + 1) % PHOTOS, 1.0)] for i in range(PHOTOS)})
    (out / "depth" / "depth.json").write_text(json.dumps({"pixel_step": 1.0}), encoding="utf-8")
