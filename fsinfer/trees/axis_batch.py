"""Many leaning cylinders at once: :func:`fsinfer.trees.axis.fit_axis` for a batch of candidates of a circular section.

A fit to a few hundred points spends more time on calling NumPy than on the points. The search for stems fits hundreds
of candidates, most of which turn out to be none; here each call serves all of them. Distances are single precision
about each candidate's start (a micrometre over ten metres), the equations of the steps double. The steps are those of
``fit_axis``, which is the reference (tests/fsinfer/test_axis_batch.py).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fsinfer.trees.axis import Axis, AxisSettings

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Bools = NDArray[np.bool_]
# Candidates in one call: their arrays (some twenty of 600 numbers a candidate) stay in the processor's cache.
_CHUNK = 32


def fit_axes(
    points: Sequence[Floats],
    starts: Floats,
    heights_m: Floats,
    *,
    sigma_m: Floats | None = None,
    settings: AxisSettings | None = None,
) -> list[Axis]:
    """Fit a tapered cylinder to each of K sets of points (N_k, 3) of x, y, height (metres) by EM.

    ``starts`` (K, 6), ``heights_m`` (K,) and ``sigma_m`` (K,) are ``start``, ``height_m`` and ``sigma_m`` of
    :func:`~fsinfer.trees.axis.fit_axis`.
    """
    s = settings or AxisSettings()
    sigma = np.full(len(points), 0.02) if sigma_m is None else sigma_m
    found: list[Axis | None] = [None] * len(points)
    # Sets of like size together, so that little is padded.
    order = np.argsort([len(p) for p in points], kind="stable")
    for first in range(0, len(points), _CHUNK):
        rows = order[first : first + _CHUNK]
        most = max(len(points[k]) for k in rows)
        xyz = np.zeros((3, len(rows), most), dtype=np.float32)
        there = np.zeros((len(rows), most), dtype=bool)
        for row, k in enumerate(rows):
            count = len(points[k])
            xyz[:, row, :count] = (points[k] - [*starts[k, :2], heights_m[k]]).T
            there[row, :count] = True
        at_start = starts[rows].astype(np.float64)
        at_start[:, :2] = 0.0
        parameters, noise = _fit(xyz, there, at_start, sigma[rows], s)
        parameters[:, :2] += starts[rows, :2]
        for row, k in enumerate(rows):
            found[k] = Axis(parameters=parameters[row], height_m=float(heights_m[k]), sigma_m=float(noise[row]))
    return [axis for axis in found if axis is not None]


def _fit(xyz: Singles, there: Bools, starts: Floats, sigmas: Floats, s: AxisSettings) -> tuple[Floats, Floats]:
    """Parameters (K, 6) and noise (K,) for points (3, K, N), of which those in ``there`` (K, N) count."""
    result, noise = starts.astype(np.float64).copy(), sigmas.astype(np.float64).copy()
    alive = np.arange(len(starts))
    p, sigma = result.copy(), noise.copy()
    tail = np.full(len(p), 0.03)
    shares = np.tile([0.8, 0.12, 0.08], (len(p), 1))
    prior_mean = np.zeros(6)
    prior_mean[5] = s.taper_mean
    prior = np.zeros(6)
    prior[2:4], prior[5] = s.lean_std**-2, s.taper_std**-2
    for _ in range(s.iterations):
        residual, jacobian = _residuals(xyz, p)
        inner = np.minimum(s.window_m, np.maximum(p[:, 4], 0.02))
        inside = (residual >= -_column(inner)) & (residual <= np.float32(s.window_m)) & there
        scaled = residual / _column(sigma)
        body = np.exp(np.float32(-0.5) * scaled * scaled)
        outward = _tail(residual, scaled, body, sigma, tail) * _column(shares[:, 1])
        bark = body * _column(shares[:, 0] / (np.sqrt(2.0 * np.pi) * sigma))
        share = inside / (bark + outward + _column(shares[:, 2] / (s.window_m + inner)))
        core = bark * share
        outward *= share
        total = core.sum(axis=1, dtype=np.float64)
        weighted = jacobian * (core / _column(sigma**2))
        # (6, K, N) to one 6 x 6 product a candidate.
        information = np.matmul(weighted.transpose(1, 0, 2), jacobian.transpose(1, 2, 0)).astype(np.float64)
        gradient = np.matmul(weighted.transpose(1, 0, 2), residual[..., None])[..., 0] + prior * (p - prior_mean)
        information += np.diag(prior + 1e-9)
        step = -np.linalg.solve(information, gradient[..., None])[..., 0]
        longest = np.maximum(np.abs(step[:, [0, 1, 4]]).max(axis=1), 1e-12)
        step *= np.minimum(1.0, 0.05 / longest)[:, None]
        away = outward.sum(axis=1, dtype=np.float64)
        seen = inside.sum(axis=1)
        lost = total < 3.0
        # Who has lost the bark stays where it was before this step.
        p = np.where(lost[:, None], p, p + step)
        p[:, 4] = np.where(lost, p[:, 4], np.maximum(p[:, 4], 0.01))
        shares = np.column_stack([total, away, seen - total - away]) + s.prior_points * np.array([0.9, 0.05, 0.05])
        shares /= shares.sum(axis=1, keepdims=True)
        new_sigma = np.sqrt((np.einsum("kn,kn,kn->k", core, residual, residual) + 4.0 * 0.005**2) / (total + 4.0))
        old_sigma, sigma = sigma, np.where(lost, sigma, np.clip(np.maximum(new_sigma, 0.75 * sigma), *s.sigma_m))
        mean_tail = np.einsum("kn,kn->k", outward, np.maximum(residual, np.float32(0.0))) / np.maximum(away, 1e-9)
        tail = np.clip(mean_tail, *s.tail_m)
        result[alive], noise[alive] = p, sigma
        moved = (np.abs(step).max(axis=1) >= s.tolerance) | (np.abs(sigma - old_sigma) >= s.sigma_tolerance * old_sigma)
        going = ~lost & moved
        if not going.any():
            break
        if not going.all():
            alive, p, sigma, tail, shares = alive[going], p[going], sigma[going], tail[going], shares[going]
            xyz, there = xyz[:, going], there[going]
    return result, noise


def _residuals(xyz: Singles, p: Floats) -> tuple[Singles, Singles]:
    """Residuals (K, N) and their derivatives (6, K, N) for points (3, K, N) about the heights of the axes."""
    x, y, z = xyz[0] - _column(p[:, 0]), xyz[1] - _column(p[:, 1]), xyz[2]
    u, v = _column(p[:, 2]), _column(p[:, 3])
    foot = (x * u + y * v + z) / (np.float32(1.0) + u**2 + v**2)
    x -= foot * u
    y -= foot * v
    z = z - foot
    distance = np.maximum(np.sqrt(x * x + y * y + z * z), np.float32(1e-9))
    jacobian = np.empty((6, *foot.shape), dtype=np.float32)
    np.divide(x, -distance, out=jacobian[0])
    np.divide(y, -distance, out=jacobian[1])
    np.multiply(jacobian[0], foot, out=jacobian[2])
    np.multiply(jacobian[1], foot, out=jacobian[3])
    jacobian[4] = -1.0
    np.negative(foot, out=jacobian[5])
    return distance - (_column(p[:, 4]) + _column(p[:, 5]) * foot), jacobian


# Abramowitz & Stegun (1964), 7.1.26: erfc(x) = (a1 t + ... + a5 t^5) exp(-x^2) to 1.5e-7, t = 1 / (1 + p x), x >= 0.
_ERFC_P = np.float32(0.3275911)
_ERFC_A = tuple(np.float32(a) for a in (1.061405429, -1.453152027, 1.421413741, -0.284496736, 0.254829592))


def _tail(residual: Singles, scaled: Singles, body: Singles, sigma: Floats, tail: Floats) -> Singles:
    """Density (K, N) of a Gaussian plus an outward exponential of mean ``tail`` (K,), to 0.004 per metre.

    ``scaled`` are the residuals over ``sigma`` (K,), ``body`` exp(-scaled^2 / 2). With a = (sigma / tail - scaled) /
    sqrt(2) it is body erfcx(a) / (2 tail); for a < 0, where erfcx grows without bound, erfcx(a) = 2 exp(a^2) -
    erfcx(-a), and body exp(a^2) is a plain exponential.
    """
    argument = (_column(sigma / tail) - scaled) * np.float32(np.sqrt(0.5))
    t = np.float32(1.0) / (np.float32(1.0) + _ERFC_P * np.abs(argument))
    value = _ERFC_A[0] * t
    for factor in _ERFC_A[1:]:
        value += factor
        value *= t
    value *= body
    # The background has won long before the exponential of a point far inside would overflow.
    plain = np.exp(np.minimum(_column(0.5 * (sigma / tail) ** 2) - residual / _column(tail), np.float32(80.0)))
    return np.asarray(np.where(argument < 0, np.float32(2.0) * plain - value, value) * _column(0.5 / tail))


def _column(values: Floats) -> Singles:
    """Values (K,) for an array (K, N)."""
    return values.astype(np.float32)[:, None]
