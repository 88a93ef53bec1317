"""One stem: its shape parameters, its mesh, and its true diameter measured on that mesh."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from training.synthesize.forest.material import Material, laid, lookup
from training.synthesize.forest.mesh import Mesh, grid_faces, make_mesh

#: Above the ground, metres. Source: convention.
BREAST_HEIGHT_M = 1.3
#: Stems a metre apart begin so many tiles apart in their bark: more than their own height and girth. Source: numerics.
TILES_APART = 41.0


@dataclass(frozen=True, kw_only=True)
class Stem:
    """Shape of a stem. Heights are above the terrain at the base point (x_m, y_m)."""

    x_m: float
    y_m: float
    z_ground_m: float
    dbh_m: float
    height_m: float
    taper: float
    lean: NDArray[np.float64]
    sweep_m: NDArray[np.float64]
    swell: float
    swell_lobes: int
    fourier: NDArray[np.float64]
    phase: NDArray[np.float64]
    twist: float
    relief_m: float
    material: int
    fork_at_m: float = 0.0

    def axis(self, h: NDArray[np.floating]) -> NDArray[np.float64]:
        """Axis points (n, 3) at heights ``h`` (n,) above the base."""
        bend = np.sin(np.clip(h / self.height_m, 0, 1) * np.pi)[:, None] * self.sweep_m
        xy = np.array([self.x_m, self.y_m]) + h[:, None] * self.lean + bend
        return np.concatenate([xy, (self.z_ground_m + h)[:, None]], axis=1)

    def radius(self, h: NDArray[np.floating]) -> NDArray[np.float64]:
        """Mean radius in metres at heights ``h`` without bark relief and without the butt swell's lobes."""
        top = np.clip((self.height_m - h) / (self.height_m - BREAST_HEIGHT_M), 0, None) ** self.taper
        flare = 1 + self.swell * (np.exp(-np.maximum(h, -0.2) / 0.28) - np.exp(-BREAST_HEIGHT_M / 0.28))
        radius: NDArray[np.float64] = np.maximum(self.dbh_m / 2 * top * flare, 0.004)
        return radius

    @property
    def lean_deg(self) -> float:
        """Lean of the axis between 0.3 m and 2.3 m, degrees from the vertical."""
        low, high = self.axis(np.array([0.3, 2.3]))
        return float(np.degrees(np.arctan2(np.hypot(*(high - low)[:2]), high[2] - low[2])))


def random_stem(
    rng: np.random.Generator, x_m: float, y_m: float, z_m: float, *, dbh_m: float, material: int, lean_scale: float = 1
) -> Stem:
    """Draw a stem's shape for a given place and diameter."""
    height = max(4.0, (6 + 32 * dbh_m**0.6) * rng.uniform(0.7, 1.15))
    lean = np.tan(np.radians(min(abs(rng.normal(0, 2.5 * lean_scale)), 12)))
    toward, bend = rng.uniform(0, 2 * np.pi, 2)
    sweep = rng.exponential(0.12) * lean_scale
    orders = np.arange(2, 7)
    return Stem(
        x_m=x_m,
        y_m=y_m,
        z_ground_m=z_m,
        dbh_m=dbh_m,
        height_m=height,
        taper=rng.uniform(0.6, 1.0),
        lean=lean * np.array([np.cos(toward), np.sin(toward)]),
        sweep_m=sweep * np.array([np.cos(bend), np.sin(bend)]),
        swell=rng.uniform(0.05, 0.7),
        swell_lobes=int(rng.integers(3, 7)),
        fourier=rng.normal(0, 0.035, len(orders)) / (orders - 1.0) ** 1.1,
        phase=rng.uniform(0, 2 * np.pi, len(orders) + 1),
        twist=rng.normal(0, 0.15),
        relief_m=float(np.clip(dbh_m * rng.uniform(0.01, 0.05), 0.001, 0.02)),
        material=material,
        fork_at_m=float(rng.uniform(2.0, 6.0)) if rng.random() < 0.06 else 0.0,
    )


