"""Circles through points: algebraic start, geometric least squares, residual dropping, random subsamples fused.

The algebraic start is Taubin's fit (G. Taubin, IEEE PAMI 13, 1991): minimise ``sum (A z + B x + C y + D)^2`` with
``z = x^2 + y^2`` under Taubin's normalisation; with centred coordinates that is the smallest eigenvector of a 3x3
matrix, so that hundreds of subsamples are fitted in one call. The geometric fit is Gauss-Newton on
``|p - centre| - radius``. The rest follows FS-MVSNet (Forests 2025, 16, 927): drop residuals above 1.5 cm, refit,
repeat, and fuse the fits of many random subsamples weighted by support and residual.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fsinfer.errors import CloudError
from fsinfer.trees.points.sums import MAD_TO_SIGMA, median, sums_of_products
from fsinfer.trees.points.surface import SECTORS, STRAY_SHARE, WALL_SIGMAS, WELL_SEEN_PERCENTILE, sector_of

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
#: Steps of a geometric fit, at most, and its last one as a part of the radius, or of a metre. Source: numerics.
STEPS, STEP_TOLERANCE = 30, 1e-10
#: Random triples; a circle with 40 % outliers is found with probability 1 - (1 - 0.6^3)^200 > 1 - 1e-20.
#: Source: numerics.
TRIPLES = 200
#: Points by which starts are compared; the share of points near a circle is known to 2 %. Source: numerics.
START_POINTS = 500
#: Rounds of dropping and fitting again. Source: numerics.
DROP_ROUNDS = 25
#: Fused random subsamples, of at most so many points, each in so many steps; the spread of the mean is stable to 10
#: % from about 60, and more points do not move the mean. Source: numerics.
SUBSAMPLES, MOST_OF_SUBSAMPLE, SUBSAMPLE_STEPS = 96, 400, 3
#: Points of a subsample, at least; those whose mean square is so many times the median one are not fused; and what
#: keeps the weights of the others finite, of the support and of the drop limit's square. Source: numerics.
LEAST_OF_SUBSAMPLE, RUNAWAY, LEAST_SUPPORT, LEAST_SQUARE = 8, 4.0, 1e-3, 1e-4
#: Delete-half jackknife; the spread of half samples estimates the standard error. Source: numerics, mathematics.
SUBSAMPLE_SHARE = 0.5
#: Guards against collinear points, metres. Source: numerics.
MOST_RADIUS_M = 1e6
#: Damping of a geometric fit with which it gives up. Source: numerics.
MOST_DAMPING = 1e3
#: Least number of points for a circle in a noisy slice. Source: four times the circle's parameters.
LEAST_POINTS = 12
#: Points a sector on average, or sectors get wider. Source: statistics, one in 400 stays empty by chance.
POINTS_A_SECTOR = 6


@dataclass(frozen=True, kw_only=True)
class CircleSettings:
    """Constants of :func:`fit_circle`.

    Attributes
    ----------
    drop_residual_m: points farther from the circle are dropped; in a noisy cloud those beyond ``WALL_SIGMAS`` standard
        deviations. Source: Forests 2025, 16, 927, "residuals > 1.5 cm are dropped".
    """

    drop_residual_m: float = 0.015


@dataclass(frozen=True, kw_only=True)
class CircleFit:
    """A circle and how well the points support it.

    ``center`` (2,) and ``radius`` are in the unit of the points (metres). ``inliers`` (N,) bool marks the points that
    were kept; ``residual_rms`` is over those. ``arc_coverage`` in [0, 1] is the share of the circumference that the
    kept points see. ``radius_std`` is the standard error of the radius from the spread of the subsamples.
    """

    center: Floats
    radius: float
    residual_rms: float
    inliers: Bools
    arc_coverage: float
    radius_std: float


def fit_circle(points_xy: ArrayLike, *, settings: CircleSettings | None = None, seed: int = 0) -> CircleFit:
    """Fit a circle to points (N, 2) in metres, robustly and deterministically.

    Raises :class:`~fsinfer.errors.CloudError` for fewer than three finite points or points on one line.
    """
    settings = settings or CircleSettings()
    points = np.asarray(points_xy, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 2:
        msg = f"fit_circle needs points of shape (N, 2), got {points.shape=}"
        raise CloudError(msg)
    finite = np.isfinite(points).all(axis=1)
    if finite.sum() < 3:
        msg = f"a circle needs at least 3 finite points, got {int(finite.sum())}; widen the slice"
        raise CloudError(msg)
    origin = points[finite].mean(axis=0)
    local = points[finite] - origin
    rng = np.random.default_rng(seed)
    circle = _start(local, settings, rng)
    residuals = residuals_to(local, circle)
    kept = np.abs(residuals) <= _drop_limit(residuals, settings)
    for _ in range(DROP_ROUNDS):
        circle = fit_geometric(local[kept], circle)
        residuals = residuals_to(local, circle)
        limit = _drop_limit(residuals, settings)
        now = np.abs(residuals) <= limit
        # Three and more are always within: the limit is above the median, of four points above the third.
        if np.array_equal(now, kept):
            break
        kept = now
    fused, radius_std = _fuse_subsamples(local[kept], circle, settings, rng)
    residuals = residuals_to(local, fused)
    inliers = np.zeros(len(points), dtype=bool)
    inliers[np.flatnonzero(finite)[kept]] = True
    rms = float(np.sqrt(np.mean(residuals[kept] ** 2)))
    return CircleFit(
        center=fused[:2] + origin,
        radius=float(fused[2]),
        residual_rms=rms,
        inliers=inliers,
        arc_coverage=arc_coverage(local[kept] - fused[:2]),
        radius_std=radius_std,
    )


def fit_taubin(points: Floats, weights: Floats | None = None) -> Floats:
    """Taubin's algebraic circle for a batch: points (..., N, 2), weights (..., N) -> (..., 3) as x, y, radius."""
    weights = np.ones(points.shape[:-1]) if weights is None else weights
    total = np.maximum(weights.sum(axis=-1, keepdims=True), 1e-300)
    share = (weights / total)[..., None]
    mean = (share * points).sum(axis=-2, keepdims=True)
    centred = points - mean
    squared = (centred**2).sum(axis=-1, keepdims=True)
    mean_squared = np.maximum((share * squared).sum(axis=-2, keepdims=True), 1e-300)
    design = np.concatenate([(squared - mean_squared) / (2.0 * np.sqrt(mean_squared)), centred], axis=-1)
    matrix = np.swapaxes(design, -1, -2) @ (design * share)
    vector = np.linalg.eigh(matrix)[1][..., 0]
    a = vector[..., 0] / (2.0 * np.sqrt(mean_squared[..., 0, 0]))
    a = np.where(np.abs(a) < 1e-12, 1e-12, a)
    center = -vector[..., 1:] / (2.0 * a[..., None])
    radius = np.sqrt(np.maximum((center**2).sum(axis=-1) + mean_squared[..., 0, 0], 0.0))
    return np.concatenate([center + mean[..., 0, :], radius[..., None]], axis=-1)


