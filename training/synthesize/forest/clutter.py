"""Objects that are no trees: boulders, posts, boxes, walls, statue-like lumps (so that training sees them too)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from training.synthesize.forest.mesh import Mesh, box_uv, make_mesh, sphere_grid, tubes


def blob(
    rng: np.random.Generator,
    center: NDArray[np.floating],
    scale: NDArray[np.floating],
    material: int,
    tile_m: float,
    *,
    roughness: float,
    rows: int = 48,
    power: float = 1.0,
) -> Mesh:
    """An ellipsoid (``power`` < 1: towards a box) displaced by waves of several lengths."""
    directions, faces = sphere_grid(rows, 2 * rows)
    shape = np.sign(directions) * np.abs(directions) ** power
    shape = shape / np.maximum(np.abs(shape) ** 4, 1e-12).sum(1, keepdims=True) ** 0.25 if power < 1 else directions
    offset = np.zeros(len(directions))
    for _ in range(14):
        wave = rng.normal(0, 1, 3)
        wave *= np.exp(rng.uniform(np.log(1.5), np.log(rows / 3))) / np.linalg.norm(wave)
        offset += np.sin(directions @ wave + rng.uniform(0, 2 * np.pi)) / np.linalg.norm(wave)
    vertices = center + shape * (1 + roughness * offset)[:, None] * scale
    return make_mesh(vertices, faces, box_uv(vertices, faces, tile_m), material)


def box(center: NDArray[np.floating], axes: NDArray[np.floating], material: int, tile_m: float) -> Mesh:
    """A box with half axes ``axes`` (3, 3), rows right-handed; sharp edges."""
    vertices: list[NDArray[np.floating]] = []
    faces: list[list[int]] = []
    uv: list[list[float]] = []
    for axis in range(3):
        for side in (1.0, -1.0):
            normal, a, b = side * axes[axis], axes[(axis + 1) % 3], axes[(axis + 2) % 3]
            a, b = (a, b) if side > 0 else (b, a)
            base = len(vertices)
            vertices += [center + normal + i * a + j * b for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
            faces += [[base, base + 1, base + 2], [base, base + 2, base + 3]]
            la, lb = float(2 * np.linalg.norm(a) / tile_m), float(2 * np.linalg.norm(b) / tile_m)
            shift = 0.23 * len(uv)
            uv += [[shift, lb], [shift + la, lb], [shift + la, 0], [shift, 0]]
    return make_mesh(np.array(vertices), np.array(faces), np.array(uv), material)


def turned_axes(rng: np.random.Generator, half: NDArray[np.floating], *, tilt: float) -> NDArray[np.float64]:
    """Half axes (3, 3) of a box turned about z, tilted a little."""
    angle = rng.uniform(0, 2 * np.pi)
    x = np.array([np.cos(angle), np.sin(angle), rng.normal(0, tilt)])
    z = np.array([rng.normal(0, tilt), rng.normal(0, tilt), 1.0])
    x, z = x / np.linalg.norm(x), z / np.linalg.norm(z)
    y = np.cross(z, x)
    y /= np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)]) * np.asarray(half)[:, None]


def clutter_object(
    rng: np.random.Generator, x: float, y: float, z: float, materials: list[int], tiles_m: list[float]
) -> list[Mesh]:
    """One random object standing (or floating a little sunk) at the ground point (x, y, z)."""
    which = int(rng.integers(len(materials)))
    material, tile_m = materials[which], tiles_m[which]
    kind = rng.choice(["boulder", "box", "post", "statue", "wall", "sphere"], p=[0.25, 0.2, 0.12, 0.23, 0.1, 0.1])
    size = float(np.exp(rng.uniform(np.log(0.2), np.log(1.1))))
    place = np.array([x, y, z])
    if kind == "boulder":
        scale = size * rng.uniform(0.6, 1.3, 3)
        power = 1.0 if rng.random() < 0.6 else rng.uniform(0.3, 0.7)
        center = place + np.array([0, 0, scale[2] * 0.6])
        return [blob(rng, center, scale, material, tile_m, roughness=0.2, power=power)]
    if kind == "box":
        half = size * rng.uniform(0.3, 1.0, 3)
        return [box(place + np.array([0, 0, half[2] * 0.75]), turned_axes(rng, half, tilt=0.06), material, tile_m)]
    if kind == "wall":
        half = np.array([rng.uniform(1, 3), rng.uniform(0.08, 0.3), rng.uniform(0.4, 1.5)])
        return [box(place + np.array([0, 0, half[2] * 0.75]), turned_axes(rng, half, tilt=0.02), material, tile_m)]
    if kind == "post":
        h = np.linspace(-0.2, rng.uniform(0.8, 3), 12)
        points = place + np.stack([rng.normal(0, 0.1) * h, rng.normal(0, 0.1) * h, h], -1)
        radius = rng.uniform(0.03, 0.25) * (1 + rng.uniform(0, 0.2) * np.sin(h * rng.uniform(2, 12)))
        radius[-1] = 1e-3
        points[-1] = points[-2]
        return [tubes(points[None], radius[None], 40, material, tile_m=tile_m)]
    if kind == "sphere":
        center = place + np.array([0, 0, size * 0.5])
        return [blob(rng, center, np.full(3, size * 0.5), material, tile_m, roughness=0.0)]
    plinth = turned_axes(rng, size * np.array([0.6, 0.6, 0.35]), tilt=0.01)
    parts = [box(place + np.array([0, 0, 0.2 * size]), plinth, material, tile_m)]
    z_top = 0.5 * size
    for _ in range(int(rng.integers(3, 8))):
        scale = size * rng.uniform(0.18, 0.5, 3)
        shift = rng.normal(0, 0.2 * size, 2)
        center = place + np.array([shift[0], shift[1], z_top + 0.5 * scale[2]])
        parts.append(blob(rng, center, scale, material, tile_m, roughness=rng.uniform(0.1, 0.35), rows=56))
        z_top += scale[2] * rng.uniform(0.4, 0.9)
    return parts
