"""Many leaning cylinders at once: :func:`fsinfer.trees.axis.fit_axis` for a batch of sets of points.

A fit to a few hundred points spends more time on calling NumPy than on the points. The search for stems fits hundreds
of candidates, most of which turn out to be none; here each call serves all of them. Distances are single precision
about each start (a micrometre over ten metres), the equations of the steps double. The steps are those of
``fit_axis``, which is the reference (tests/fsinfer/test_axis_batch.py).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from fsinfer.trees.axis import Axis, AxisFit, AxisSettings

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Singles = NDArray[np.float32]
# Sets and numbers in one call: their arrays (some twenty, more with harmonics) stay in the processor's cache.
_CHUNK = 32
_NUMBERS = 24_000
_FAR_M = np.float32(1e3)  # where padding lies: out of the window of every fit


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
    found: dict[int, Axis] = {}
    for rows in _chunks([len(p) for p in points]):
        batch = _Batch(_padded(points, starts, heights_m, rows), starts[rows], sigma[rows], s)
        batch.run()
        for row, k in enumerate(rows):
            found[int(k)] = Axis(
                parameters=batch.parameters[row], height_m=float(heights_m[k]), sigma_m=float(batch.noise[row])
            )
    return [found[k] for k in range(len(points))]


def fit_sections(
    points: Sequence[Floats],
    starts: Floats,
    heights_m: Floats,
    *,
    sigma_m: Floats,
    order: int,
    relative: Sequence[Floats] | None = None,
    settings: AxisSettings | None = None,
) -> list[AxisFit]:
    """The same for stems that are not round, with the evidence for each.

    ``order`` and ``relative`` (K arrays (N_k,)) are those of :func:`~fsinfer.trees.axis.fit_axis`.
    """
    s = settings or AxisSettings()
    found: dict[int, AxisFit] = {}
    for rows in _chunks([len(p) for p in points]):
        xyz = _padded(points, starts, heights_m, rows)
        ratio = None
        if relative is not None:
            ratio = np.ones(xyz.shape[1:], dtype=np.float32)
            for row, k in enumerate(rows):
                ratio[row, : len(relative[k])] = relative[k]
        batch = _Batch(xyz, starts[rows], sigma_m[rows], s, order=order, ratio=ratio)
        batch.run()
        for row, k in enumerate(rows):
            own = np.ones(len(points[k])) if relative is None else relative[k]
            found[int(k)] = batch.evidence(row, float(heights_m[k]), own)
    return [found[k] for k in range(len(points))]


def _chunks(counts: Sequence[int]) -> Iterator[Ints]:
    """Sets of like size together, so that little is padded, and few enough for the cache."""
    order = np.argsort(counts, kind="stable")
    first = 0
    while first < len(order):
        last = first + 1
        while last < min(len(order), first + _CHUNK) and (last + 1 - first) * counts[order[last]] <= _NUMBERS:
            last += 1
        yield order[first:last]
        first = last


def _padded(points: Sequence[Floats], starts: Floats, heights_m: Floats, rows: Ints) -> Singles:
    """Points (3, K, N) of the sets ``rows`` about their starts, padded with far ones."""
    most = max(len(points[k]) for k in rows)
    xyz = np.full((3, len(rows), most), _FAR_M)
    for row, k in enumerate(rows):
        for axis, origin in enumerate((starts[k, 0], starts[k, 1], heights_m[k])):
            np.subtract(points[k][:, axis], origin, out=xyz[axis, row, : len(points[k])], casting="same_kind")
    return xyz


class _Batch:
    """Expectation-maximisation for points (3, K, N) about ``starts`` (K, 6): ``run``, then look at the results.

    ``parameters`` (K, P) and ``noise`` (K,) are those after the last step, the rest is what that step was made of, of
    those with a section of an ``order``.
    """

    def __init__(
        self,
        xyz: Singles,
        starts: Floats,
        sigmas: Floats,
        settings: AxisSettings,
        *,
        order: int = 1,
        ratio: Singles | None = None,
    ) -> None:
        self.s, self.xyz, self.ratio = settings, xyz, ratio
        self.inverse_ratio = None if ratio is None else np.float32(1.0) / ratio
        self.shape_std = np.repeat(settings.shape_std[: order - 1], 2)
        self.origin = starts[:, :2]
        self.parameters = np.column_stack([starts, np.zeros((len(starts), len(self.shape_std)))])
        self.parameters[:, :2] = 0.0
        self.noise = sigmas.astype(np.float64)
        self.last: dict[int, tuple[Singles, Singles, Floats, Floats]] = {}

    def run(self) -> None:
        """Iterate until all have arrived."""
        s, xyz = self.s, self.xyz
        inverse_ratio = self.inverse_ratio
        alive = np.arange(len(self.parameters))
        p, sigma = self.parameters.copy(), self.noise.copy()
        tail = np.full(len(p), 0.03)
        shares = np.tile([0.8, 0.12, 0.08], (len(p), 1))
        prior_mean, prior = np.zeros(p.shape[1]), np.zeros(p.shape)
        prior_mean[5] = s.taper_mean
        prior[:, 2:4], prior[:, 5] = s.lean_std**-2, s.taper_std**-2
        for turn in range(s.iterations):
            rows = _residuals(xyz, p)
            jacobian, residual = rows[: p.shape[1]], rows[p.shape[1]]
            inner = np.minimum(s.window_m, np.maximum(p[:, 4], 0.02))
            inside = np.abs(residual - _column(0.5 * (s.window_m - inner))) <= _column(0.5 * (s.window_m + inner))
            precision = _column(1.0 / sigma)
            if inverse_ratio is not None:
                precision = precision * inverse_ratio
            scaled = residual * precision
            body = scaled * scaled
            body *= np.float32(-0.5)
            np.exp(body, out=body)
            outward = _tail(scaled, body, _column(1.0 / tail) / precision)
            outward *= _column(0.5 * shares[:, 1] / tail)
            body *= precision
            body *= _column(shares[:, 0] / np.sqrt(2.0 * np.pi))
            share = body + outward
            share += _column(shares[:, 2] / (s.window_m + inner))
            np.divide(inside, share, out=share)
            outward *= share
            core = np.multiply(body, share, out=body)
            total = core.sum(axis=1).astype(np.float64)
            weight = np.multiply(core, precision, out=share)
            weight *= precision
            # (P, K, N) to one product a set: the equations of the step, and in the next column their right-hand sides.
            weighted = jacobian * weight
            sums = np.matmul(weighted.transpose(1, 0, 2), rows.transpose(1, 2, 0)).astype(np.float64)
            prior[:, 6:] = (self.shape_std * p[:, 4:5]) ** -2.0
            information = sums[:, :, : p.shape[1]]
            gradient = sums[:, :, p.shape[1]] + prior * (p - prior_mean)
            regularised = information + (prior + 1e-9)[:, :, None] * np.eye(p.shape[1])
            step = -np.linalg.solve(regularised, gradient[..., None])[..., 0]
            longest = np.maximum(np.abs(step[:, [0, 1, 4]]).max(axis=1), 1e-12)
            step *= np.minimum(1.0, 0.05 / longest)[:, None]
            away = outward.sum(axis=1).astype(np.float64)
            seen = np.count_nonzero(inside, axis=1)
            lost = total < 3.0
            # Who has lost the bark stays where it was before this step.
            p = np.where(lost[:, None], p, p + step)
            p[:, 4] = np.where(lost, p[:, 4], np.maximum(p[:, 4], 0.01))
            shares = np.column_stack([total, away, seen - total - away]) + s.prior_points * np.array([0.9, 0.05, 0.05])
            shares /= shares.sum(axis=1, keepdims=True)
            squares = np.einsum("kn,kn,kn->k", core, scaled, scaled) * sigma**2
            new_sigma = np.sqrt((squares + 4.0 * 0.005**2) / (total + 4.0))
            old_sigma, sigma = sigma, np.where(lost, sigma, np.clip(np.maximum(new_sigma, 0.75 * sigma), *s.sigma_m))
            mean_tail = np.einsum("kn,kn->k", outward, np.maximum(residual, np.float32(0.0))) / np.maximum(away, 1e-9)
            tail = np.clip(mean_tail, *s.tail_m)
            self.parameters[alive], self.noise[alive] = p, sigma
            moved = np.abs(step).max(axis=1) >= s.tolerance
            moved |= np.abs(sigma - old_sigma) >= s.sigma_tolerance * old_sigma
            going = ~lost & moved
            if len(self.shape_std):
                for row in np.flatnonzero(~going | (turn + 1 == s.iterations)):
                    self.last[int(alive[row])] = rows[:, row], core[row], information[row], prior[row]
            if not going.any():
                break
            if not going.all():
                alive, p, sigma, tail, shares = alive[going], p[going], sigma[going], tail[going], shares[going]
                xyz, prior = xyz[:, going], prior[going]
                inverse_ratio = None if inverse_ratio is None else inverse_ratio[going]
        self.parameters[:, :2] += self.origin

    def evidence(self, row: int, height_m: float, relative: Floats) -> AxisFit:
        """What the fit of one set at ``height_m`` rests on; ``relative`` (N,) is its points' noise."""
        rows, core, information, prior = self.last[row]
        count = len(relative)
        covariance = np.asarray(np.linalg.inv(information + np.diag(prior + 1e-9)), np.float64)
        return AxisFit(
            parameters=self.parameters[row, :6],
            height_m=height_m,
            sigma_m=float(self.noise[row]),
            covariance=covariance,
            core=core[:count].astype(np.float64),
            residuals_m=rows[len(prior), :count].astype(np.float64),
            jacobian=rows[: len(prior), :count].astype(np.float64).T,
            prior_information=prior,
            shape_m=self.parameters[row, 6:],
            noise_m=self.noise[row] * relative,
        )


