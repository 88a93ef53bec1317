"""The diameter at breast height of one stem, with its interval and its refusals.

The paper's circle (slice 1.3 m +- 1.5 cm, least squares, residuals above 1.5 cm dropped, random subsamples fused) is
fitted in the plane perpendicular to the stem's axis. Beside it a tapering stem whose section has harmonics
(:mod:`fsinfer.trees.cylinder.axis`) is fitted to the metre around breast height: it has less noise, the slice has less
of a model. The slice corrects the longer fit by what bark may swell or shrink locally, as far as the slice's own error
allows (one step of a Kalman filter). The diameter is the girth over pi: what a tape reads.

The 95 % interval adds up, as independent standard deviations of the radius: the fit (with what neighbouring points
share, :mod:`fsinfer.trees.diameter.spread`, and what the prior leaves open on the hidden side), the local correction,
what bark differs from a smooth surface, what unseen sides may be like, the height of the slice (ground noise times
taper; the taper's own error where the stem was measured
above or below breast height) and the scale. Where few blocks of bark tell the error it is Student's interval
(:mod:`fsinfer.trees.diameter.budget`). Its coverage by class, on stems that do not follow this model, is published in
docs/trees.md and printed by ``python -m tests.bench.stems --kind walked-photo``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fsinfer.conventions.breast_height import BREAST_HEIGHT_M
from fsinfer.notices.notice import notice
from fsinfer.notices.stems import StemCode
from fsinfer.trees.cylinder.axis import LEAST_CORE, LEAST_RADIUS_M, AxisFit, axis_coordinates
from fsinfer.trees.diameter.budget import effective_dof, factor95, shared_std, total_std
from fsinfer.trees.diameter.circle import LEAST_POINTS
from fsinfer.trees.diameter.dbh_settings import DbhSettings
from fsinfer.trees.diameter.double_wall import TwoWalls, blurred_gap, two_walls
from fsinfer.trees.diameter.file_order import stations_apart_m
from fsinfer.trees.diameter.outline import fit_outline
from fsinfer.trees.diameter.pieces import pieces_of
from fsinfer.trees.diameter.roundness import roundness
from fsinfer.trees.diameter.section import Section, as_searched, unmeasured_section
from fsinfer.trees.diameter.slice import fit_slice
from fsinfer.trees.diameter.spread import Spread, fit_spread
from fsinfer.trees.diameter.tapered_fit import joint_fits, wall_coverage
from fsinfer.trees.diameter.verdict import doubts_about, ground_doubt, may_be_measured, refused, walls_std_m
from fsinfer.trees.points.cells import rows
from fsinfer.trees.points.errors import tells_errors
from fsinfer.trees.points.smoothing import unsmoothed
from fsinfer.trees.points.sums import lengths
from fsinfer.trees.points.surface import LAYER_M, WALL_SIGMAS
from fsinfer.trees.search.stem import Stem

Floats = NDArray[np.float64]


def measure_together(
    points: Sequence[Floats],
    stems: Sequence[Stem],
    *,
    bh_m: float | Sequence[float] = BREAST_HEIGHT_M,
    ground_noise_m: float | Sequence[float] = 0.0,
    scale_rel_std: float = 0.0,
    settings: DbhSettings | None = None,
    seed: int = 0,
) -> list[Section]:
    """Measure each stem among its points (N, 3, 5 or 7) of x, y, height above its own ground, metres, and their errors.

    Stems do not know of each other; they are taken together because their fits are faster at once.
    ``bh_m`` is the height of the diameter, ``ground_noise_m`` the standard deviation of the level that their heights
    count from, both of all or of each.
    """
    s = settings or DbhSettings()
    starts = np.zeros((len(stems), 6))
    heights = np.zeros(len(stems))
    wanted = np.broadcast_to(np.asarray(bh_m, dtype=np.float64), len(stems)).tolist()
    for k, stem in enumerate(stems):
        lowest = stem.bottom_m + LAYER_M
        height = float(np.clip(wanted[k], lowest, max(stem.top_m - LAYER_M, lowest)))
        start = stem.axis.parameters.copy()
        start[:2] = stem.axis.center_at(height)
        start[4] = max(stem.axis.radius_at(height), LEAST_RADIUS_M)
        starts[k], heights[k] = start, height
    sigmas = np.array([stem.axis.sigma_m for stem in stems])
    noises = np.broadcast_to(np.asarray(ground_noise_m, dtype=np.float64), len(stems)).tolist()
    points = [
        unsmoothed(own, start, height) for own, start, height in zip(points, starts, heights.tolist(), strict=True)
    ]
    fits = joint_fits(points, starts, heights, sigmas, half_windows_m=s.half_windows_m, seed=seed)
    return [
        _section(own, stem, fit, used, height, noise, scale_rel_std, s, seed)
        for own, stem, (fit, used), height, noise in zip(points, stems, fits, wanted, noises, strict=True)
    ]


def _section(
    points: Floats,
    stem: Stem,
    fit: AxisFit,
    used: Floats | None,
    bh_m: float,
    ground_noise_m: float,
    scale_rel_std: float,
    s: DbhSettings,
    seed: int,
) -> Section:
    """The section of one stem whose ``fit`` rests on the points ``used``."""
    height = fit.height_m
    if used is None or fit.core.sum() < LEAST_CORE:
        # A fit that has lost the bark says nothing of it.
        few = notice(StemCode.too_few_at_breast_height, least=LEAST_POINTS)
        beside = points[np.abs(points[:, 2] - height) <= s.slice.half_slices_m[-1]]
        return unmeasured_section(
            fit.center_at(height),
            height,
            (few if used is None else notice(StemCode.too_few_on_bark, points=0), *ground_doubt(ground_noise_m, s)),
            radius_m=fit.radius_m,
            lean_deg=fit.lean_deg,
            slope=fit.parameters[2:4],
            taper=float(fit.parameters[5]),
            top_m=stem.top_m,
            offsets_m=beside[:, :2] - fit.center_at(height),
            half_slice_m=s.slice.half_slices_m[-1],
        )
    offset, foot = axis_coordinates(used, fit.parameters, height)
    spread = fit_spread(fit, offset, foot, settings=s.spread)
    taper = float(fit.parameters[5])
    wall = np.abs(fit.residuals_m) <= WALL_SIGMAS * fit.noise_m
    coverage = wall_coverage(fit, used)
    section = fit_slice(points, fit, height, coverage, settings=s.slice, seed=seed)
    joint_var = s.spread_factor**2 * float(spread.covariance[4, 4])
    local_var = (s.local_std * fit.radius_m) ** 2
    radius = fit.radius_m
    if section.radius_m is not None:
        gain = local_var / (local_var + section.std_m**2)
        radius += gain * (section.radius_m - fit.radius_m)
        local_var *= 1.0 - gain
    # A geometric fit to points with noise sigma overestimates the radius by sigma^2 / 2R (Chernov & Lesort 2004).
    precision = float((fit.core / fit.noise_m**2).sum() / max(float(fit.core.sum()), 1e-9))
    # Noise along the views does half of that. What lies in between is in the interval, by its share of the noise.
    even = float(np.clip(s.even_noise_m / fit.sigma_m, 0.5, 1.0))
    radius -= even / (2.0 * precision * max(radius, LEAST_RADIUS_M))
    girth = _girth_factor(fit, spread)
    radius *= girth
    # At breast height, which what was measured is not where undergrowth hides the stem there.
    off = height - bh_m
    at_measured, radius = radius, max(radius - taper * off, LEAST_RADIUS_M)
    level = (abs(taper) + s.taper_std) * float(np.hypot(s.ground_std_m, ground_noise_m))
    taper_var = s.taper_std**2 + s.spread_factor**2 * float(spread.covariance[5, 5])
    level = float(np.hypot(level, np.sqrt(taper_var) * off))
    walls = two_walls(offset, lengths(offset) - (fit.radius_m + taper * foot), fit.sigma_m)
    if walls.gap_m == 0.0:
        blurred = blurred_gap(offset, fit.residuals_m, fit.sigma_m)
        walls = TwoWalls(gap_m=blurred, shifted=blurred > 0.0, whole=blurred > 0.0)
    on_bark = np.column_stack([offset * (fit.radius_m / np.maximum(lengths(offset), 1e-6))[:, None], foot])
    parts = {
        "fit": float(np.sqrt(joint_var)),
        "local": float(np.sqrt(local_var)),
        "bark": s.bark_std * radius,
        "hidden": s.hidden_std * (1.0 - coverage) * radius,
        "noise": s.noise_share * fit.sigma_m,
        "common": s.common_share * float(np.sqrt(max(spread.tau_m**2 - (s.uneven_std * radius) ** 2, 0.0))),
        "level": level,
        "scale": radius * scale_rel_std,
    }
    if may_be_measured(walls, s):
        parts["walls"] = walls_std_m(walls, radius, s)
    elif walls.gap_m == 0.0:
        parts["stations"] = s.stations_share * stations_apart_m(on_bark, fit.residuals_m, wall)
    sd = 2.0 * total_std(parts)
    dof = effective_dof(parts, {"fit": spread.radius_dof, "common": spread.tau_dof})
    half = factor95(dof) * sd
    circle = np.array([section.circle_m[0], section.circle_m[1], at_measured])
    outline = None
    if coverage >= s.outline_coverage and walls.gap_m == 0.0:
        scaled = offset * (1.0 - taper * foot / np.maximum(lengths(offset), 1e-6))[:, None]
        scaled *= radius / at_measured
        # About the mean radius: its own harmonics make the outline's girth longer than that circle's.
        outline = fit_outline(scaled, fit.core, radius / girth, fit.sigma_m)
    share, metres = s.max_change
    most = share * stem.axis.radius_m + metres
    aside = float(np.linalg.norm(fit.center_at(height) - stem.axis.center_at(height)))
    astray = max(abs(fit.radius_m - stem.axis.radius_m), aside) > most
    reasons = refused(fit, coverage, 2.0 * radius, half, walls, int(wall.sum()), s)
    pieces = None if tells_errors(used) else pieces_of(rows(offset, wall), fit.radius_m)
    if pieces is not None and pieces.stand_apart(fit.sigma_m):
        # Of what is no surface nothing else is to be said.
        reasons = (notice(StemCode.in_pieces, pieces=pieces.number),)
    if astray and not reasons:
        reasons = (notice(StemCode.not_round),)
    status = "unmeasured" if reasons else "ok"
    if reasons:
        reasons = (*reasons, *ground_doubt(ground_noise_m, s))
    else:
        reasons = doubts_about(fit, coverage, 2.0 * radius, half, walls, off, ground_noise_m, s)
        status = "doubtful" if reasons else "ok"
    measured = Section(
        center=fit.center_at(height),
        bh_m=height,
        dbh_m=None if status == "unmeasured" else 2.0 * radius,
        sd_m=sd,
        coverage=coverage,
        points=int(section.kept.sum()),
        residual_m=fit.sigma_m,
        parts_m=parts,
        tau_m=spread.tau_m,
        lean_deg=fit.lean_deg,
        slope=fit.parameters[2:4],
        taper=float(fit.parameters[5]),
        top_m=stem.top_m,
        status=status,
        reasons=reasons,
        offsets_m=section.seen_m,
        kept=section.kept,
        circle_m=circle,
        half_slice_m=section.half_m,
        outline=outline if status != "unmeasured" else None,
        dof=dof,
        shared_sd_m=2.0 * shared_std(parts),
        by_taper_m=radius - at_measured,
        roundness=roundness(fit, spread),
    )
    return as_searched(measured, stem.axis) if astray else measured


def _girth_factor(fit: AxisFit, spread: Spread) -> float:
    """Girth of a section with harmonics over that of the circle of its mean radius: 1 + sum k^2 e_k^2 / 4.

    ``e_k`` is the amplitude of harmonic k over the radius; the expected square has the coefficient's variance in it.
    """
    squares = fit.shape_m**2 + np.diag(spread.covariance)[6:]
    order = np.repeat(np.arange(2, 2 + len(squares) // 2), 2)
    return 1.0 + float((order**2 * squares).sum()) / (4.0 * fit.radius_m**2)
