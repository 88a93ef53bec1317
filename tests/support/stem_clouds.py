"""Simulated plots with truth: stems with taper, lean and ovality, seen in part, with noise and an outward tail."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class StemPlot:
    """Points (N, 3) in metres; truth per tree: xy (T, 2) at breast height and DBH (T,) as girth / pi."""

    points: Floats
    xy: Floats
    dbh_cm: Floats
    z_ground: Floats

    def stem_at(self, x_m: float, y_m: float) -> int:
        """Which stem stands nearest to a place."""
        return int(np.argmin(np.hypot(*(self.xy - [x_m, y_m]).T)))


def terrain(xy: Floats, slope: float, bumps_m: float) -> Floats:
    """Ground height (N,) of a tilted, gently waved terrain."""
    wave = np.sin(0.7 * xy[:, 0] + 0.4) * np.cos(0.5 * xy[:, 1])
    return slope * xy[:, 0] - 0.5 * slope * xy[:, 1] + bumps_m * wave


def stem_plot(
    *,
    seed: int = 0,
    trees: int = 25,
    spacing_m: float = 0.01,
    sigma_m: float = 0.003,
    outliers: float = 0.0,
    hidden: float = 0.0,
    slope: float = 0.0,
    bumps_m: float = 0.0,
    ovality: float = 0.02,
    shrubs: int = 0,
    flyers: int = 0,
    dbh_cm: tuple[float, float] = (10.0, 45.0),
    lean_deg: float = 3.0,
    top_m: float = 4.0,
    ground: bool = True,
) -> StemPlot:
    """Stems on a jittered grid of 2.2 m; ``hidden`` is the share of stems of which only about half is seen."""
    rng = np.random.default_rng(seed)
    side = int(np.ceil(np.sqrt(trees)))
    grid = np.stack(np.meshgrid(np.arange(side), np.arange(side)), -1).reshape(-1, 2)[:trees]
    foot = 2.2 * (grid + 0.5) + rng.uniform(-0.6, 0.6, (trees, 2))
    dbh = rng.uniform(*dbh_cm, trees) / 100.0
    z_foot = terrain(foot, slope, bumps_m)
    size = 2.2 * side
    parts = []
    center = np.zeros((trees, 2))
    for tree in range(trees):
        tilt = np.tan(np.radians(rng.uniform(0.0, lean_deg)))
        azimuth = rng.uniform(0.0, 2.0 * np.pi)
        slope_xy = tilt * np.array([np.cos(azimuth), np.sin(azimuth)])
        arc = rng.uniform(150.0, 200.0) if rng.random() < hidden else 360.0
        middle = rng.uniform(0.0, 2.0 * np.pi)
        points = wall(
            rng, radius=dbh[tree] / 2, arc_deg=arc, middle=middle, top_m=top_m, spacing_m=spacing_m, ovality=ovality
        )
        points[:, :2] += foot[tree] + points[:, 2:3] * slope_xy
        noise = rng.normal(0.0, sigma_m, points.shape) * [1.0, 1.0, 0.5]
        away = rng.random(len(points)) < outliers
        outward = points[:, :2] - foot[tree] - points[:, 2:3] * slope_xy
        outward /= np.linalg.norm(outward, axis=1, keepdims=True)
        noise[away, :2] += outward[away] * rng.exponential(0.03, away.sum())[:, None]
        points += noise
        points[:, 2] += z_foot[tree]
        parts.append(points)
        center[tree] = foot[tree] + 1.3 * slope_xy
    if ground:
        count = int((size + 2.0) ** 2 / max(spacing_m, 0.02) ** 2)
        xy = rng.uniform(-1.0, size + 1.0, (count, 2))
        litter = np.abs(rng.normal(0.0, 0.01, count))
        parts.append(np.column_stack([xy, terrain(xy, slope, bumps_m) + litter + rng.normal(0.0, sigma_m, count)]))
    for _ in range(shrubs):
        at = foot[rng.integers(trees)] + rng.normal(0.0, 0.5, 2)
        count = int(0.3 / spacing_m**2)
        blob = rng.normal(0.0, 1.0, (count, 3)) * [0.22, 0.22, 0.25] + [*at, 0.35]
        blob = blob[blob[:, 2] > 0.0]
        blob[:, 2] += terrain(blob[:, :2], slope, bumps_m)
        parts.append(blob)
    if flyers:
        parts.append(rng.uniform([-1.0, -1.0, -0.5], [size + 1.0, size + 1.0, top_m], (flyers, 3)))
    return StemPlot(points=np.concatenate(parts), xy=center, dbh_cm=100.0 * dbh, z_ground=z_foot)


def wall(
    rng: np.random.Generator,
    *,
    radius: float,
    arc_deg: float = 360.0,
    middle: float = 0.0,
    top_m: float = 4.0,
    spacing_m: float = 0.01,
    ovality: float = 0.0,
    taper: float = -0.005,
) -> Floats:
    """Points (N, 3) of a stem about the z axis whose radius at 1.3 m is ``radius``; ovality keeps the girth."""
    arc = np.radians(arc_deg)
    count = int(arc * radius * top_m / spacing_m**2)
    angle = middle + rng.uniform(-arc / 2, arc / 2, count)
    height = rng.uniform(0.0, top_m, count)
    swell = 0.03 * np.exp(-height / 0.25)
    at_height = radius + taper * (height - 1.3) + swell
    phase = rng.uniform(0.0, np.pi)
    at_height = at_height * (1.0 + ovality * np.cos(2.0 * (angle - phase)))
    return np.column_stack([at_height * np.cos(angle), at_height * np.sin(angle), height])


def forked_stem(
    rng: np.random.Generator, *, at: tuple[float, float], height_m: float, sigma_m: float = 0.004
) -> Floats:
    """A trunk of 40 cm at ``at`` that parts at ``height_m`` into two stems of 28 cm, 12 degrees aslant each way."""
    trunk, branch, count = 0.2, 0.14, 30_000
    turn, height = rng.uniform(0, 2 * np.pi, count), rng.uniform(0, height_m, count)
    parts = [np.column_stack([trunk * np.cos(turn), trunk * np.sin(turn), height])]
    for side in (-1, 1):
        turn, height = rng.uniform(0, 2 * np.pi, count), rng.uniform(height_m - 0.25, 4.0, count)
        aside = 0.05 + np.tan(np.radians(12.0)) * (height - height_m + 0.25)
        wall = np.column_stack([side * aside + branch * np.cos(turn), branch * np.sin(turn), height])
        # Bark is the outside of all three.
        inside = np.hypot(wall[:, 0] + side * aside, wall[:, 1]) < branch
        inside |= (height < height_m) & (np.hypot(wall[:, 0], wall[:, 1]) < trunk)
        parts.append(wall[~inside])
    points = np.concatenate(parts)
    return np.asarray(points + np.array([*at, 0.0]) + rng.normal(0.0, sigma_m, points.shape))


def post(rng: np.random.Generator, *, at: tuple[float, float], width_m: float, top_m: float, sigma_m: float) -> Floats:
    """A square post standing at ``at``, seen from all sides."""
    count = int(4 * width_m * top_m / 0.008**2)
    along = rng.uniform(-0.5, 0.5, count) * width_m
    side = rng.integers(0, 4, count)
    x = np.choose(side, [along, along, np.full(count, width_m / 2), np.full(count, -width_m / 2)])
    y = np.choose(side, [np.full(count, width_m / 2), np.full(count, -width_m / 2), along, along])
    z = rng.uniform(0.0, top_m, count)
    return np.column_stack([x + at[0], y + at[1], z]) + rng.normal(0.0, sigma_m, (count, 3))


def board(rng: np.random.Generator, *, at: tuple[float, float], sigma_m: float) -> Floats:
    """A flat board 40 cm wide and 1.6 m high, seen from the front."""
    count = int(0.4 * 1.6 / 0.008**2)
    points = np.column_stack([rng.uniform(-0.2, 0.2, count), np.zeros(count), rng.uniform(0.0, 1.6, count)])
    moved: Floats = points + np.array([*at, 0.0]) + rng.normal(0.0, sigma_m, (count, 3))
    return moved
