"""A metre of bark about breast height, of any section, and what a tape and a search would have of it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from fsinfer.trees.cylinder.axis import Axis
from fsinfer.trees.search.stem import Stem

Floats = NDArray[np.float64]
BH = 1.3


def bark(
    rng: np.random.Generator,
    radius: float,
    *,
    taper: float = -0.006,
    arc_deg: float = 360.0,
    count: int = 2500,
    sigma_m: float = 0.002,
    shape: Sequence[tuple[int, float, float]] = (),
    slope: tuple[float, float] = (0.0, 0.0),
) -> Floats:
    """Points (N, 3) on a metre of stem about breast height; ``shape`` are harmonics: number, cosine, sine of radius."""
    arc = np.radians(arc_deg)
    angle = rng.uniform(-arc / 2, arc / 2, int(count * arc_deg / 360))
    height = rng.uniform(BH - 0.5, BH + 0.5, len(angle))
    rho = radius * section(angle, shape) + taper * (height - BH)
    points = np.column_stack([rho * np.cos(angle), rho * np.sin(angle), height])
    points[:, :2] += (height - BH)[:, None] * np.array(slope)
    normal = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(len(angle))])
    moved: Floats = points + normal * rng.normal(0.0, sigma_m, len(angle))[:, None]
    return moved


def section(angle: Floats, shape: Sequence[tuple[int, float, float]]) -> Floats:
    return np.asarray(1.0 + sum((c * np.cos(k * angle) + s * np.sin(k * angle) for k, c, s in shape), np.zeros(1)))


def tape(radius: float, shape: Sequence[tuple[int, float, float]]) -> float:
    """What a tape reads of a section, over 2 pi."""
    angle = np.linspace(0.0, 2.0 * np.pi, 3600, endpoint=False)
    rho = radius * section(angle, shape)
    hull = ConvexHull(np.column_stack([rho * np.cos(angle), rho * np.sin(angle)]))
    return float(hull.area / (2.0 * np.pi))  # the "area" of a hull in the plane is its girth


def stem_of(radius: float, *, taper: float = -0.006, sigma_m: float = 0.004) -> Stem:
    """What the search would have of it."""
    axis = Axis(parameters=np.array([0.0, 0.0, 0.0, 0.0, radius, taper]), height_m=BH, sigma_m=sigma_m)
    return Stem(axis=axis, bottom_m=0.4, top_m=3.0, length_m=2.6, arc_coverage=1.0, quality=1.0)
