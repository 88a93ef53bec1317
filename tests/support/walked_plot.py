"""A plot of cylinders on flat ground, walked all round: depth maps, sparse points, and curtains before some stems."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fsinfer.io.images import write_image
from fsinfer.io.pfm import write_pfm
from fsinfer.poses.sparse import SparseModel
from fsinfer.scene import Camera, Scene, View

Floats = NDArray[np.float64]

# Plan position and radius, metres; the last stands outside the walk.
STEMS = [(1.5, 0.0, 0.12), (-2.0, 1.5, 0.2), (0.0, -2.5, 0.06), (-1.0, -1.0, 0.15), (2.0, 2.5, 0.1), (9.0, 0.0, 0.15)]
PHOTOS = 48
UNIT = 0.4  # metres per scene unit
_SIZE = (160, 120)
_FOCAL = 110.0
_TOP_M = 4.0


def walk_angles() -> Floats:
    """Direction of each photo from the middle of the plot, radians (PHOTOS,)."""
    return np.linspace(0, 2 * np.pi, PHOTOS, endpoint=False)


def hidden_from(center: Floats, number: int, direction_deg: float) -> bool:
    """Whether a curtain round the stem, in the half-plane of that direction, hides it from a camera."""
    bearing = np.degrees(np.arctan2(center[1] - STEMS[number][1], center[0] - STEMS[number][0]))
    return bool(abs((bearing - direction_deg + 180) % 360 - 180) < 90)


def make_plot(folder: Path, hidden: dict[int, float]) -> tuple[Scene, SparseModel]:
    """Write photos and depth maps into ``folder``; stems of ``hidden`` have curtains in these directions (degrees)."""
    rng = np.random.default_rng(0)
    centers = np.column_stack([5 * np.cos(walk_angles()), 5 * np.sin(walk_angles()), np.full(PHOTOS, 1.5)])
    views, entries = [], {}
    intrinsic = np.array([[_FOCAL, 0, _SIZE[0] / 2 - 0.5], [0, _FOCAL, _SIZE[1] / 2 - 0.5], [0, 0, 1]])
    for index, center in enumerate(centers):
        name = f"p{index:02d}"
        rotation = _looking_at_the_middle(center)
        depth, number = _render(center, rotation, intrinsic)
        for stem, direction in hidden.items():
            if hidden_from(center, stem, direction):
                depth[number == stem] = 0
        depth *= 1 + rng.normal(0, 0.002, depth.shape)
        write_pfm(folder / "depth" / f"{name}.pfm", (depth / UNIT).astype(np.float32))
        write_pfm(folder / "confidence" / f"{name}.pfm", np.ones(depth.shape, np.float32))
        write_image(folder / "images" / f"{name}.png", np.full((_SIZE[1], _SIZE[0], 3), 90, np.uint8))
        entries[name] = {"pixel_step": 1.0}
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation, -rotation @ center / UNIT
        around = [(index + step) % PHOTOS for step in (-1, 1, -2, 2)]
        views.append(
            View(
                name=name,
                image_path=folder / "images" / f"{name}.png",
                camera=Camera(intrinsic=intrinsic, cam_from_world=pose, depth_min=1.0, depth_max=40.0),
                sources=tuple(around),
            )
        )
    (folder / "depth" / "depth.json").write_text(json.dumps({"views": entries}), encoding="utf-8")
    return Scene(folder=folder, views=tuple(views)), _sparse(rng, centers, hidden)


def _looking_at_the_middle(center: Floats) -> Floats:
    """Rows right, down, forward of a camera that looks at 1.2 m above the middle."""
    forward = np.array([0.0, 0.0, 1.2]) - center
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])


def _render(center: Floats, rotation: Floats, intrinsic: Floats) -> tuple[Floats, NDArray[np.int64]]:
    """Z depth in metres, 0 in the sky, and the number of the stem in each pixel, -1 where there is none."""
    u, v = np.meshgrid(np.arange(_SIZE[0]), np.arange(_SIZE[1]))
    rays = (np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(intrinsic).T) @ rotation  # z depth 1
    falls = rays[..., 2] < -1e-3
    depth = np.where(falls, -center[2] / np.where(falls, rays[..., 2], -1.0), np.inf)
    number = np.full(depth.shape, -1)
    a = (rays[..., :2] ** 2).sum(axis=-1)
    for stem, (x, y, radius) in enumerate(STEMS):
        offset = center[:2] - [x, y]
        b = rays[..., :2] @ offset
        inner = b**2 - a * (offset @ offset - radius**2)
        far = (-b - np.sqrt(np.maximum(inner, 0))) / a
        height = center[2] + far * rays[..., 2]
        hit = (inner > 0) & (far > 0) & (far < depth) & (height > 0) & (height < _TOP_M)
        depth, number = np.where(hit, far, depth), np.where(hit, stem, number)
    return np.where(depth < 15, depth, 0.0), number


def _sparse(rng: np.random.Generator, centers: Floats, hidden: dict[int, float]) -> SparseModel:
    """Points on the ground, on the stems and in a bush, and the photos that share them."""
    points = [np.column_stack([rng.uniform(-9, 10, (4000, 2)), rng.normal(0, 0.02, 4000)])]
    normals, owner = [np.tile([0.0, 0, 1], (4000, 1))], [np.full(4000, -1)]
    for number, (x, y, radius) in enumerate(STEMS):
        turn, height = rng.uniform(0, 2 * np.pi, 500), rng.uniform(0.05, 4, 500)
        out = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(500)])
        points.append(np.array([x, y, 0]) + radius * out + height[:, None] * [0, 0, 1] + rng.normal(0, 0.01, (500, 3)))
        normals.append(out)
        owner.append(np.full(500, number))
    points.append(rng.uniform([-3.6, -3.2, 0.1], [-2.6, -2.2, 2.4], (250, 3)))
    normals.append(np.tile([0.0, 0, 1], (250, 1)))
    owner.append(np.full(250, -1))
    xyz, normal, own = np.concatenate(points), np.concatenate(normals), np.concatenate(owner)
    observations, tracks = {}, np.zeros(len(xyz), dtype=np.int64)
    for index, center in enumerate(centers):
        ray = center - xyz
        facing = (ray * normal).sum(axis=1) / np.linalg.norm(ray, axis=1) > 0.45
        seen = (facing | (own < 0)) & (rng.random(len(xyz)) < 0.4)
        for number, direction in hidden.items():
            if hidden_from(center, number, direction):
                seen &= own != number
        observations[f"p{index:02d}"] = np.flatnonzero(seen)
        tracks += seen
    return SparseModel(
        points=xyz / UNIT, errors_px=np.full(len(xyz), 0.5), track_lengths=tracks, observations=observations
    )
