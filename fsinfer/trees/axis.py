"""A stem as a leaning, tapering cylinder: point-to-line distances and a robust fit that expects an outward tail.

The residual of a point is its distance from the axis minus the radius at its foot point. Residuals are explained by a
mixture: a Gaussian core (bark), an exponential tail outward of it (edge fattening, moss, flying points stand outside a
stem far more often than inside) and a uniform background. Expectation-maximisation weights each point by its
probability of belonging to the core, so that the tail does not pull the radius; the M-step is Gauss-Newton.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfcx

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class AxisSettings:
    """Constants of :func:`fit_axis`."""

    iterations: int = 40
    sigma_m: tuple[float, float] = (0.0015, 0.03)  # best TLS; beyond 3 cm no bark is left to see
    window_m: float = 0.12  # residuals beyond this are not looked at
    tail_m: tuple[float, float] = (0.01, 0.06)  # mean length of the outward tail
    taper_mean: float = -0.006  # radius lost per metre of height around breast height: about 1 cm of diameter per metre
    taper_std: float = 0.008  # between cylindrical and butt swell
    lean_std: float = 0.10  # tangent of the lean; 6 degrees
    prior_points: float = 20.0  # strength of the tail shares' prior: a fit of 20 points should not invent a tail


@dataclass(frozen=True, kw_only=True)
class AxisFit:
    """Parameters (6,): x, y at ``height_m``, slopes dx/dh, dy/dh, radius, taper dr/dh; and the noise found.

    ``covariance`` (6, 6) assumes independent residuals. ``core`` (N,) is each point's probability of being bark.
    """

    parameters: Floats
    height_m: float
    sigma_m: float
    covariance: Floats
    core: Floats
    residuals_m: Floats

    @property
    def radius_m(self) -> float:
        """Radius at ``height_m``."""
        return float(self.parameters[4])

    @property
    def lean_deg(self) -> float:
        """Angle between the axis and the vertical."""
        return float(np.degrees(np.arctan(np.hypot(self.parameters[2], self.parameters[3]))))

    def center_at(self, height_m: float) -> Floats:
        """Axis position (2,) where it passes ``height_m``."""
        return np.asarray(self.parameters[:2] + self.parameters[2:4] * (height_m - self.height_m))


def axis_coordinates(points: Floats, parameters: Floats, height_m: float) -> tuple[Floats, Floats]:
    """Offsets (N, 2) from the axis in the plane perpendicular to it, and height (N,) of the foot points over height_m.

    ``points`` (N, 3) are x, y and height above ground.
    """
    slope = parameters[2:4]
    norm2 = 1.0 + float(slope @ slope)
    x = points[:, 0] - parameters[0]
    y = points[:, 1] - parameters[1]
    z = points[:, 2] - height_m
    foot = (x * slope[0] + y * slope[1] + z) / norm2
    x, y, z = x - foot * slope[0], y - foot * slope[1], z - foot
    # Orthonormal basis of the plane: the horizontal x axis leaned over, and its perpendicular.
    u = np.array([slope[0], slope[1], 1.0]) / np.sqrt(norm2)
    e1 = np.array([1.0, 0.0, 0.0]) - u[0] * u
    e1 /= np.linalg.norm(e1)
    e2 = np.cross(u, e1)
    return np.column_stack([x * e1[0] + y * e1[1] + z * e1[2], x * e2[0] + y * e2[1] + z * e2[2]]), foot


def fit_axis(
    points: Floats,
    start: Floats,
    height_m: float,
    *,
    sigma_m: float = 0.02,
    settings: AxisSettings | None = None,
    weights: Floats | None = None,
) -> AxisFit:
    """Fit a tapered cylinder to points (N, 3) of x, y, height (metres) from ``start`` (6,) by EM."""
    s = settings or AxisSettings()
    p = start.astype(np.float64).copy()
    given = np.ones(len(points)) if weights is None else weights
    prior_mean = np.array([0.0, 0.0, 0.0, 0.0, 0.0, s.taper_mean])
    prior_information = np.array([0.0, 0.0, s.lean_std**-2, s.lean_std**-2, 0.0, s.taper_std**-2])
    sigma, tail, shares = sigma_m, 0.03, np.array([0.8, 0.12, 0.08])
    core = np.zeros(len(points))
    residual = np.zeros(len(points))
    information = np.eye(6)
    for iteration in range(s.iterations):
        residual, jacobian = _residuals(points, p, height_m)
        inner = min(s.window_m, max(p[4], 0.02))
        inside = (residual >= -inner) & (residual <= s.window_m)
        likelihood = np.stack(
            [
                shares[0] * _gauss(residual, sigma),
                shares[1] * _gauss_with_tail(residual, sigma, tail),
                np.full(len(residual), shares[2] / (s.window_m + inner)),
            ]
        )
        likelihood *= (inside * given) / np.maximum(likelihood.sum(axis=0), 1e-300)
        core = likelihood[0]
        total = float(core.sum())
        if total < 3.0:
            break
        information = (jacobian * (core / sigma**2)[:, None]).T @ jacobian
        regularised = information + np.diag(prior_information) + 1e-9 * np.eye(6)
        gradient = jacobian.T @ (core * residual / sigma**2) + prior_information * (p - prior_mean)
        step = -np.linalg.solve(regularised, gradient)
        step *= min(1.0, 0.05 / max(np.abs(step[[0, 1, 4]]).max(), 1e-12))
        p = p + step
        p[4] = max(p[4], 0.01)
        shares = likelihood.sum(axis=1) + s.prior_points * np.array([0.9, 0.05, 0.05])
        shares /= shares.sum()
        new_sigma = float(np.sqrt((core @ residual**2 + 4.0 * 0.005**2) / (total + 4.0)))
        # The start is deliberately wide; never shrink by more than a quarter a step, or a wrong arc captures the fit.
        sigma = float(np.clip(max(new_sigma, 0.75 * sigma), *s.sigma_m))
        mean_tail = float(likelihood[1] @ np.maximum(residual, 0.0) / max(likelihood[1].sum(), 1e-9))
        tail = float(np.clip(mean_tail, *s.tail_m))
        if iteration > 8 and np.abs(step).max() < 1e-5:
            break
    covariance = np.asarray(np.linalg.inv(information + np.diag(prior_information) + 1e-9 * np.eye(6)), np.float64)
    return AxisFit(
        parameters=p, height_m=height_m, sigma_m=sigma, covariance=covariance, core=core, residuals_m=residual
    )


def _residuals(points: Floats, p: Floats, height_m: float) -> tuple[Floats, Floats]:
    """Residuals (N,) and their exact derivatives (N, 6): the foot point is stationary along the axis."""
    slope = p[2:4]
    norm2 = 1.0 + float(slope @ slope)
    x, y, z = points[:, 0] - p[0], points[:, 1] - p[1], points[:, 2] - height_m
    foot = (x * slope[0] + y * slope[1] + z) / norm2
    dx, dy, dz = x - foot * slope[0], y - foot * slope[1], z - foot
    distance = np.maximum(np.sqrt(dx**2 + dy**2 + dz**2), 1e-9)
    nx, ny = dx / distance, dy / distance
    jacobian = np.column_stack([-nx, -ny, -nx * foot, -ny * foot, -np.ones(len(foot)), -foot])
    return distance - (p[4] + p[5] * foot), jacobian


def _gauss(residual: Floats, sigma: float) -> Floats:
    return np.asarray(np.exp(-0.5 * (residual / sigma) ** 2) / (np.sqrt(2.0 * np.pi) * sigma))


def _gauss_with_tail(residual: Floats, sigma: float, tail: float) -> Floats:
    """Density of a Gaussian plus an outward exponential of mean ``tail`` (exponentially modified Gaussian)."""
    argument = (sigma / tail - residual / sigma) / np.sqrt(2.0)
    # erfcx overflows for very negative arguments, where the density is the plain exponential.
    body = np.exp(-0.5 * (residual / sigma) ** 2) * erfcx(np.maximum(argument, -20.0)) / (2.0 * tail)
    plain = np.exp(np.minimum(0.5 * (sigma / tail) ** 2 - residual / tail, 0.0)) / tail
    return np.asarray(np.where(argument > -5.0, body, plain))
