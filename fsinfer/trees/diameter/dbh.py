"""The diameter at breast height of one stem, with its interval and its refusals.

The paper's circle (slice 1.3 m +- 1.5 cm, least squares, residuals above 1.5 cm dropped, random subsamples fused) is
fitted in the plane perpendicular to the stem's axis. Beside it a tapering stem whose section has harmonics
(:mod:`fsinfer.trees.cylinder.axis`) is fitted to the metre around breast height: it has less noise, the slice has less
of a model. The slice corrects the longer fit by what bark may swell or shrink locally, as far as the slice's own error
allows (one step of a Kalman filter). The diameter is the girth over pi: what a tape reads.

The 95 % interval adds up, as independent standard deviations of the radius: the fit (with what neighbouring points
share, :mod:`fsinfer.trees.diameter.spread`, and what the prior leaves open on the hidden side), the local correction,
what bark differs from a smooth surface, the height of the slice (ground noise times taper) and the scale. Its coverage
on simulated stems is published in docs/trees.md and printed by ``python -m tests.bench.stems``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fsinfer.trees.cylinder.axis import AxisFit, axis_coordinates
from fsinfer.trees.diameter.circle import covered_bins
from fsinfer.trees.diameter.double_wall import blurred_gap, wall_gap
from fsinfer.trees.diameter.outline import fit_outline
from fsinfer.trees.diameter.section import Section, unmeasured_section
from fsinfer.trees.diameter.slice import SliceSettings, fit_slice
from fsinfer.trees.diameter.spread import Spread, SpreadSettings, fit_spread
from fsinfer.trees.diameter.tapered_fit import JointSettings, joint_fits
from fsinfer.trees.points.sums import lengths
from fsinfer.trees.search.stem import Stem

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class DbhSettings:
    """Constants of :func:`measure_together`."""

    min_points: int = 12  # four times the circle's parameters
    min_coverage: float = 65.0 / 360.0  # less arc than this leaves the radius open
    doubtful_coverage: float = 100.0 / 360.0
    max_sigma_m: float = 0.026
    max_sigma_of_radius: float = 0.35
    max_interval: float = 0.6  # a 95 % interval wider than this share of the DBH is no measurement
    doubtful_interval: float = 0.22
    outline_coverage: float = 0.8  # perimeter, least and greatest diameter need the way round
    local_std: float = 0.0035  # of the radius: how far a slice departs from the smooth taper (whorls, scars)
    bark_std: float = 0.0005  # of the radius: a tape spans the furrows, a smooth curve averages them
    # Where blocks of bark share more error than bark's own unevenness, the cause (edges fattened by a depth map, moss,
    # poses) also moves the whole circumference, which no residual shows. Chosen on a rendered plot (docs/trees.md).
    common_share: float = 1.5
    uneven_std: float = 0.006  # of the radius: what blocks of bark differ by nature
    noise_share: float = 0.015  # of sigma: noise is not quite a Gaussian with an exponential tail
    spread_factor: float = 1.15  # calibrated on simulated stems (tests/bench/stems.py, seeds below 1000)
    taper_std: float = 0.002  # radius per metre: what the taper near breast height may differ from the fitted one
    ground_std_m: float = 0.02  # where the ground is, between litter and mineral soil
    max_change: tuple[float, float] = (0.35, 0.03)  # share and metres by which the radius may differ from the search's
    joint: JointSettings = field(default_factory=JointSettings)
    slice: SliceSettings = field(default_factory=SliceSettings)
    spread: SpreadSettings = field(default_factory=SpreadSettings)


def measure_together(
    points: Sequence[Floats],
    stems: Sequence[Stem],
    *,
    bh_m: float = 1.3,
    ground_noise_m: float = 0.0,
    scale_rel_std: float = 0.0,
    settings: DbhSettings | None = None,
    seed: int = 0,
) -> list[Section]:
    """Measure each stem among its points (N, 3) of x, y, height above its own ground, in metres.

    Stems do not know of each other; they are taken together because their fits are faster at once.
    """
    s = settings or DbhSettings()
    starts = np.zeros((len(stems), 6))
    heights = np.zeros(len(stems))
    for k, stem in enumerate(stems):
        height = float(np.clip(bh_m, stem.bottom_m + 0.1, max(stem.top_m - 0.1, stem.bottom_m + 0.1)))
        start = stem.axis.parameters.copy()
        start[:2] = stem.axis.center_at(height)
        start[4] = max(stem.axis.radius_m + start[5] * (height - stem.axis.height_m), 0.01)
        starts[k], heights[k] = start, height
    sigmas = np.array([stem.axis.sigma_m for stem in stems])
    fits = joint_fits(points, starts, heights, sigmas, settings=s.joint, seed=seed)
    return [
        _section(own, stem, fit, used, bh_m, ground_noise_m, scale_rel_std, s, seed)
        for own, stem, (fit, used) in zip(points, stems, fits, strict=True)
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
    if used is None:
        beside = points[np.abs(points[:, 2] - height) <= s.slice.half_slices_m[-1]]
        return unmeasured_section(
            fit.center_at(height),
            height,
            f"too few points at breast height: fewer than {s.min_points}",
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
    wall = np.abs(fit.residuals_m) <= 2.5 * fit.noise_m
    coverage = float(covered_bins(offset[wall], bins=72).mean())
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
    radius -= 1.0 / (2.0 * precision * max(radius, 0.01))
    radius *= _girth_factor(fit, spread)
    level = (abs(taper) + s.taper_std) * float(np.hypot(s.ground_std_m, ground_noise_m))
    parts = {
        "fit": float(np.sqrt(joint_var)),
        "local": float(np.sqrt(local_var)),
        "bark": s.bark_std * radius,
        "noise": s.noise_share * fit.sigma_m,
        "common": s.common_share * float(np.sqrt(max(spread.tau_m**2 - (s.uneven_std * radius) ** 2, 0.0))),
        "level": level,
        "scale": radius * scale_rel_std,
    }
    sd = 2.0 * float(np.sqrt(sum(part**2 for part in parts.values())))
    circle = np.array([section.circle_m[0], section.circle_m[1], radius])
    outline = None
    if coverage >= s.outline_coverage:
        scaled = offset * (1.0 - taper * foot / np.maximum(lengths(offset), 1e-6))[:, None]
        outline = fit_outline(scaled, fit.core, radius, fit.sigma_m)
    gap = wall_gap(offset, lengths(offset) - (fit.radius_m + taper * foot), fit.sigma_m)
    if gap == 0.0:
        gap = blurred_gap(offset, fit.residuals_m, fit.sigma_m)
    share, metres = s.max_change
    astray = abs(fit.radius_m - stem.axis.radius_m) > share * stem.axis.radius_m + metres
    reason = _refuse(fit, coverage, 2.0 * radius, sd, gap, int(wall.sum()), s)
    if astray and not reason:
        reason = "no round surface at breast height: its curvature changes too much with the part that is looked at"
    status = "unmeasured" if reason else "ok"
    if not reason:
        reason = _doubt(coverage, 2.0 * radius, sd, height - bh_m, s)
        status = "doubtful" if reason else "ok"
    return Section(
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
        reason=reason,
        offsets_m=section.offsets_m,
        kept=section.kept,
        circle_m=circle,
        half_slice_m=section.half_m,
        outline=outline if status != "unmeasured" else None,
    )


def _girth_factor(fit: AxisFit, spread: Spread) -> float:
    """Girth of a section with harmonics over that of the circle of its mean radius: 1 + sum k^2 e_k^2 / 4.

    ``e_k`` is the amplitude of harmonic k over the radius; the expected square has the coefficient's variance in it.
    """
    squares = fit.shape_m**2 + np.diag(spread.covariance)[6:]
    order = np.repeat(np.arange(2, 2 + len(squares) // 2), 2)
    return 1.0 + float((order**2 * squares).sum()) / (4.0 * fit.radius_m**2)


def _refuse(fit: AxisFit, coverage: float, dbh_m: float, sd: float, gap: float, count: int, s: DbhSettings) -> str:
    if count < s.min_points:
        return f"too few points at breast height: {count}; photograph the stem from more places"
    if coverage < s.min_coverage:
        return f"only {360 * coverage:.0f} degrees of the stem are seen; walk round it"
    if gap > 0.0:
        return f"double wall: two surfaces {100 * gap:.1f} cm apart; the poses or scans do not agree at this stem"
    if fit.sigma_m > min(s.max_sigma_m, 0.5 * s.max_sigma_of_radius * dbh_m):
        return f"surface too rough: residual {100 * fit.sigma_m:.1f} cm; undergrowth or bad depth at breast height"
    return too_uncertain(dbh_m, sd, s)


def too_uncertain(dbh_m: float, sd: float, s: DbhSettings) -> str:
    """Why a diameter with the standard deviation ``sd``, both metres, is no measurement; empty where it is one."""
    if 2 * 1.96 * sd > s.max_interval * dbh_m:
        return f"too uncertain: {100 * dbh_m:.0f} cm +- {100 * 1.96 * sd:.0f} cm; walk round the stem"
    return ""


def wide_interval(dbh_m: float, sd: float, s: DbhSettings) -> list[str]:
    """The doubt about a diameter with the standard deviation ``sd``, both metres, if there is one."""
    return [f"wide interval (+- {100 * 1.96 * sd:.1f} cm)"] if 2 * 1.96 * sd > s.doubtful_interval * dbh_m else []


def _doubt(coverage: float, dbh_m: float, sd: float, shift: float, s: DbhSettings) -> str:
    doubts = []
    if abs(shift) > 0.05:
        doubts.append(f"measured {100 * abs(shift):.0f} cm {'above' if shift > 0 else 'below'} breast height")
    if coverage < s.doubtful_coverage:
        doubts.append(f"only {360 * coverage:.0f} degrees of the stem are seen")
    return "; ".join([*doubts, *wide_interval(dbh_m, sd, s)])
