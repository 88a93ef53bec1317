"""Many leaning cylinders at once: :func:`fsinfer.trees.cylinder.axis.fit_axis` for a batch of sets of points.

A fit to a few hundred points spends more time on calling NumPy than on the points. The search for stems fits hundreds
of candidates, most of which turn out to be none; here each call serves all of them. Distances are single precision
about each start (a micrometre over ten metres), the equations of the steps double. The steps are those of
``fit_axis``, which is the reference (tests/fsinfer/trees/cylinder/test_batch.py).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from fsinfer.trees.cylinder.axis import (
    LEAST_CORE,
    LEAST_RADIUS_M,
    LEAST_SHRINK,
    LONGEST_STEP_M,
    RIDGE,
    SIGMA_TOLERANCE,
    START_SHARES,
    START_SIGMA_M,
    START_TAIL_M,
    STEPS,
    TOLERANCE,
    Axis,
    AxisFit,
    AxisSettings,
)
from fsinfer.trees.cylinder.kernels import blocked, column, residual_rows, sums_of_sets, tail_density

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Singles = NDArray[np.float32]
#: Sets and numbers in one call; their arrays, twenty and more, stay in the processor's cache. Source: numerics.
_CHUNK, _NUMBERS = 32, 24_000
#: Where padding lies, out of the window of every fit. Source: numerics.
_FAR_M = np.float32(1e3)


def fit_axes(
    points: Sequence[Floats],
    starts: Floats,
    heights_m: Floats,
    *,
    sigma_m: Floats | None = None,
    steps: int = STEPS,
    tolerance: float = TOLERANCE,
    settings: AxisSettings | None = None,
) -> list[Axis]:
    """Fit a tapered cylinder to each of K sets of points (N_k, 3) of x, y, height (metres) by EM.

    ``starts`` (K, 6), ``heights_m`` (K,) and ``sigma_m`` (K,) are ``start``, ``height_m`` and ``sigma_m`` of
    :func:`~fsinfer.trees.cylinder.axis.fit_axis`. ``steps`` and ``tolerance`` say when a fit has gone far enough.
    """
    s = settings or AxisSettings()
    sigma = np.full(len(points), START_SIGMA_M) if sigma_m is None else sigma_m
    found: dict[int, Axis] = {}
    for rows in _chunks([len(p) for p in points]):
        batch = _Batch(_padded(points, starts, heights_m, rows), starts[rows], sigma[rows], s)
        batch.run(steps, tolerance)
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
    worth: Sequence[Floats] | None = None,
    settings: AxisSettings | None = None,
) -> list[AxisFit]:
    """The same for stems that are not round, with the evidence for each.

    ``order``, ``relative`` and ``worth`` (K arrays (N_k,) each) are those of
    :func:`~fsinfer.trees.cylinder.axis.fit_axis`.
    """
    s = settings or AxisSettings()
    found: dict[int, AxisFit] = {}
    for rows in _chunks([len(p) for p in points]):
        xyz = _padded(points, starts, heights_m, rows)
        ratio, counted = (None if of is None else _in_rows(of, rows, xyz.shape[2]) for of in (relative, worth))
        batch = _Batch(xyz, starts[rows], sigma_m[rows], s, order=order, ratio=ratio, worth=counted)
        batch.run()
        for row, k in enumerate(rows):
            own, word = (np.ones(len(points[k])) if of is None else of[k] for of in (relative, worth))
            found[int(k)] = batch.evidence(row, float(heights_m[k]), own, word)
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
    most = blocked(max(len(points[k]) for k in rows))
    xyz = np.full((3, len(rows), most), _FAR_M)
    for row, k in enumerate(rows):
        for axis, origin in enumerate((starts[k, 0], starts[k, 1], heights_m[k])):
            np.subtract(points[k][:, axis], origin, out=xyz[axis, row, : len(points[k])], casting="same_kind")
    return xyz


def _in_rows(values: Sequence[Floats], rows: Ints, most: int) -> Singles:
    """What the points of the sets ``rows`` have, (K, ``most``), padded with 1."""
    result = np.ones((len(rows), most), dtype=np.float32)
    for row, k in enumerate(rows):
        result[row, : len(values[k])] = values[k]
    return result


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
        worth: Singles | None = None,
    ) -> None:
        self.s, self.xyz, self.worth = settings, xyz, worth
        self.inverse_ratio = None if ratio is None else np.float32(1.0) / ratio
        self.shape_std = np.repeat(settings.shape_std[: order - 1], 2)
        self.origin = starts[:, :2]
        self.parameters = np.column_stack([starts, np.zeros((len(starts), len(self.shape_std)))])
        self.parameters[:, :2] = 0.0
        self.noise = sigmas.astype(np.float64)
        self.last: dict[int, tuple[Singles, Singles, Floats, Floats]] = {}

    def run(self, steps: int = STEPS, tolerance: float = TOLERANCE) -> None:
        """Iterate until all have arrived, or for so many steps."""
        s, xyz, inverse_ratio, worth = self.s, self.xyz, self.inverse_ratio, self.worth
        alive = np.arange(len(self.parameters))
        p, sigma = self.parameters.copy(), self.noise.copy()
        tail = np.full(len(p), START_TAIL_M)
        shares = np.tile(START_SHARES, (len(p), 1))
        unknowns = p.shape[1]
        prior_mean, prior = np.zeros(unknowns), np.zeros(p.shape)
        prior_mean[5] = s.taper_mean
        prior[:, 2:4], prior[:, 5] = s.lean_std**-2, s.taper_std**-2
        prior_shares = np.array(s.prior_points)
        prior_count, prior_sigma = s.prior_noise
        for turn in range(steps):
            rows = residual_rows(xyz, p)
            residual = rows[unknowns]
            precision = column(1.0 / sigma)
            if inverse_ratio is not None:
                precision = precision * inverse_ratio
            scaled = residual * precision
            core, outward, count = _responsibilities(residual, scaled, precision, p[:, 4], tail, shares, s)
            total, away = count[:, 0], count[:, 1]
            weight = core * precision
            weight *= precision
            if worth is not None:
                weight *= worth
            # The equations of the step, and in the next column their right-hand sides.
            sums = sums_of_sets(rows[:unknowns] * weight, rows)
            prior[:, 6:] = (self.shape_std * p[:, 4:5]) ** -2.0
            information = sums[:, :, :unknowns]
            gradient = sums[:, :, unknowns] + prior * (p - prior_mean)
            regularised = information.copy()
            regularised.reshape(len(p), -1)[:, :: unknowns + 1] += prior + RIDGE
            step = np.linalg.solve(regularised, -gradient[..., None])[..., 0]
            length = np.abs(step)
            longest = np.maximum(np.maximum(length[:, :2].max(axis=1), length[:, 4]), 1e-12)
            step *= np.minimum(1.0, LONGEST_STEP_M / longest)[:, None]
            lost = total < LEAST_CORE
            # Who has lost the bark stays where it was before this step.
            step[lost] = 0.0
            p += step
            np.maximum(p[:, 4], LEAST_RADIUS_M, out=p[:, 4], where=~lost)
            shares = count + prior_shares
            shares /= shares.sum(axis=1, keepdims=True)
            squares = np.einsum("kn,kn->k", np.multiply(core, scaled, out=weight), scaled) * sigma**2
            new_sigma = np.sqrt((squares + prior_count * prior_sigma**2) / (total + prior_count))
            new_sigma = np.minimum(np.maximum(np.maximum(new_sigma, LEAST_SHRINK * sigma), s.sigma_m[0]), s.sigma_m[1])
            old_sigma, sigma = sigma, np.where(lost, sigma, new_sigma)
            # Twice the part of the residuals that lies outside, without the slower comparison with 0.
            twice = np.abs(residual)
            twice += residual
            mean_tail = 0.5 * np.einsum("kn,kn->k", outward, twice) / np.maximum(away, 1e-9)
            tail = np.minimum(np.maximum(mean_tail, s.tail_m[0]), s.tail_m[1])
            self.parameters[alive], self.noise[alive] = p, sigma
            moved = np.abs(step).max(axis=1) >= tolerance
            moved |= np.abs(sigma - old_sigma) >= SIGMA_TOLERANCE * old_sigma
            going = ~lost & moved
            if len(self.shape_std):
                for row in np.flatnonzero(~going | (turn + 1 == steps)):
                    self.last[int(alive[row])] = rows[:, row], core[row], information[row], prior[row]
            if not going.any():
                break
            if not going.all():
                alive, p, sigma, tail, shares = alive[going], p[going], sigma[going], tail[going], shares[going]
                xyz, prior = xyz[:, going], prior[going]
                inverse_ratio, worth = (None if of is None else of[going] for of in (inverse_ratio, worth))
        self.parameters[:, :2] += self.origin

    def evidence(self, row: int, height_m: float, relative: Floats, worth: Floats) -> AxisFit:
        """What the fit of one set at ``height_m`` rests on; ``relative`` and ``worth`` (N,) are of its points."""
        rows, core, information, prior = self.last[row]
        count = len(relative)
        covariance = np.asarray(np.linalg.inv(information + np.diag(prior + RIDGE)), np.float64)
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
            worth=worth,
        )


def _responsibilities(
    residual: Singles,
    scaled: Singles,
    precision: Singles,
    radius: Floats,
    tail: Floats,
    shares: Floats,
    s: AxisSettings,
) -> tuple[Singles, Singles, Floats]:
    """Probabilities (K, N) of points to be bark and to be of the tail outward of it, and the sums (K, 3) of all three.

    ``residual`` (K, N) is ``scaled`` over ``precision``, which are one over the noise; ``radius`` and the mean ``tail``
    (K,) in metres, ``shares`` (K, 3) those of bark, tail and background.
    """
    inner = np.minimum(s.window_m, np.maximum(radius, s.window_inside_m))
    off_middle = residual - column(0.5 * (s.window_m - inner))
    np.abs(off_middle, out=off_middle)
    inside = off_middle <= column(0.5 * (s.window_m + inner))
    core = np.multiply(scaled, scaled, out=off_middle)
    core *= np.float32(-0.5)
    np.exp(core, out=core)
    outward = tail_density(scaled, core, column(1.0 / tail) / precision)
    outward *= column(0.5 * shares[:, 1] / tail)
    core *= precision
    core *= column(shares[:, 0] / np.sqrt(2.0 * np.pi))
    background = shares[:, 2] / (s.window_m + inner)
    share = core + outward
    share += column(background)
    np.divide(inside, share, out=share)
    outward *= share
    core *= share
    sums = np.array([core.sum(axis=1), outward.sum(axis=1), share.sum(axis=1)], dtype=np.float64).T
    sums[:, 2] *= background
    return core, outward, sums
