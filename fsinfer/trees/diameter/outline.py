"""The closed outline of a stem that is not round: a low-order periodic Fourier series of the radius over the angle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsinfer.trees.cylinder.axis import AxisSettings, harmonics
from fsinfer.trees.points.cells import count_cells
from fsinfer.trees.points.sums import lengths, sums_of_products
from fsinfer.trees.points.surface import PATCH_M

Floats = NDArray[np.float64]


#: Numerics: directions in which the outline is drawn and its width taken.
_DIRECTIONS = 360
#: Numerics: noise below which points are not weighted any higher, metres.
_LEAST_NOISE_M = 0.002


@dataclass(frozen=True, kw_only=True)
class OutlineSettings:
    """Constants of :func:`fit_outline`.

    Harmonics go from ovals (2) to as many as the axis's fit has (4, buttressed stems): finer waves are bark, which a
    tape spans.

    Attributes
    ----------
    prior_of_radius: standard deviation of the harmonics, share of the radius; keeps noise from making waves.
        Source: not recorded.
    near: standard deviations of the noise, and share of the radius, within which points count. Source: not recorded.
    points_a_patch: what points within ``PATCH_M`` count for together. Source: not recorded.
    """

    prior_of_radius: float = 0.02
    near: tuple[float, float] = (4.0, 0.15)
    points_a_patch: float = 8.0


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
    order = AxisSettings().order
    angle = np.arctan2(offsets[:, 1], offsets[:, 0])
    deviation = lengths(offsets) - radius
    design = _harmonics(angle, order)
    design = np.column_stack([np.ones(len(angle)), design])
    near = weights * (np.abs(deviation) <= max(s.near[0] * sigma, s.near[1] * radius))
    cells = count_cells(offsets[near > 0.1], PATCH_M)
    independent = min(1.0, s.points_a_patch * cells / max(float(near.sum()), 1.0))
    information = sums_of_products((design * near[:, None]).T, design.T) * independent / max(sigma, _LEAST_NOISE_M) ** 2
    prior = np.r_[0.0, np.repeat(1.0 / np.arange(1, order + 1), 2) * s.prior_of_radius * radius]
    ridge = np.r_[1e-6, prior[1:] ** -2.0]
    gradient = sums_of_products(design.T, near * deviation) * independent / max(sigma, _LEAST_NOISE_M) ** 2
    coefficients = np.linalg.solve(information + np.diag(ridge), gradient)
    theta = np.linspace(-np.pi, np.pi, _DIRECTIONS + 1)[:-1]
    rho = radius + _harmonics(theta, order) @ coefficients[1:]
    curve = np.column_stack([rho * np.cos(theta), rho * np.sin(theta)])
    # Width in a direction is the extent of the outline along it; the mean width of a convex body is its girth / pi.
    direction = np.linspace(0.0, np.pi, _DIRECTIONS // 2 + 1)[:-1]
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
