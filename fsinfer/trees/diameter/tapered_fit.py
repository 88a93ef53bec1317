"""The metre of stem around breast height: a tapering stem whose section has harmonics, and the points it rests on.

Several stems are fitted at once (:func:`fsinfer.trees.cylinder.batch.fit_sections`); they do not know of each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsinfer.trees.cylinder.axis import AxisFit, axis_coordinates
from fsinfer.trees.cylinder.batch import fit_sections
from fsinfer.trees.diameter.sides import noise_sector, relative_noise, seen_side
from fsinfer.trees.points.cells import rows
from fsinfer.trees.points.sums import lengths

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class JointSettings:
    """Constants of :func:`joint_fits`."""

    half_window_m: tuple[float, ...] = (0.4, 0.6, 0.9)  # of the tapered cylinder: 0.9-1.7 m first
    min_points: int = 12  # four times a circle's parameters
    max_points: int = 5000  # more do not move the fit
    order: int = 4  # harmonics of the section


def joint_fits(
    points: Sequence[Floats],
    starts: Floats,
    heights_m: Floats,
    sigmas_m: Floats,
    *,
    settings: JointSettings | None = None,
    seed: int = 0,
) -> list[tuple[AxisFit, Floats | None]]:
    """The stem in each of K sets of points (N_k, 3), and the points that were used; wider windows when sparse.

    ``starts`` (K, 6) are where the search has the axes at ``heights_m`` (K,), ``sigmas_m`` (K,) its noise. None for the
    points says that there are too few.
    """
    s = settings or JointSettings()
    rngs = [np.random.default_rng(seed) for _ in points]
    result: list[tuple[AxisFit, Floats | None]] = [
        (_unfitted(start, height, sigma), None)
        for start, height, sigma in zip(starts, heights_m, sigmas_m, strict=True)
    ]
    for half in s.half_window_m:
        near: dict[int, Floats] = {}
        for k, (fit, used) in enumerate(result):
            window = _window(points[k], starts[k], fit.height_m, half, s, rngs[k]) if used is None else points[k][:0]
            if len(window) >= s.min_points:
                near[k] = window
        for k, fit, used in _fits(near, starts, heights_m, sigmas_m, s):
            # The mixture forgets where a point was weighed out; enough bark means enough core.
            enough = fit.core.sum() >= 4 * s.min_points or half == s.half_window_m[-1]
            result[k] = fit, used if enough else None
    return result


def _window(
    points: Floats, start: Floats, height: float, half: float, s: JointSettings, rng: np.random.Generator
) -> Floats:
    """Points about the height and the wall where the search has it."""
    window = rows(points, np.abs(points[:, 2] - height) <= half)
    offset, _ = axis_coordinates(window, start, height)
    near = rows(window, lengths(offset) <= start[4] + float(np.clip(0.8 * start[4], 0.05, 0.12)))
    if len(near) > s.max_points:
        near = near.take(rng.choice(len(near), s.max_points, replace=False), axis=0)
    return near


def _fits(
    near: dict[int, Floats], starts: Floats, heights_m: Floats, sigmas_m: Floats, s: JointSettings
) -> list[tuple[int, AxisFit, Floats]]:
    """Number, fit and points of each stem: all sides alike first, then those that were seen, the hazy ones less."""
    those = np.array(list(near), dtype=np.int64)
    sigma = np.maximum(1.5 * sigmas_m[those], 0.006)
    first = fit_sections(list(near.values()), starts[those], heights_m[those], sigma_m=sigma, order=s.order)
    found = {k: (fit, own) for (k, own), fit in zip(near.items(), first, strict=True)}
    again: dict[int, tuple[Floats, Floats]] = {}
    for k, (fit, own) in found.items():
        # A few strays on the side that nobody saw would fix the diameter if they counted as bark.
        offset, foot = axis_coordinates(own, fit.parameters, fit.height_m)
        seen = seen_side(offset, foot, fit.core)
        if 4 * s.min_points <= seen.sum():
            offset = rows(offset, seen)
            again[k] = rows(own, seen), relative_noise(offset, fit.residuals_m[seen])[noise_sector(offset)]
    those = np.array(list(again), dtype=np.int64)
    second = fit_sections(
        [own for own, _ in again.values()],
        np.array([found[k][0].parameters for k in again]).reshape(-1, 6),
        heights_m[those],
        sigma_m=np.array([max(1.2 * found[k][0].sigma_m, 0.004) for k in again]),
        order=s.order,
        relative=[relative for _, relative in again.values()],
    )
    found |= {k: (fit, own) for (k, (own, _)), fit in zip(again.items(), second, strict=True)}
    return [(k, fit, own) for k, (fit, own) in found.items()]


def _unfitted(start: Floats, height: float, sigma: float) -> AxisFit:
    """What the search knows of a stem."""
    return AxisFit(
        parameters=start,
        height_m=float(height),
        sigma_m=float(sigma),
        covariance=np.eye(6),
        core=np.zeros(0),
        residuals_m=np.zeros(0),
        jacobian=np.zeros((0, 6)),
        prior_information=np.zeros(6),
        shape_m=np.zeros(0),
        noise_m=np.zeros(0),
    )
