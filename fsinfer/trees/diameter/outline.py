"""The closed outline of a stem that is not round: a low-order periodic Fourier series of the radius over the angle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsinfer.trees.cylinder.axis import harmonics
from fsinfer.trees.points.cells import count_cells
from fsinfer.trees.points.sums import lengths, sums_of_products

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class OutlineSettings:
    """Constants of :func:`fit_outline`."""

    order: int = 4  # harmonics: ovals (2) to buttressed stems (4); finer waves are bark, which a tape spans
    prior_of_radius: float = 0.02  # harmonics of stems are a few per cent of the radius; keeps noise from making waves
    patch_m: float = 0.015  # points within such a patch share their error


@dataclass(frozen=True, kw_only=True)
class Outline:
    """Outline (K, 2) in metres about the axis, closed (the first point is not repeated), and what callipers would read.

    ``girth_diameter_m`` is the girth of the convex hull divided by pi: what a diameter tape reads.
    """

    curve_m: Floats
    girth_diameter_m: float
    min_diameter_m: float
    max_diameter_m: float


def fit_outline(
    offsets: Floats, weights: Floats, radius: float, sigma: float, *, settings: OutlineSettings | None = None
) -> Outline:
    """Weighted ridge fit of the harmonics to offsets (N, 2) about the axis; ``radius`` fixes the mean radius."""
    s = settings or OutlineSettings()
    angle = np.arctan2(offsets[:, 1], offsets[:, 0])
    deviation = lengths(offsets) - radius
    design = _harmonics(angle, s.order)
    design = np.column_stack([np.ones(len(angle)), design])
    near = weights * (np.abs(deviation) <= max(4.0 * sigma, 0.15 * radius))
    cells = count_cells(offsets[near > 0.1], s.patch_m)
    independent = min(1.0, 8.0 * cells / max(float(near.sum()), 1.0))
    information = sums_of_products((design * near[:, None]).T, design.T) * independent / max(sigma, 0.002) ** 2
    prior = np.r_[0.0, np.repeat(1.0 / np.arange(1, s.order + 1), 2) * s.prior_of_radius * radius]
    ridge = np.r_[1e-6, prior[1:] ** -2.0]
    gradient = sums_of_products(design.T, near * deviation) * independent / max(sigma, 0.002) ** 2
    coefficients = np.linalg.solve(information + np.diag(ridge), gradient)
    theta = np.linspace(-np.pi, np.pi, 361)[:-1]
    rho = radius + _harmonics(theta, s.order) @ coefficients[1:]
    curve = np.column_stack([rho * np.cos(theta), rho * np.sin(theta)])
    # Width in a direction is the extent of the outline along it; the mean width of a convex body is its girth / pi.
    direction = np.linspace(0.0, np.pi, 181)[:-1]
    along = curve @ np.stack([np.cos(direction), np.sin(direction)])
    width = along.max(axis=0) - along.min(axis=0)
    return Outline(
        curve_m=curve,
        girth_diameter_m=float(width.mean()),
        min_diameter_m=float(width.min()),
        max_diameter_m=float(width.max()),
    )


def _harmonics(angle: Floats, order: int) -> Floats:
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.column_stack([cosine, sine, harmonics(cosine, sine, 2 * order - 2)])
