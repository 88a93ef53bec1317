"""The ground: an analytic height field (so that the height at any point is exact) and its mesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from training.synthesize.forest.mesh import Mesh, grid_faces, make_mesh


@dataclass(frozen=True, kw_only=True)
class Terrain:
    """``z = gradient . (x, y) + sum_i amplitude_i sin(k_i . (x, y) + phase_i)``, metres."""

    gradient: NDArray[np.float64]
    wave: NDArray[np.float64]
    amplitude_m: NDArray[np.float64]
    phase: NDArray[np.float64]

    def height(
        self, x: NDArray[np.floating] | np.floating, y: NDArray[np.floating] | np.floating
    ) -> NDArray[np.float64]:
        """Ground height in metres at x, y (any shape)."""
        z = self.gradient[0] * x + self.gradient[1] * y
        for (kx, ky), amplitude, phase in zip(self.wave, self.amplitude_m, self.phase, strict=True):
            z = z + amplitude * np.sin(kx * x + ky * y + phase)
        return np.asarray(z, dtype=np.float64)


def make_terrain(rng: np.random.Generator, *, slope_deg: float, roughness: float) -> Terrain:
    """Random terrain; ``roughness`` 0..1 scales bumps from centimetres (25 cm long) to decimetres (12 m long)."""
    waves = 36
    length = np.exp(rng.uniform(np.log(0.25), np.log(12.0), waves))
    direction = rng.uniform(0, 2 * np.pi, waves)
    downhill = rng.uniform(0, 2 * np.pi)
    return Terrain(
        gradient=np.tan(np.radians(slope_deg)) * np.array([np.cos(downhill), np.sin(downhill)]),
        wave=2 * np.pi / length[:, None] * np.stack([np.cos(direction), np.sin(direction)], -1),
        amplitude_m=roughness * 0.012 * length**0.9 * rng.uniform(0.2, 1.0, waves),
        phase=rng.uniform(0, 2 * np.pi, waves),
    )


def terrain_mesh(
    terrain: Terrain, *, fine_radius_m: float, step_m: float, extent_m: float, material: int, tile_m: float
) -> Mesh:
    """A square grid, ``step_m`` inside ``fine_radius_m`` and growing geometrically out to ``extent_m``."""
    inner = np.arange(0, fine_radius_m, step_m)
    outer = [float(inner[-1])]
    grow = step_m
    while outer[-1] < extent_m:
        grow *= 1.12
        outer.append(outer[-1] + grow)
    half = np.concatenate([inner, outer[1:]])
    axis = np.concatenate([-half[:0:-1], half])
    x, y = np.meshgrid(axis, axis)
    vertices = np.stack([x, y, terrain.height(x, y)], -1).reshape(-1, 3)
    faces = grid_faces(len(axis), len(axis))
    return make_mesh(vertices, faces, vertices[:, :2] / tile_m, material)
