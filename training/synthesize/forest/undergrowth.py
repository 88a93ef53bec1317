"""What lies and grows on the ground: litter, stones, logs, tufts of grass, ferns, shrubs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from training.synthesize.forest.clutter import blob
from training.synthesize.forest.foliage import leaf_cards
from training.synthesize.forest.mesh import Mesh, quads, tubes
from training.synthesize.forest.terrain import Terrain


def scatter(rng: np.random.Generator, count: int, radius_m: float, *, clumps: int = 0) -> NDArray[np.float64]:
    """(count, 2) places in a disc, denser around ``clumps`` centres."""
    r, a = radius_m * np.sqrt(rng.random(count)), rng.uniform(0, 2 * np.pi, count)
    places = np.stack([r * np.cos(a), r * np.sin(a)], -1)
    if clumps:
        centers = places[rng.integers(0, count, clumps)]
        grouped = centers[rng.integers(0, clumps, count)] + rng.normal(0, 0.7, (count, 2))
        places = np.where(rng.random((count, 1)) < 0.75, grouped, places)
    return places


def litter(rng: np.random.Generator, terrain: Terrain, places: NDArray[np.floating], materials: list[int]) -> Mesh:
    """Single leaves lying nearly flat, a little above the terrain."""
    count = len(places)
    size = rng.uniform(0.015, 0.05, (count, 1))
    azimuth = rng.uniform(0, 2 * np.pi, count)
    right = np.stack([np.cos(azimuth), np.sin(azimuth), rng.normal(0, 0.25, count)], -1)
    up = np.stack([-np.sin(azimuth), np.cos(azimuth), rng.normal(0, 0.25, count)], -1) * 0.7
    z = terrain.height(places[:, 0], places[:, 1]) + rng.uniform(0.004, 0.02, count)
    normals = np.cross(right, up)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    tint = np.exp(rng.normal(0, 0.25, (count, 1)) + rng.normal(0, 0.08, (count, 3)))
    center = np.concatenate([places, z[:, None]], 1)
    return quads(center, right * size, up * size, rng.choice(materials, count), tint=tint, normals=normals)


def tufts(
    rng: np.random.Generator,
    terrain: Terrain,
    places: NDArray[np.floating],
    materials: list[int],
    *,
    height_m: tuple[float, float],
) -> Mesh:
    """Upright cards with their foot on the ground, two crossed ones a plant."""
    places = np.repeat(places, 2, axis=0)
    count = len(places)
    half = np.repeat(rng.uniform(*height_m, count // 2) / 2, 2)[:, None]
    azimuth = np.repeat(rng.uniform(0, np.pi, count // 2), 2) + np.tile([0, np.pi / 2], count // 2)
    right = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(count)], -1) * half * rng.uniform(0.6, 1.2, (count, 1))
    up = np.stack([*rng.normal(0, 0.2, (2, count)), np.ones(count)], -1) * half
    z = terrain.height(places[:, 0], places[:, 1]) - 0.01
    center = np.concatenate([places, z[:, None]], 1) + up
    tint = np.exp(rng.normal(0, 0.2, (count, 1)) + rng.normal(0, 0.05, (count, 3)))
    normals = np.tile(np.array([[0.0, 0.0, 1.0]]), (count, 1))
    return quads(center, right, up, rng.choice(materials, count), tint=tint, normals=normals)


def shrub(
    rng: np.random.Generator, terrain: Terrain, place: NDArray[np.floating], bark: int, leaves: list[int]
) -> tuple[Mesh, Mesh]:
    """Thin stems fanning out of one foot, and leaf cards on them."""
    count, steps = int(rng.integers(5, 14)), 5
    t = np.linspace(0, 1, steps)
    height = rng.uniform(0.5, 2.0) * rng.uniform(0.6, 1.0, count)
    azimuth = rng.uniform(0, 2 * np.pi, count)
    spread = height * rng.uniform(0.1, 0.5, count)
    points = np.zeros((count, steps, 3))
    points[..., 0] = place[0] + spread[:, None] * t**1.5 * np.cos(azimuth)[:, None]
    points[..., 1] = place[1] + spread[:, None] * t**1.5 * np.sin(azimuth)[:, None]
    points[..., 2] = terrain.height(place[0], place[1]) - 0.03 + height[:, None] * t
    stems = tubes(points, rng.uniform(0.003, 0.01, (count, 1)) * (1 - 0.8 * t), 5, bark, tile_m=0.5)
    ends = np.repeat(points[:, 1:].reshape(-1, 3), 3, axis=0)
    return stems, leaf_cards(rng, ends, leaves, size_m=rng.uniform(0.12, 0.3), spread_m=0.08)


def stones(
    rng: np.random.Generator, terrain: Terrain, places: NDArray[np.floating], material: int, tile_m: float
) -> list[Mesh]:
    """Half-sunk stones of 3 to 40 cm."""
    meshes = []
    for x, y in places:
        radius = float(np.exp(rng.uniform(np.log(0.03), np.log(0.3))))
        center = np.array([x, y, terrain.height(x, y) + radius * rng.uniform(-0.3, 0.3)])
        scale = radius * rng.uniform(0.6, 1.4, 3)
        meshes.append(blob(rng, center, scale, material, tile_m, roughness=0.25, rows=20))
    return meshes


def log(rng: np.random.Generator, terrain: Terrain, place: NDArray[np.floating], material: int, tile_m: float) -> Mesh:
    """A fallen stem following the terrain."""
    length, radius, azimuth = rng.uniform(1.5, 6), rng.uniform(0.04, 0.2), rng.uniform(0, 2 * np.pi)
    t = np.linspace(-0.5, 0.5, 24) * length
    x, y = place[0] + t * np.cos(azimuth), place[1] + t * np.sin(azimuth)
    line = np.polyval(np.polyfit(t, terrain.height(x, y), 1), t)
    points = np.stack([x, y, line + radius * 0.6], -1)
    radii = radius * (1 - 0.3 * np.linspace(0, 1, 24)) * (1 + 0.03 * rng.standard_normal(24))
    radii[[0, -1]] = 1e-3  # closes the ends
    points[0], points[-1] = points[1], points[-2]
    return tubes(points[None], radii[None], 28, material, tile_m=tile_m)
