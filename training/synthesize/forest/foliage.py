"""Branches of a stem (dead twigs below, live ones in the crown) and the leaf cards on them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from training.synthesize.forest.mesh import Mesh, quads, tubes
from training.synthesize.forest.stem import Stem


def branches(
    rng: np.random.Generator, stem: Stem, *, dead: int, live: int, crown_m: float, tile_m: float
) -> tuple[list[Mesh], NDArray[np.float64]]:
    """Return branch meshes and the (n, 3) places where leaves hang."""
    count = dead + live
    if count == 0:
        return [], np.zeros((0, 3))
    top = stem.height_m * 0.97
    start_h = np.concatenate([rng.uniform(0.8, max(1.2, crown_m), dead), rng.uniform(min(crown_m, top), top, live)])
    reach = np.concatenate([rng.uniform(0.15, 1.1, dead), np.zeros(live)])
    share = np.clip((stem.height_m - start_h[dead:]) / max(stem.height_m - crown_m, 0.5), 0.12, 1)
    reach[dead:] = share**0.7 * rng.uniform(0.7, 1.2, live) * (0.8 + 5.5 * stem.dbh_m)
    azimuth = rng.uniform(0, 2 * np.pi, count)
    rise = rng.normal(0.15, 0.35, count)
    steps = 8
    t = np.linspace(0, 1, steps)
    outward = np.stack([np.cos(azimuth), np.sin(azimuth)], -1)
    points = np.repeat(stem.axis(start_h)[:, None], steps, axis=1)
    points[..., :2] += outward[:, None] * (t[None] * reach[:, None])[..., None]
    points[..., 2] += reach[:, None] * (rise[:, None] * t - 0.15 * t**2)
    bends = np.cumsum(rng.normal(0, 0.02, (count, steps - 2, 3)), axis=1)
    points[:, 2:] += bends * reach[:, None, None]
    thick = np.minimum(np.concatenate([rng.uniform(0.003, 0.012, dead), reach[dead:] * 0.012]), 0.04)
    thick = np.minimum(thick, stem.radius(start_h) * 0.6)
    radii = thick[:, None] * (1 - 0.85 * t)
    meshes = [tubes(points, radii, 6, stem.material, tile_m=tile_m, tint=(0.8, 0.78, 0.75))]
    ends = points[dead:, 2:].reshape(-1, 3)
    return meshes, ends


def fork(stem: Stem, rng: np.random.Generator, tile_m: float) -> Mesh:
    """A second leader that leaves the stem at ``stem.fork_at_m``."""
    h = np.linspace(stem.fork_at_m - 0.3, stem.height_m * 0.9, 14)
    points = stem.axis(h)
    out = rng.uniform(0, 2 * np.pi)
    along = (h - h[0])[:, None]
    points[:, :2] += 0.9 * (1 - np.exp(-along / 1.2)) * np.array([np.cos(out), np.sin(out)]) * (0.6 + stem.dbh_m)
    return tubes(points[None], stem.radius(h)[None] * 0.75, 24, stem.material, tile_m=tile_m)


def leaf_cards(
    rng: np.random.Generator,
    places: NDArray[np.floating],
    materials: list[int],
    *,
    size_m: float,
    spread_m: float,
) -> Mesh:
    """One card of about ``size_m`` near each place, turned at random, drooping a little."""
    count = len(places)
    center = places + rng.normal(0, spread_m, (count, 3))
    azimuth = rng.uniform(0, 2 * np.pi, count)
    right = np.stack([np.cos(azimuth), np.sin(azimuth), rng.normal(0, 0.3, count)], -1)
    up = rng.normal(0, 1, (count, 3)) * [0.7, 0.7, 0.8]
    up -= (up * right).sum(1, keepdims=True) * right / (right**2).sum(1, keepdims=True)
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    half = size_m / 2 * rng.uniform(0.6, 1.3, (count, 1))
    tint = np.exp(rng.normal(0, 0.15, (count, 1)) + rng.normal(0, 0.04, (count, 3)))
    return quads(center, right * half, up * half, rng.choice(materials, count), tint=tint)
