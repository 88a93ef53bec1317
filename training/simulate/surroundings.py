"""What stands round simulated stems: bumpy ground, litter, shrubs, and places where stems keep their distance."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass
class Parts:
    """Points (N, 3) of one thing after the other, each with the number of its stem, -1 for none."""

    points: list[Floats] = field(default_factory=list)
    owner: list[NDArray[np.int64]] = field(default_factory=list)

    def add(self, points: Floats, owner: int = -1) -> None:
        """Take in points (N, 3)."""
        self.points.append(points)
        self.owner.append(np.full(len(points), owner))


class Terrain:
    """A tilted plane with bumps of 1-3 m; call with xy (N, 2) for heights (N,)."""

    def __init__(
        self, rng: np.random.Generator, size: float, *, slope_deg: tuple[float, float], bumps_m: tuple[float, float]
    ) -> None:
        slope = np.tan(np.radians(rng.uniform(*slope_deg)))
        azimuth = rng.uniform(0.0, 2.0 * np.pi)
        self._tilt = slope * np.array([np.cos(azimuth), np.sin(azimuth)])
        self._bumps = rng.uniform(*bumps_m)
        self._wave = rng.normal(0.0, 1.0, (6, 2)) * 2.0 * np.pi / rng.uniform(2.0, 6.0, (6, 1)) / 1.4
        self._phase = rng.uniform(0.0, 2.0 * np.pi, 6)
        corners = np.array([[0.0, 0.0], [size, 0.0], [0.0, size], [size, size]]) @ self._tilt
        self.low, self.high = float(corners.min()), float(corners.max())

    def __call__(self, xy: Floats) -> Floats:
        """Heights (N,) at xy (N, 2)."""
        waves = np.sin(xy @ self._wave.T + self._phase).sum(axis=1) / np.sqrt(6.0)
        return np.asarray(xy @ self._tilt + self._bumps * waves)


def positions(rng: np.random.Generator, dbh: Floats, size: float, *, min_gap_m: float) -> Floats:
    """Random feet (T, 2) whose stems keep their distance; the last ones are dropped where no place is left."""
    feet = np.zeros((0, 2))
    for number, diameter in enumerate(dbh):
        for _ in range(300):
            at = rng.uniform(0.4, size - 0.4, 2)
            gap = np.hypot(*(feet - at).T) - 0.5 * (dbh[:number][: len(feet)] + diameter)
            if len(feet) == 0 or gap.min() >= min_gap_m:
                feet = np.vstack([feet, at])
                break
        else:
            break
    return feet


def shrub(rng: np.random.Generator, at: Floats, ground: Terrain, spacing: float) -> Floats:
    """Leaves in an ellipsoid on the ground: a herb or a shrub of 0.3 to 1.6 m."""
    height, width = rng.uniform(0.3, 1.6), rng.uniform(0.15, 0.5)
    leaves = rng.integers(60, 400)
    center = rng.normal(0.0, 1.0, (leaves, 3)) * [0.5 * width, 0.5 * width, 0.25 * height] + [*at, 0.45 * height]
    each = max(int(0.03**2 / spacing**2), 1)
    normal = rng.normal(0.0, 1.0, (leaves, 3))
    flat = rng.normal(0.0, 0.015, (leaves, each, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    flat -= (flat * normal[:, None]).sum(axis=2, keepdims=True) * normal[:, None]
    points: Floats = (center[:, None] + flat).reshape(-1, 3)
    points = points[points[:, 2] > 0.0]
    points[:, 2] += ground(points[:, :2])
    return points


def ground_points(
    rng: np.random.Generator, ground: Terrain, size: float, spacing: float, parts: Parts, *, sigma_m: float
) -> None:
    """Litter and grass over the plot and a metre round it."""
    count = int((size + 2.0) ** 2 / spacing**2)
    xy = rng.uniform(-1.0, size + 1.0, (count, 2))
    litter = np.abs(rng.normal(0.0, 0.015, count))
    grass = rng.random(count) < 0.05
    litter[grass] += rng.exponential(0.08, int(grass.sum()))
    parts.add(np.column_stack([xy, ground(xy) + litter + rng.normal(0.0, sigma_m, count)]))