def fit_geometric(points: Floats, start: Floats, weights: Floats | None = None) -> Floats:
    """Weighted geometric least squares from ``start`` (x, y, radius): damped Gauss-Newton, points (N, 2) -> (3,).

    The start is an algebraic fit's or better: from outside of the circle the descent may end at a straight line
    (N. Chernov, Circular and Linear Regression, 2010, section 3.8: the cost has valleys to infinity).
    """
    columns = np.ascontiguousarray(points.T)
    circle = start.astype(np.float64).copy()
    damping = 1e-9
    sums = _sums_about(columns, circle, weights)
    for _ in range(STEPS):
        normal = sums[:3, :3]
        step = -np.linalg.solve(normal + damping * np.trace(normal) * np.eye(3) + 1e-300 * np.eye(3), sums[:3, 3])
        trial = circle + step
        at_trial = _sums_about(columns, trial, weights)
        if at_trial[3, 3] <= sums[3, 3]:
            circle, sums, damping = trial, at_trial, max(damping * 0.1, 1e-15)
            if np.abs(step).max() <= STEP_TOLERANCE * max(1.0, circle[2]):
                break
        else:
            damping = max(damping * 10.0, 1e-9)
            if damping > MOST_DAMPING:
                break
    circle[2] = abs(circle[2])
    return circle


def _sums_about(columns: Floats, circle: Floats, weights: Floats | None) -> Floats:
    """Weighted sums (4, 4) of the products of the derivatives of the residuals and, last, the residuals themselves.

    ``columns`` (2, N) are the points' x and y.
    """
    rows = np.empty((4, columns.shape[1]))
    x, y = np.subtract(columns[0], circle[0], out=rows[0]), np.subtract(columns[1], circle[1], out=rows[1])
    distance = np.maximum(np.sqrt(x * x + y * y), 1e-12)
    rows[:2] /= -distance
    rows[2] = -1.0
    np.subtract(distance, circle[2], out=rows[3])
    return sums_of_products(rows, rows if weights is None else rows * weights)


def residuals_to(points: Floats, circle: Floats) -> Floats:
    """Signed distance of points (..., 2) from the circle (x, y, radius): positive outside."""
    x, y = points[..., 0] - circle[..., 0], points[..., 1] - circle[..., 1]
    # Not np.hypot, which guards against overflow at four times the cost.
    return np.asarray(np.sqrt(x * x + y * y) - circle[..., 2])


def arc_coverage(offsets: Floats, *, bins: int = 2 * SECTORS[1]) -> float:
    """Share of the circumference seen by ``offsets`` (N, 2) from the centre.

    With few points the bins widen so that a full circle still counts as 1: six points a bin on average, of which one
    in 400 stays empty by chance. A bin counts when it holds a tenth of what a typical seen bin holds, so that strays
    do not close an arc.
    """
    return float(covered_bins(offsets, bins=bins).mean())