def stem_mesh(
    stem: Stem, materials: list[Material], *, sides: int, step_m: float, tint: NDArray[np.float32] | None = None
) -> Mesh:
    """Mesh of the stem from 0.4 m under the ground; rows ``step_m`` apart up to 3 m, coarser above."""
    heights = [np.arange(-0.4, 0.0, 2 * step_m), np.arange(0.0, 3.0, step_m)]
    heights += [np.arange(3.0, min(7.0, stem.height_m), max(0.12, step_m))]
    if stem.height_m > 7:
        heights.append(np.linspace(7.0, stem.height_m, max(3, int((stem.height_m - 7) / 0.8))))
    h = np.concatenate(heights)
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    turned = angle[None] + stem.twist * h[:, None]
    shape = np.ones_like(turned)
    for order, amplitude, phase in zip(range(2, 7), stem.fourier, stem.phase[:-1], strict=True):
        shape += amplitude * np.cos(order * turned + phase)
    lobes = np.cos(stem.swell_lobes * angle[None] + stem.phase[-1])
    shape += 0.35 * stem.swell * np.exp(-np.maximum(h, 0) / 0.25)[:, None] * lobes
    radius = stem.radius(h)[:, None] * shape
    material = materials[stem.material]
    if material.patched:  # at its true size; where its two ends meet is one border more
        u = np.broadcast_to(angle * stem.dbh_m / 2 / material.tile_m, radius.shape)
        v = np.broadcast_to((-h / material.tile_m)[:, None], radius.shape)
    else:
        u, v = _closed(stem, angle, h, material.tile_m)
    # Stems of one material show other parts of it.
    u, v = u + TILES_APART * stem.y_m, v + TILES_APART * stem.x_m
    if material.height and stem.relief_m > 0:
        # The level whose texels are about as large as the mesh's quads: finer relief would alias.
        spacing_texels = np.pi * stem.dbh_m / sides / material.tile_m * material.height[0].shape[1]
        level = round(max(0.0, np.log2(spacing_texels)))
        relief = material.height[min(level, len(material.height) - 1)]
        uv = np.stack([u, v], -1).reshape(-1, 2).astype(np.float32)
        radius = radius + stem.relief_m * (lookup_field(relief, laid(material, uv)).reshape(radius.shape) - 0.5)
        radius[:, -1] = radius[:, 0]
    axis = stem.axis(h)
    vertices = axis[:, None] + np.stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros_like(radius)], -1)
    mesh = make_mesh(
        vertices.reshape(-1, 3),
        grid_faces(len(h), sides + 1),
        np.stack([u, v], -1).reshape(-1, 2),
        stem.material,
        tint=(1, 1, 1) if tint is None else tint,
    )
    normals = mesh.normals.reshape(len(h), sides + 1, 3)
    normals[:, 0] += normals[:, -1]
    normals[:, 0] /= np.linalg.norm(normals[:, 0], axis=-1, keepdims=True)
    normals[:, -1] = normals[:, 0]
    if tint is None:  # darker and greener at the foot, where dirt and moss are
        foot = np.exp(-np.maximum(h, 0) / 0.4)[:, None] * np.array([0.35, 0.25, 0.4])
        mesh.tint[:] = np.repeat((1 - foot).astype(np.float32), sides + 1, axis=0)
    return mesh


def _closed(
    stem: Stem, angle: NDArray[np.float64], h: NDArray[np.float64], tile_m: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Where a tile that repeats lies round a stem, (heights, angles) each, so that its two ends meet without a seam."""
    none = np.zeros((len(h), len(angle)))
    girth_m = np.pi * stem.dbh_m
    around = max(1, round(girth_m / tile_m))
    if around == 1 and girth_m < 0.6 * tile_m:  # a thin stem shows a strip of the tile, there and back
        return np.abs(angle / np.pi - 1)[None] * girth_m / tile_m + none, (-h / tile_m)[:, None] + none
    # The true scale of the tile around the stem differs from tile_m; rows keep the picture's proportions.
    return (angle / (2 * np.pi) * around)[None] + none, (-h * around / girth_m)[:, None] + none


def lookup_field(field: NDArray[np.float32], uv: NDArray[np.float32]) -> NDArray[np.float32]:
    """Bilinear periodic lookup of a (S, S) float field at ``uv`` (n, 2) tiles."""
    return lookup(field, uv)


@dataclass(frozen=True, kw_only=True)
class Section:
    """True section of a stem (see :func:`measure_section`)."""

    center: NDArray[np.float64]
    dbh_cm: float
    dbh_area_cm: float


def measure_section(stem: Stem, mesh: Mesh, *, height_m: float = BREAST_HEIGHT_M) -> Section:
    """Cut ``mesh`` by the plane across the axis at a height above the ground at the stem's base point, 7 m at most.

    ``dbh_cm`` is what a tape shows: the perimeter of the section's convex hull / pi. ``dbh_area_cm`` is the
    diameter of the circle of equal area. The height is taken vertically along the axis.
    """
    below, center, above = stem.axis(np.array([height_m - 0.1, height_m, height_m + 0.1]))
    normal = (above - below) / np.linalg.norm(above - below)
    vertices = mesh.vertices.astype(np.float64)
    signed = (vertices - center) @ normal
    faces = mesh.faces[np.abs(signed[mesh.faces]).min(1) < 0.3]
    points = []
    for i, j in ((0, 1), (1, 2), (2, 0)):
        a, b = faces[:, i], faces[:, j]
        crossing = (signed[a] < 0) != (signed[b] < 0)
        a, b = a[crossing], b[crossing]
        t = signed[a] / (signed[a] - signed[b])
        points.append(vertices[a] + t[:, None] * (vertices[b] - vertices[a]))
    cut = np.concatenate(points) - center
    right = np.cross(normal, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    plane = np.stack([cut @ right, cut @ np.cross(normal, right)], -1)
    plane = plane[np.argsort(np.arctan2(plane[:, 1], plane[:, 0]))]
    hull = cv2.convexHull(plane.astype(np.float32))[:, 0].astype(np.float64)
    perimeter = float(np.linalg.norm(hull - np.roll(hull, 1, axis=0), axis=1).sum())
    x, y = plane.T
    area = 0.5 * abs(float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))))
    return Section(center=center, dbh_cm=100 * perimeter / np.pi, dbh_area_cm=200 * float(np.sqrt(area / np.pi)))


def stem_curve(stem: Stem, mesh: Mesh) -> list[tuple[float, float]]:
    """Heights in metres, every half metre, and what a tape shows there in cm (:func:`measure_section`).

    Up to 6.5 m, above which the mesh is coarse, or half a metre below a fork and two below the top.
    """
    highest = min(6.5, stem.height_m - 2.0, stem.fork_at_m - 0.5 if stem.fork_at_m else np.inf)
    heights = np.arange(0.5, highest + 1e-9, 0.5)
    return [(float(h), measure_section(stem, mesh, height_m=float(h)).dbh_cm) for h in heights]
