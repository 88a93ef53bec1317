"""A stem as a leaning, tapering cylinder: point-to-line distances and a robust fit that expects an outward tail.

The residual of a point is its distance from the axis minus the radius at its foot point. Residuals are explained by a
mixture: a Gaussian core (bark), an exponential tail outward of it (edge fattening, moss, flying points stand outside a
stem far more often than inside) and a uniform background. Expectation-maximisation weights each point by its
probability of belonging to the core, so that the tail does not pull the radius; the M-step is Gauss-Newton.

Stems are not round: with ``order`` >= 2 the radius gets harmonics over the angle, each with a prior. Where the stem is
seen all round they are measured; where half of it is hidden the prior says how far they may pull the radius, and the
covariance carries that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfcx

from fsinfer.trees.points.sums import sums_of_products, weighted_sum

Floats = NDArray[np.float64]


#: Steps of a fit, at most, and the last one, in metres or metres per metre, where the noise has settled too.
#: Source: numerics.
STEPS, TOLERANCE, SIGMA_TOLERANCE = 40, 1e-5, 0.01
#: Where the mixture starts: noise, mean length of the tail, and shares of bark, tail and background. Source: numerics.
START_SIGMA_M, START_TAIL_M, START_SHARES = 0.02, 0.03, (0.8, 0.12, 0.08)
#: Longest step in metres, and what the noise may shrink to in one: the start is deliberately wide, and with longer
#: steps a wrong arc captures the fit. Source: numerics.
LONGEST_STEP_M, LEAST_SHRINK = 0.05, 0.75
#: A fit that has less bark than a circle needs has lost it; no radius is smaller. Source: numerics.
LEAST_CORE, LEAST_RADIUS_M = 3.0, 0.01
#: Keeps the equations solvable. Source: numerics.
RIDGE = 1e-9
#: An axis rises from the ground below it by this share of its own rise at least. Source: judgement; a stem that leans
#: by 45 degrees with a slope of 40 has 0.16.
LEAST_RISE = 0.1
#: A fit to points near a known stem starts with so many times its noise, and at least so many metres. Source: numerics.
WIDER_START = (1.5, 0.006)


@dataclass(frozen=True, kw_only=True)
class AxisSettings:
    """Constants of :func:`fit_axis`.

    Attributes
    ----------
    sigma_m: least and greatest noise: best laser scans; beyond 3 cm no bark is left to see. Source: not recorded.
    window_m: residuals beyond this are not looked at. Source: chosen on simulated stems.
    window_inside_m: they are, inside, down to the axis, but at least so far. Source: the thinnest stem looked for.
    tail_m: least and greatest mean length of the outward tail. Source: chosen on simulated stems.
    taper_mean: change of the radius per metre of height about breast height. Source: forestry practice, the diameter
        loses 1 cm a metre.
    taper_std: standard deviation of it between stems. Source: forestry practice, from a cylinder to butt swell.
    lean_std: standard deviation of the tangent of the lean, 6 degrees. Source: not recorded.
    shape_std: standard deviation of each coefficient of the 2nd, 3rd and 4th harmonic, part of the radius.
        Source: forestry practice, least against greatest diameter 0.92-0.98; less and less triangular and square.
    prior_points: points that bark, tail and background count before any is seen: a fit of 20 points should not invent
        a tail. Source: chosen on simulated stems.
    prior_noise: points, and their noise in metres, that count before any are seen. Source: chosen on simulated stems.
    """

    sigma_m: tuple[float, float] = (0.0015, 0.03)
    window_m: float = 0.12
    window_inside_m: float = 0.02
    tail_m: tuple[float, float] = (0.01, 0.06)
    taper_mean: float = -0.006
    taper_std: float = 0.008
    lean_std: float = 0.10
    shape_std: tuple[float, ...] = (0.016, 0.008, 0.004)
    prior_points: tuple[float, float, float] = (18.0, 1.0, 1.0)
    prior_noise: tuple[float, float] = (4.0, 0.005)

    @property
    def order(self) -> int:
        """Highest harmonic of a section that has a prior."""
        return 1 + len(self.shape_std)


@dataclass(frozen=True, kw_only=True)
class Axis:
    """Parameters (6,): x, y at ``height_m``, slopes dx/dh, dy/dh, radius, taper dr/dh; and the noise found."""

    parameters: Floats
    height_m: float
    sigma_m: float

    @property
    def radius_m(self) -> float:
        """Radius at ``height_m``."""
        return float(self.parameters[4])

    @property
    def lean_deg(self) -> float:
        """Angle between the axis and the vertical."""
        return float(np.degrees(np.arctan(np.hypot(self.parameters[2], self.parameters[3]))))

    def radius_at(self, height_m: float) -> float:
        """Radius at ``height_m`` by the taper."""
        return float(self.radius_m + self.parameters[5] * (height_m - self.height_m))

    def center_at(self, height_m: float) -> Floats:
        """Axis position (2,) where it passes ``height_m``."""
        return np.asarray(self.parameters[:2] + self.parameters[2:4] * (height_m - self.height_m))


@dataclass(frozen=True, kw_only=True)
class AxisFit(Axis):
    """An axis with the evidence for it.

    ``shape_m`` (2 K,) are the cosine and sine coefficients of the harmonics 2, 3, ... of the radius, in metres.
    ``jacobian`` (N, 6 + 2 K) are the residuals' derivatives and ``prior_information`` (6 + 2 K,) the diagonal of the
    prior's; ``covariance`` (6 + 2 K, 6 + 2 K) assumes independent residuals. ``core`` (N,) is each point's probability
    of being bark, ``noise_m`` (N,) its standard deviation and ``worth`` (N,) what its word counts beside that.
    """

    covariance: Floats
    core: Floats
    residuals_m: Floats
    jacobian: Floats
    prior_information: Floats
    shape_m: Floats
    noise_m: Floats
    worth: Floats


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


def above_ground(axis: Axis, xy: Floats, gradient: Floats) -> Axis | None:
    """An axis whose heights count from the level of the ground at ``xy`` (2,), with heights above the ground itself.

    That slopes by ``gradient`` (2,), dz/dx and dz/dy, and z = z' + gradient (x - xy) turns the line x = p + l (z - h)
    into another, of the slope l / (1 - gradient l). Radius and noise are those of the place. None where the axis lies
    nearly in the ground.
    """
    slope = axis.parameters[2:4]
    rise = 1.0 - float(gradient @ slope)
    if rise < LEAST_RISE:
        return None
    up = float(gradient @ (axis.parameters[:2] - xy)) / rise
    place, taper = axis.parameters[:2] + up * slope, axis.parameters[5]
    parameters = np.array([*place, *(slope / rise), axis.radius_m + taper * up, taper / rise])
    return Axis(parameters=parameters, height_m=axis.height_m, sigma_m=axis.sigma_m)


def above_level(axis: Axis, height_m: float, gradient: Floats) -> Axis:
    """The other way: an axis of heights above sloping ground, which passes ``height_m`` above a level where it passes
    its own height."""
    rise = 1.0 + float(gradient @ axis.parameters[2:4])
    parameters = axis.parameters.copy()
    parameters[2:4] /= rise
    parameters[5] /= rise
    return Axis(parameters=parameters, height_m=height_m, sigma_m=axis.sigma_m)


def wider(sigma_m: float) -> float:
    """The noise to start a fit with where a stem of that noise is known nearby."""
    times, least = WIDER_START
    return max(times * sigma_m, least)


def fit_axis(
    points: Floats,
    start: Floats,
    height_m: float,
    *,
    sigma_m: float = START_SIGMA_M,
    order: int = 1,
    relative: Floats | None = None,
    worth: Floats | None = None,
    steps: int = STEPS,
    settings: AxisSettings | None = None,
) -> AxisFit:
    """Fit a tapered cylinder to points (N, 3) of x, y, height (metres) from ``start`` (6,) by EM.

    ``relative`` (N,) is each point's noise in units of the stem's (1 without it): hazy sides of a stem count less.
    ``worth`` (N,), at most 1, is what a point's word counts for the parameters, where those beside it err with it (1
    without it): what it may lie off by, and whether it is bark, stays as it is.
    ``order`` is the highest harmonic of its section: 1 for a circle, up to ``settings.order``.
    """
    s = settings or AxisSettings()
    shape_std = np.repeat(s.shape_std[: order - 1], 2)
    p = np.concatenate([start.astype(np.float64), np.zeros(len(shape_std))])
    prior_mean = np.zeros(len(p))
    prior_mean[5] = s.taper_mean
    prior_information = np.zeros(len(p))
    prior_information[2:4], prior_information[5] = s.lean_std**-2, s.taper_std**-2
    tiny = RIDGE * np.eye(len(p))
    sigma, tail, shares = sigma_m, START_TAIL_M, np.array(START_SHARES)
    prior_count, prior_sigma = s.prior_noise
    ratio = np.ones(len(points)) if relative is None else relative
    counted = np.ones(len(points)) if worth is None else worth
    core = np.zeros(len(points))
    residual = np.zeros(len(points))
    jacobian = np.zeros((len(p), len(points)))
    information = np.eye(len(p))
    columns = np.ascontiguousarray(points.T) - np.array([[0.0], [0.0], [height_m]])
    for _ in range(steps):
        residual, jacobian = _residuals(columns, p)
        inner = min(s.window_m, max(p[4], s.window_inside_m))
        inside = (residual >= -inner) & (residual <= s.window_m)
        gauss, with_tail = _densities(residual, sigma * ratio, tail)
        bark, outward = shares[0] * gauss, shares[1] * with_tail
        share = inside / np.maximum(bark + outward + shares[2] / (s.window_m + inner), 1e-300)
        core, outward = bark * share, outward * share
        total = float(core.sum())
        if total < LEAST_CORE:
            break
        weighted = jacobian * (core * counted / (sigma * ratio) ** 2)
        information = sums_of_products(weighted, jacobian)
        prior_information[6:] = (shape_std * p[4]) ** -2.0
        regularised = information + np.diag(prior_information) + tiny
        gradient = sums_of_products(weighted, residual) + prior_information * (p - prior_mean)
        step = -np.linalg.solve(regularised, gradient)
        step *= min(1.0, LONGEST_STEP_M / max(abs(step[0]), abs(step[1]), abs(step[4]), 1e-12))
        p = p + step
        p[4] = max(p[4], LEAST_RADIUS_M)
        away = float(outward.sum())
        shares = np.array([total, away, float(inside.sum()) - total - away])
        shares += np.array(s.prior_points)
        shares /= shares.sum()
        squares = core @ (residual / ratio) ** 2 + prior_count * prior_sigma**2
        new_sigma = float(np.sqrt(squares / (total + prior_count)))
        old_sigma, sigma = sigma, float(np.clip(max(new_sigma, LEAST_SHRINK * sigma), *s.sigma_m))
        mean_tail = float(outward @ np.maximum(residual, 0.0)) / max(away, 1e-9)
        tail = float(np.clip(mean_tail, *s.tail_m))
        if np.abs(step).max() < TOLERANCE and abs(sigma - old_sigma) < SIGMA_TOLERANCE * old_sigma:
            break
    return AxisFit(
        parameters=p[:6],
        height_m=height_m,
        sigma_m=sigma,
        covariance=np.asarray(np.linalg.inv(information + np.diag(prior_information) + tiny), np.float64),
        core=core,
        residuals_m=residual,
        jacobian=jacobian.T,
        prior_information=prior_information,
        shape_m=p[6:],
        noise_m=sigma * ratio,
        worth=counted,
    )


def _residuals(columns: Floats, p: Floats) -> tuple[Floats, Floats]:
    """Residuals (N,) and their exact derivatives (P, N): the foot point is stationary along the axis.

    ``columns`` (3, N) are x, y and the height over that of the axis.
    """
    slope = p[2:4]
    norm2 = 1.0 + float(slope @ slope)
    x, y, z = columns[0] - p[0], columns[1] - p[1], columns[2]
    foot = (x * slope[0] + y * slope[1] + z) / norm2
    dx, dy, dz = x - foot * slope[0], y - foot * slope[1], z - foot
    distance = np.maximum(np.sqrt(dx**2 + dy**2 + dz**2), 1e-9)
    nx, ny = dx / distance, dy / distance
    jacobian = np.empty((len(p), len(foot)))
    jacobian[0], jacobian[1] = -nx, -ny
    jacobian[2], jacobian[3] = -nx * foot, -ny * foot
    jacobian[4], jacobian[5] = -1.0, -foot
    residual = distance - (p[4] + p[5] * foot)
    if len(p) > 6:
        # The harmonics' own change with the centre is of second order and left out of the derivatives.
        jacobian[6:] = -harmonics(nx, ny, len(p) - 6).T
        residual += weighted_sum(p[6:], jacobian[6:])
    return residual, jacobian


def harmonics(cosine: Floats, sine: Floats, columns: int) -> Floats:
    """cos 2a, sin 2a, cos 3a, sin 3a, ... (N, ``columns``) from cos a and sin a (N,)."""
    result = np.empty((columns, len(cosine)))
    c, s = cosine, sine
    for column in range(0, columns, 2):
        c, s = c * cosine - s * sine, c * sine + s * cosine
        result[column], result[column + 1] = c, s
    return result.T


def _densities(residual: Floats, sigma: Floats, tail: float) -> tuple[Floats, Floats]:
    """Densities (N,) of a Gaussian, and of one plus an outward exponential of mean ``tail``; ``sigma`` (N,)."""
    scaled = residual / sigma
    body = np.exp(-0.5 * scaled**2)
    argument = (sigma / tail - scaled) / np.sqrt(2.0)
    # erfcx overflows for very negative arguments, where the density is the plain exponential.
    with_tail = body * erfcx(np.maximum(argument, -5.0)) / (2.0 * tail)
    far = argument <= -5.0
    if far.any():
        with_tail[far] = np.exp(0.5 * (sigma[far] / tail) ** 2 - residual[far] / tail) / tail
    return body / (np.sqrt(2.0 * np.pi) * sigma), with_tail
