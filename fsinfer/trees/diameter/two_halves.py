"""Two halves of a stem that lie apart: how well they explain its section, beside a stem that merely is not round.

Where a walk or a registration is torn, one part of it puts the side that it saw a vector d beside where the other has
its own. In the direction n of a side the bark then lies d·n too far out on that half, 0 on the other. Over the angle
that is a half of a cosine, whose mean is d / pi where the halves were pulled apart or pushed together (the circle comes
out too thick or too thin by that, in radius) and 0 where they slid along each other. Both leave even harmonics: the
second of 0.21 d (apart) to 0.42 d (sliding), the fourth -0.2 and -0.4 times as large, and corners at the seams.

A stem that grew has such harmonics too, in proportion to its radius. So a section of sectors y is taken for
y = H c + d t + e: mean, place and harmonics c with their prior (:class:`AxisSettings`), times a scale that says how far
from round the stems of this plot are, the half t, and the noise e. For each d the evidence is the mean over where the
half may lie and how wide it is (Gaussian integrals; Kass & Raftery 1995, JASA 90, 773, on evidence by integration):
anywhere, where each stem is cut its own way as the walk passed it, or about one direction, where all are cut alike.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsinfer.trees.cylinder.axis import AxisSettings
from fsinfer.trees.diameter.profile import PROFILE_SECTORS, SideProfile
from fsinfer.trees.points.sums import MAD_TO_SIGMA, median

Floats = NDArray[np.float64]
#: Directions of the shift over half a turn, and of the middle of the half over a whole one. Source: numerics.
DIRECTIONS, MIDDLES = 18, 24
#: Directions about which the halves of all stems may lie, and how many middles to either side count as that, 30
#: degrees. Source: numerics.
ALIKE, BESIDE = 12, 2
#: Degrees over which one part's points give way to the other's at the seam. Source: numerics, less than a sector.
SEAM_DEG = 8.0
#: Mean and place are left free: one over the variance that they are given, 1/m^2. Source: numerics, a kilometre.
FREE = 1e-6
#: Rounds in which the unevenness of the bark is found. Source: numerics.
ROUNDS = 3


@dataclass(frozen=True, kw_only=True)
class HalvesSettings:
    """Constants of :func:`evidence_of_halves`.

    Attributes
    ----------
    shifts_m: least and greatest shift that is looked for, and the step. Source: judgement, what is less costs half a
        centimetre of diameter at most; two walls that are farther apart are two stems to the search.
    half_widths_deg: half of the angle that the shifted part saw. Source: geometry, a third to two thirds of the stem.
    shape_scales: how far from round the stems of a plot may be, times the prior of the fit. Source: judgement, from
        those that the prior was made for to 6 % of the radius.
    cut_alike: chance that all stems of a torn plot are cut in about the same direction. Source: judgement, even odds.
    one_part: share of the stems that one part alone may have seen. Source: judgement; simulated walks that are torn
        have 0 to a fifth.
    noise_factor: of the variance of a sector's mean, which errs with its neighbours. Source: simulated walks, seeds
        43000-43011 torn and 43000-43015 whole: with 1.5 and with 3 none of the whole ones shows a shift, with 1.5 more
        of the torn ones do.
    furrow_m: least unevenness of bark, standard deviation of a sector. Source: judgement, smooth bark.
    min_sectors: seen of a stem, below which it says nothing. Source: judgement, 80 degrees of 360.
    """

    shifts_m: tuple[float, float, float] = (0.01, 0.07, 0.005)
    half_widths_deg: tuple[float, ...] = (60.0, 90.0, 120.0)
    shape_scales: tuple[float, ...] = (1.0, 1.5, 2.0, 3.0, 4.0)
    cut_alike: float = 0.5
    one_part: float = 0.2
    noise_factor: float = 1.5
    furrow_m: float = 0.001
    min_sectors: int = 8

    @property
    def sizes_m(self) -> Floats:
        """The sizes (D,) of the shift that are looked at, metres."""
        least, most, step = self.shifts_m
        return np.arange(least, most + 0.5 * step, step)


@dataclass(frozen=True, kw_only=True)
class HalvesEvidence:
    """Logarithms of the evidence of one stem, up to one constant, for S scales of shape, D shifts and P directions.

    ``whole`` (S,) is that of a stem of one piece, ``shifted`` (S, D, P, C) that of two halves, cut in one of C ways: in
    any direction (the first), or about one of ``ALIKE`` directions. ``square_m2`` (S, D, P, C) is the mean square, m^2,
    of the error that they make of the fitted radius.
    """

    whole: Floats
    shifted: Floats
    square_m2: Floats


def log_prior(settings: HalvesSettings | None = None) -> Floats:
    """Logarithm of how likely each of the C ways to be cut is, before a stem is seen."""
    s = settings or HalvesSettings()
    return np.asarray(np.log(np.concatenate([[1.0 - s.cut_alike], np.full(ALIKE, s.cut_alike / ALIKE)])))


def directions_rad() -> Floats:
    """The directions (P,) of a shift, counter-clockwise from x; the opposite ones are the same with halves swapped."""
    return np.pi * np.arange(DIRECTIONS) / DIRECTIONS


def evidence_of_halves(profile: SideProfile, *, settings: HalvesSettings | None = None) -> HalvesEvidence | None:
    """What the section of one stem says of halves that are apart; None where too little of it is seen."""
    s = settings or HalvesSettings()
    if profile.seen < s.min_sectors:
        return None
    angle = (np.arange(PROFILE_SECTORS) + 0.5) * 2.0 * np.pi / PROFILE_SECTORS - np.pi
    shape_std = np.repeat(AxisSettings().shape_std, 2) * profile.radius_m
    orders = range(1, AxisSettings().order + 1)
    design = np.column_stack([np.ones(len(angle)), *(wave(k * angle) for k in orders for wave in (np.cos, np.sin))])
    weight = _weights(profile, design, _prior(shape_std), s)
    weighted = design.T * weight
    halves = _halves(angle, s)
    sizes = s.sizes_m[:, None, None, None]
    # What the fit makes of a half: its mean goes into the radius.
    usual = np.linalg.inv(weighted @ design + np.diag(_prior(shape_std)))
    shape = (DIRECTIONS, len(s.half_widths_deg), MIDDLES)
    by_half = ((halves * weight) @ (design @ usual[:, 0])).reshape(shape)
    cuts = _cuts()
    whole, shifted, square = [], [], []
    for scale in s.shape_scales:
        prior = _prior(scale * shape_std)
        information = weighted @ design + np.diag(prior)
        found = weighted @ profile.mean_m
        whole.append(
            0.5 * float(found @ np.linalg.solve(information, found))
            + 0.5 * float(np.log(prior).sum())
            - 0.5 * float(np.linalg.slogdet(information)[1])
        )
        # With c integrated out, what is left of the sectors' precision.
        precision = np.diag(weight) - weighted.T @ np.linalg.solve(information, weighted)
        across = halves @ precision
        curvature = (across * halves).sum(axis=1).reshape(shape)
        slope = (across @ profile.mean_m).reshape(shape)
        gain = sizes * slope - 0.5 * sizes**2 * curvature
        most = np.maximum(gain.max(axis=(2, 3)), 0.0)[..., None]
        likely = np.exp(gain - most[..., None])
        total = s.one_part * np.exp(-most) + (1.0 - s.one_part) * likely.mean(axis=2) @ cuts
        shifted.append(whole[-1] + most + np.log(total))
        square.append((1.0 - s.one_part) * ((likely * (sizes * by_half) ** 2).mean(axis=2) @ cuts) / total)
    return HalvesEvidence(whole=np.array(whole), shifted=np.array(shifted), square_m2=np.array(square))


def _prior(shape_std: Floats) -> Floats:
    """One over the variances of mean, place and harmonics."""
    return np.concatenate([np.full(3, FREE), shape_std**-2.0])


def _weights(profile: SideProfile, design: Floats, prior: Floats, s: HalvesSettings) -> Floats:
    """One over the variance (K,) of each sector: the points' noise, and the bark's own unevenness."""
    seen = profile.precision > 0.0
    noise = 1.0 / np.maximum(profile.precision, 1e-12)
    uneven = s.furrow_m
    for _ in range(ROUNDS):
        weight = np.where(seen, 1.0 / (noise + uneven**2), 0.0)
        found = np.linalg.solve((design.T * weight) @ design + np.diag(prior), design.T @ (weight * profile.mean_m))
        off = (profile.mean_m - design @ found)[seen]
        uneven = max(MAD_TO_SIGMA * median(np.abs(off)), s.furrow_m)
    return np.where(seen, 1.0 / (s.noise_factor * (noise + uneven**2)), 0.0)


def _cuts() -> Floats:
    """Weights (MIDDLES, C) of the middles of a half in each way to be cut."""
    at = np.arange(MIDDLES)[:, None] - np.arange(ALIKE) * (MIDDLES // ALIKE)
    near = np.abs((at + MIDDLES // 2) % MIDDLES - MIDDLES // 2) <= BESIDE
    return np.column_stack([np.full(MIDDLES, 1.0 / MIDDLES), near / near.sum(axis=0)])


def _halves(angle: Floats, s: HalvesSettings) -> Floats:
    """How far out the bark lies in each sector for a shift of one: (P * W * M, K)."""
    middle = 2.0 * np.pi * np.arange(MIDDLES) / MIDDLES
    apart = np.abs(np.angle(np.exp(1j * (angle - middle[:, None]))))
    share = [1.0 / (1.0 + np.exp((apart - np.radians(width)) / np.radians(SEAM_DEG))) for width in s.half_widths_deg]
    along = np.cos(angle - directions_rad()[:, None])
    return np.asarray((along[:, None] * np.concatenate(share)[None]).reshape(-1, len(angle)))
