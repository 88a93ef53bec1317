"""How far off a stem's fitted radius may be when neighbouring points err together.

Pixels of one depth map, moss and bark plates make errors that points share, and thousands of points do not average
them away. The residuals tell how much: the mean residual of a block of bark (some centimetres wide, a decimetre high)
scatters by sigma^2 / n if points are independent and by more if they are not. What is more is the variance tau^2 of a
random effect of each block, which goes into the covariance of the fit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsinfer.trees.cylinder.axis import RIDGE, AxisFit
from fsinfer.trees.diameter.budget import LEAST_DOF
from fsinfer.trees.points.sums import sums_of_products
from fsinfer.trees.points.surface import LAYER_M, SECTORS, sector_of

Floats = NDArray[np.float64]


#: Least number of blocks, beside as many as unknowns, and of pairs of them, that tell what blocks share.
#: Source: numerics.
LEAST_FREE, LEAST_PAIRS = 4, 6


@dataclass(frozen=True, kw_only=True)
class SpreadSettings:
    """Constants of :func:`fit_spread`; blocks are ``LAYER_M`` high.

    Attributes
    ----------
    block_arc_m: width of a block: more than the pixels of a depth map on a stem, less than its shape. Source: chosen on
        simulated stems.
    max_correlation: of adjacent blocks; more is the shape of the stem, which the harmonics have. Source: chosen on
        simulated stems.
    few_blocks_tau: share of the noise that is taken for shared where too few blocks are seen to tell. Source: chosen on
        simulated stems.
    """

    block_arc_m: float = 0.04
    max_correlation: float = 0.7
    few_blocks_tau: float = 0.3


@dataclass(frozen=True, kw_only=True)
class Spread:
    """Covariance (P, P) of the fit's parameters, and ``tau_m``: the standard deviation that blocks of bark share.

    ``tau_dof`` are the degrees of freedom from which the latter was estimated: the blocks beyond those that the fit
    uses up, counted as few as neighbours go together. ``radius_dof`` are those of the radius's variance, of which only
    what blocks share is uncertain.
    """

    covariance: Floats
    tau_m: float
    tau_dof: float
    radius_dof: float


def fit_spread(fit: AxisFit, offsets: Floats, foot: Floats, *, settings: SpreadSettings | None = None) -> Spread:
    """Spread of ``fit`` for its points at ``offsets`` (N, 2) from the axis and ``foot`` (N,) along it."""
    s = settings or SpreadSettings()
    sectors = int(np.clip(round(2.0 * np.pi * fit.radius_m / s.block_arc_m), *SECTORS))
    sector = sector_of(offsets, sectors)
    layer = np.floor((foot - foot.min()) / LAYER_M).astype(np.int64)
    layers = int(layer.max()) + 1
    block = layer * sectors + sector
    size = layers * sectors
    # Residuals in units of the noise: what is shared is a part of it.
    weight = fit.core
    scaled = fit.residuals_m / fit.noise_m
    count = np.bincount(block, weights=weight, minlength=size)
    mean = np.bincount(block, weights=weight * scaled, minlength=size) / np.maximum(count, 1e-9)
    seen = count >= 2.0
    parameters = fit.jacobian.shape[1]
    free = int(seen.sum()) - parameters
    if free < LEAST_FREE:
        tau2 = s.few_blocks_tau**2
    else:
        excess = float((count[seen] * mean[seen] ** 2).sum()) - free
        tau2 = max(excess / float(count[seen].sum()) * seen.sum() / free, 0.0)
    grid, mask = mean.reshape(layers, sectors), seen.reshape(layers, sectors)
    inflation = 1.0
    for axis in (0, 1):
        shifted = np.roll(grid, -1, axis=axis)
        both = mask & np.roll(mask, -1, axis=axis)
        if axis == 0:
            both[-1] = False  # the layers do not close into a ring
        if both.sum() >= LEAST_PAIRS:
            rho = float((grid * shifted)[both].mean() / max(float((grid[both] ** 2).mean()), 1e-12))
            rho = float(np.clip(rho, 0.0, s.max_correlation))
            inflation *= (1.0 + rho) / (1.0 - rho)
    jacobian = fit.jacobian / fit.noise_m[:, None]
    weighted = jacobian * (weight * fit.worth)[:, None]
    # Points that err together count for less by as much as their mean is less sure: what they say has this variance.
    information = sums_of_products(weighted.T, jacobian.T)
    sums = np.stack([np.bincount(block, weights=weighted[:, k], minlength=size) for k in range(parameters)], axis=1)
    prior = np.diag(fit.prior_information)
    shared = inflation * tau2 * sums.T @ sums
    bread = np.linalg.inv(information + prior + RIDGE * np.eye(parameters))
    covariance = np.asarray(bread @ (information + shared + prior) @ bread)
    tau_dof = max(free / inflation, LEAST_DOF)
    part = float(bread[4] @ shared @ bread[4]) / max(float(covariance[4, 4]), 1e-18)
    return Spread(
        covariance=covariance,
        tau_m=fit.sigma_m * float(np.sqrt(tau2)),
        tau_dof=tau_dof,
        radius_dof=tau_dof / part**2 if part > 0.0 else float("inf"),
    )
