"""The metre of stem around breast height: a tapering stem whose section has harmonics, and the points it rests on.

Several stems are fitted at once (:func:`fsinfer.trees.cylinder.batch.fit_sections`); they do not know of each other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from fsinfer.trees.cylinder.axis import LEAST_CORE, AxisFit, AxisSettings, axis_coordinates, wider
from fsinfer.trees.cylinder.batch import fit_sections
from fsinfer.trees.diameter.circle import LEAST_POINTS, covered_bins
from fsinfer.trees.diameter.sides import noise_sector, relative_noise, seen_side
from fsinfer.trees.points.cells import rows
from fsinfer.trees.points.errors import STD, relative_errors, tells_errors, worth_of_word
from fsinfer.trees.points.sums import lengths
from fsinfer.trees.points.surface import OUTSIDE_SIGMAS, WALL_SIGMAS, reach_about_wall

Floats = NDArray[np.float64]


#: Points of a piece of stem; more do not move the fit. Source: numerics.
MOST_POINTS = 5000
#: So many times the points that a circle needs are enough bark, or a longer piece is fitted. Source: not recorded.
ENOUGH = 4
#: Least and greatest mean length of the outward tail, metres, longer than where stems are looked for: a tail of a
#: centimetre takes half of a wall that the cameras' errors have made thick, and the stem comes out too thin. Source:
#: chosen on three rendered plots (docs/trials-accuracy.md); simulated stems, whose tail is 3 cm, do not mind.
TAIL_M = (0.03, 0.06)
#: Greatest noise of the wall, metres, more than where stems are looked for: scanners that are carried blur stems by
#: three to four centimetres. Source: chosen on simulated stems (docs/trials-accuracy.md).
MOST_SIGMA_M = 0.05
#: The points of a stem with more noise than this, metres, are chosen again about its fit, so often at most, until the
#: radius moves by less than so many metres. Source: chosen on simulated stems (docs/trials-accuracy.md).
BLURRED_SIGMA_M, AGAIN, SETTLED_M = 0.02, 6, 0.0005
#: Points with this standard deviation, metres, count half for whether a side is seen. Source: judgement; a side known
#: from ten metres is seen, one from twenty is a haze (docs/trials-accuracy.md).
SEEN_STD_M = 0.005
#: The second fit starts with so many times the noise of the first, and at least so many metres. Source: numerics.
SECOND_START = (1.2, 0.004)


def joint_fits(
    points: Sequence[Floats],
    starts: Floats,
    heights_m: Floats,
    sigmas_m: Floats,
    *,
    half_windows_m: Sequence[float],
    seed: int = 0,
) -> list[tuple[AxisFit, Floats | None]]:
    """The stem in each of K sets of points (N_k, 3, 5 or 7), and the points that were used; wider windows when sparse.

    ``starts`` (K, 6) are where the search has the axes at ``heights_m`` (K,), ``sigmas_m`` (K,) its noise. None for the
    points says that there are too few. ``half_windows_m`` are half lengths of the piece of stem, ascending.
    """
    s = AxisSettings(sigma_m=(AxisSettings().sigma_m[0], MOST_SIGMA_M), tail_m=TAIL_M)
    halves: dict[int, float] = {}
    rngs = [np.random.default_rng(seed) for _ in points]
    result: list[tuple[AxisFit, Floats | None]] = [
        (_unfitted(start, height, sigma), None)
        for start, height, sigma in zip(starts, heights_m, sigmas_m, strict=True)
    ]
    starts, sigmas_m = starts.copy(), sigmas_m.copy()
    for half in half_windows_m:
        near: dict[int, Floats] = {}
        for k, (fit, used) in enumerate(result):
            window = _window(points[k], starts[k], fit.height_m, half, s, rngs[k]) if used is None else points[k][:0]
            if len(window) >= LEAST_POINTS:
                near[k] = window
        for k, fit, used in _fits(near, starts, heights_m, sigmas_m, s):
            # The mixture forgets where a point was weighed out; enough bark means enough core.
            enough = fit.core.sum() >= ENOUGH * LEAST_POINTS or half == half_windows_m[-1]
            result[k] = fit, used if enough else None
            halves[k] = half
    blurred = [
        k
        for k, (fit, used) in enumerate(result)
        if used is not None and max(fit.sigma_m, sigmas_m[k]) > BLURRED_SIGMA_M
    ]

    def about_fit(k: int) -> Floats:
        fit = result[k][0]
        starts[k], sigmas_m[k] = fit.parameters, fit.sigma_m
        return _window(points[k], starts[k], fit.height_m, halves[k], s, rngs[k], least_m=OUTSIDE_SIGMAS * fit.sigma_m)

    for _ in range(AGAIN):
        if not blurred:
            break
        # About a radius that the search had too small the outer half of a blurred wall is missing: of stems with 3 to 4
        # cm of noise diameters came out up to 5 cm too small.
        near = {k: window for k in blurred if len(window := about_fit(k)) >= LEAST_POINTS}
        again = [one for one in _fits(near, starts, heights_m, sigmas_m, s) if one[1].core.sum() >= LEAST_CORE]
        blurred = [k for k, fit, _ in again if abs(fit.radius_m - result[k][0].radius_m) > SETTLED_M]
        for k, fit, used in again:
            result[k] = fit, used
    return result


def wall_coverage(fit: AxisFit, used: Floats) -> float:
    """The share of the circumference in which the points ``used`` (N, 3, 5 or 7) of a fit lie on its wall.

    What photographs made of a side from so far away that it is a haze of centimetres counts little.
    """
    offset, _ = axis_coordinates(used, fit.parameters, fit.height_m)
    wall = np.abs(fit.residuals_m) <= WALL_SIGMAS * fit.noise_m
    weights = None
    if tells_errors(used):
        weights = 1.0 / (1.0 + (used[wall, STD] / SEEN_STD_M) ** 2)
    return float(covered_bins(rows(offset, wall), weights=weights).mean())


def _window(
    points: Floats,
    start: Floats,
    height: float,
    half: float,
    s: AxisSettings,
    rng: np.random.Generator,
    *,
    least_m: float = 0.0,
) -> Floats:
    """Points about the height and the wall where the search has it."""
    window = rows(points, np.abs(points[:, 2] - height) <= half)
    offset, _ = axis_coordinates(window, start, height)
    near = rows(window, lengths(offset) <= start[4] + max(reach_about_wall(start[4], s.window_m), least_m))
    if len(near) > MOST_POINTS:
        # In the order of the file, which tells a scanner's stations apart.
        near = near.take(np.sort(rng.choice(len(near), MOST_POINTS, replace=False)), axis=0)
    return near


def _fits(
    near: dict[int, Floats], starts: Floats, heights_m: Floats, sigmas_m: Floats, s: AxisSettings
) -> list[tuple[int, AxisFit, Floats]]:
    """Number, fit and points of each stem: all sides alike first, then those that were seen, the hazy ones less."""
    those = np.array(list(near), dtype=np.int64)
    sigma = np.array([wider(float(sigmas_m[k])) for k in those])
    told = [relative_errors(own, starts[k], float(heights_m[k])) for k, own in near.items()]
    any_told = any(tells_errors(own) for own in near.values())

    def words(sets: Mapping[int, Floats], axes: Mapping[int, Floats]) -> list[Floats] | None:
        """What the word of each point counts about the axes; None where all count in full."""
        return [worth_of_word(own, axes[k], float(heights_m[k])) for k, own in sets.items()] if any_told else None

    first = fit_sections(
        list(near.values()),
        starts[those],
        heights_m[those],
        sigma_m=sigma,
        order=s.order,
        relative=told if any_told else None,
        worth=words(near, dict(enumerate(starts))),
        settings=s,
    )
    found = {k: (fit, own) for (k, own), fit in zip(near.items(), first, strict=True)}
    again: dict[int, tuple[Floats, Floats]] = {}
    for k, (fit, own) in found.items():
        # A few strays on the side that nobody saw would fix the diameter if they counted as bark.
        offset, foot = axis_coordinates(own, fit.parameters, fit.height_m)
        seen = seen_side(offset, foot, fit.core)
        if seen.sum() >= ENOUGH * LEAST_POINTS:
            offset = rows(offset, seen)
            noise = relative_errors(own, fit.parameters, fit.height_m)[seen]
            by_side = relative_noise(offset, fit.residuals_m[seen] / noise)[noise_sector(offset)]
            again[k] = rows(own, seen), noise * by_side
    those = np.array(list(again), dtype=np.int64)
    second = fit_sections(
        [own for own, _ in again.values()],
        np.array([found[k][0].parameters for k in again]).reshape(-1, 6),
        heights_m[those],
        sigma_m=np.array([max(SECOND_START[0] * found[k][0].sigma_m, SECOND_START[1]) for k in again]),
        order=s.order,
        relative=[relative for _, relative in again.values()],
        worth=words({k: own for k, (own, _) in again.items()}, {k: found[k][0].parameters for k in again}),
        settings=s,
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
        worth=np.zeros(0),
    )