def _residuals(xyz: Singles, p: Floats) -> Singles:
    """Derivatives of the residuals, the residuals, and rows of zeros, for points (3, K, N) and parameters (K, P).

    Together (Q, K, N) with Q a multiple of eight above P, of which BLAS makes products twice as fast as of others.
    Points are about the heights of the axes.
    """
    x, y, z = xyz[0] - _column(p[:, 0]), xyz[1] - _column(p[:, 1]), xyz[2]
    u, v = _column(p[:, 2]), _column(p[:, 3])
    foot, other = x * u, y * v
    foot += other
    foot += z
    foot *= _column(1.0 / (1.0 + p[:, 2] ** 2 + p[:, 3] ** 2))
    x -= np.multiply(foot, u, out=other)
    y -= np.multiply(foot, v, out=other)
    rows = np.empty(((p.shape[1] // 8 + 1) * 8, *foot.shape), dtype=np.float32)
    rows[p.shape[1] + 1 :] = 0.0
    residual = np.multiply(x, x, out=rows[p.shape[1]])
    residual += np.multiply(y, y, out=other)
    np.subtract(z, foot, out=other)
    other *= other
    residual += other
    np.maximum(residual, np.float32(1e-18), out=residual)
    np.sqrt(residual, out=residual)
    np.divide(np.float32(-1.0), residual, out=other)
    cosine, sine = np.multiply(x, other, out=rows[0]), np.multiply(y, other, out=rows[1])
    np.multiply(cosine, foot, out=rows[2])
    np.multiply(sine, foot, out=rows[3])
    rows[4] = -1.0
    np.negative(foot, out=rows[5])
    residual -= np.multiply(foot, _column(p[:, 5]), out=other)
    residual -= _column(p[:, 4])
    # -cos ka and -sin ka from those of k - 1.
    c, s = cosine, sine
    for column in range(6, p.shape[1], 2):
        np.multiply(s, sine, out=rows[column])
        rows[column] -= np.multiply(c, cosine, out=other)
        np.multiply(c, sine, out=rows[column + 1])
        rows[column + 1] += np.multiply(s, cosine, out=other)
        np.negative(rows[column + 1], out=rows[column + 1])
        c, s = rows[column], rows[column + 1]
        residual += np.multiply(c, _column(p[:, column]), out=other)
        residual += np.multiply(s, _column(p[:, column + 1]), out=other)
    return rows


# Abramowitz & Stegun (1964), 7.1.26: erfc(x) = (a1 t + ... + a5 t^5) exp(-x^2) to 1.5e-7, t = 1 / (1 + p x), x >= 0.
_ERFC_P = np.float32(0.3275911 * np.sqrt(0.5))
_ERFC_A = tuple(np.float32(a) for a in (1.061405429, -1.453152027, 1.421413741, -0.284496736, 0.254829592))


def _tail(scaled: Singles, body: Singles, ratio: Singles) -> Singles:
    """Density (K, N) of a Gaussian plus an outward exponential, times twice the latter's mean, to 2e-6.

    ``scaled`` are the residuals over sigma, ``body`` exp(-scaled^2 / 2), ``ratio`` (K, 1) or (K, N) sigma over the
    exponential's mean. With a = (ratio - scaled) / sqrt(2) it is body erfcx(a); for a < 0, where erfcx grows without
    bound, erfcx(a) = 2 exp(a^2) - erfcx(-a), and body exp(a^2) is a plain exponential.
    """
    argument = ratio - scaled
    t = np.abs(argument)
    t *= _ERFC_P
    t += np.float32(1.0)
    np.divide(np.float32(1.0), t, out=t)
    value = _ERFC_A[0] * t
    for factor in _ERFC_A[1:]:
        value += factor
        value *= t
    value *= body
    # The background has won long before the exponential of a point far inside would overflow.
    plain = np.float32(0.5) * ratio - scaled
    plain *= ratio
    np.minimum(plain, np.float32(80.0), out=plain)
    np.exp(plain, out=plain)
    plain *= np.float32(2.0)
    plain -= value
    return np.where(argument < 0, plain, value)


def _column(values: Floats) -> Singles:
    """Values (K,) for an array (K, N)."""
    return values.astype(np.float32)[:, None]