def covered_bins(offsets: Floats, *, bins: int = 2 * SECTORS[1], weights: Floats | None = None) -> Bools:
    """Which equal sectors of the circle hold points, as (B,) bool with B <= ``bins``; sector 0 starts at angle -pi.

    ``weights`` (N,) are what the points count, each 1 without them; then what a bin typically holds is that of those
    that are seen best, for most of them may be seen badly.
    """
    if len(offsets) == 0:
        return np.zeros(1, dtype=bool)
    bins = int(np.clip(len(offsets) // POINTS_A_SECTOR, SECTORS[0], bins))
    count = np.bincount(sector_of(offsets, bins), weights=weights, minlength=bins)
    typical = float(np.percentile(count[count > 0], 50.0 if weights is None else WELL_SEEN_PERCENTILE))
    return np.asarray((count > 0) & (count >= STRAY_SHARE * typical))


def _drop_limit(residuals: Floats, settings: CircleSettings) -> float:
    sigma = MAD_TO_SIGMA * median(np.abs(residuals))
    return max(settings.drop_residual_m, WALL_SIGMAS * sigma)


def _start(points: Floats, settings: CircleSettings, rng: np.random.Generator) -> Floats:
    """Best of Taubin's circle and of circles through random triples, by points within the drop limit."""
    index = rng.integers(0, len(points), size=(TRIPLES, 3))
    circles = np.concatenate([fit_taubin(points)[None], fit_taubin(points[index])])
    good = np.isfinite(circles).all(axis=1) & (circles[:, 2] < MOST_RADIUS_M) & (circles[:, 2] > 0)
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if not good.any() or spread[1] <= 1e-9 * max(spread[0], 1e-300):
        msg = "the points lie on one line (or in one place): no circle goes through them; widen the slice"
        raise CloudError(msg)
    circles = circles[good]
    most = START_POINTS
    sample = points if len(points) <= most else points[rng.choice(len(points), most, replace=False)]
    residuals = residuals_to(sample[None], circles[:, None, :])
    near = np.minimum((residuals / settings.drop_residual_m) ** 2, 1.0)
    return np.asarray(circles[int(np.argmin(near.sum(axis=1)))])


def _fuse_subsamples(
    points: Floats, circle: Floats, settings: CircleSettings, rng: np.random.Generator
) -> tuple[Floats, float]:
    """Mean of the geometric fits of random half samples, weighted by support over squared residual, and its error."""
    size = min(int(len(points) * SUBSAMPLE_SHARE), MOST_OF_SUBSAMPLE)
    if size < LEAST_OF_SUBSAMPLE:
        return circle, float("nan")
    keys = rng.random((SUBSAMPLES, len(points)), dtype=np.float32)
    index = np.argpartition(keys, size - 1, axis=1)[:, :size]
    samples = points[index]
    fits = np.repeat(circle[None], SUBSAMPLES, axis=0)
    # Half samples start a fraction of the noise from their optimum: a few steps of Gauss-Newton are enough.
    for _ in range(SUBSAMPLE_STEPS):
        offset = samples - fits[:, None, :2]
        distance = np.maximum(np.sqrt(offset[..., 0] ** 2 + offset[..., 1] ** 2), 1e-12)
        jacobian = np.empty((len(fits), 3, size))
        np.divide(offset[..., 0], -distance, out=jacobian[:, 0])
        np.divide(offset[..., 1], -distance, out=jacobian[:, 1])
        jacobian[:, 2] = -1.0
        normal = jacobian @ np.swapaxes(jacobian, 1, 2)
        gradient = jacobian @ (distance - fits[:, None, 2])[..., None]
        ridge = 1e-12 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        fits = fits - np.linalg.solve(normal + ridge, gradient)[..., 0]
    residuals = residuals_to(points[None], fits[:, None, :])
    squared = (residuals**2).mean(axis=1)
    support = (np.abs(residuals) <= settings.drop_residual_m).mean(axis=1)
    usable = np.isfinite(fits).all(axis=1) & (squared <= RUNAWAY * np.median(squared))
    if not usable.any():
        return circle, float("nan")
    weight = np.where(usable, (support + LEAST_SUPPORT) / (squared + LEAST_SQUARE * settings.drop_residual_m**2), 0.0)
    weight /= weight.sum()
    fused = weight @ np.where(usable[:, None], fits, 0.0)
    # A sample of a share f of n points without replacement scatters about the full fit with
    # variance (1 - f) / f times that of the full fit: divide it out.
    share = size / len(points)
    spread = float(np.sqrt(weight @ (np.where(usable, fits[:, 2], 0.0) - fused[2]) ** 2))
    return fused, spread / float(np.sqrt((1.0 - share) / share))
