"""The diameter of a stem from the edges at which photographs see it end against what lies behind.

A ray that grazes a convex section at outward normal angle t is at distance p(t) from the stem's axis: p is the
section's support function, and the girth of the section's hull is the integral of p over all t (Cauchy). What a
diameter tape reads is thus twice the mean of p. With the axis's place and slope, the taper and the harmonics 2 to 4 of
the section as unknowns, every edge is one linear equation:

    p = r + taper h + (a + u h) cos t + (b + v h) sin t + sum_k (c_k cos kt + s_k sin kt)

Edges are found without knowing which of them belong to the stem. The true stem is where the edges of many photographs
agree: a vote over radius and place starts the fit, expectation-maximisation with a background class refines it. Depth
maps blur a stem seen from 10 m by centimetres; its edges in the photographs are as sharp there as a pixel, 1 cm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class SilhouetteSettings:
    """Constants of :func:`fit_silhouette`; lengths in metres."""

    radius_range: tuple[float, float] = (0.6, 1.5)  # of the radius known before, which may come from a haze
    radius_step_m: float = 0.004
    place_range_m: float = 0.04
    place_step_m: float = 0.01
    vote_std_m: float = 0.012
    tolerances_m: tuple[float, ...] = (0.012, 0.008, 0.006, 0.005, 0.004)  # of the first rounds; then what was found
    rounds: int = 12
    starts: int = 3  # peaks of the vote that are followed up
    round_first: float = 10.0  # harmonics are held this much tighter in the first rounds
    place_std_m: float = 0.05  # priors: where the cloud has the axis ...
    slope_std: float = 0.03
    taper_std: float = 0.006  # ... radius per metre of height
    # Harmonics 2, 3, 4, part of the radius: half as much again as in the cloud's fit, for the hull of rough bark.
    # Chosen with common_px so that intervals of stems seen from one side hold the truth on rendered plots.
    shape_std: tuple[float, ...] = (0.024, 0.012, 0.006)
    edge_std_px: float = 0.5  # of one edge in one band
    background: float = 0.13  # likelihood of "none of these is the stem's edge", against an edge of strength 1
    min_contrast: float = 1.3  # votes of the best radius over those of the median one; 1.4 to 1.9 on rendered stems
    least_noise_m: float = 0.001
    sector_deg: float = 15.0  # edges seen under about the same angle err together: bark is no smooth curve
    common_px: float = 0.08  # what all edges share (blur, light from one side, undistortion), typical pixels
    common_std: float = 0.003  # of the radius: what a few harmonics do not describe
    min_edges: int = 8  # rays; twice the unknowns that no prior holds
    min_share: float = 0.5  # of the rays that must agree on the stem


@dataclass(frozen=True, kw_only=True)
class Edges:
    """Candidate edges near one stem, N of them, about the axis that the cloud's fit gave.

    Attributes
    ----------
    support_m: (N,) distance of the viewing ray from the axis, towards ``angle_rad``.
    angle_rad: (N,) direction of the outward normal in the plane across the axis.
    height_m: (N,) along the axis, about breast height.
    strength: (N,) of the edge, in standard deviations of what the bark itself shows.
    pixel_m: (N,) one pixel of the photograph at the stem.
    ray: (N,) number of photograph, side and band: of those with the same number at most one is the stem's edge.
    photo: (N,) index of the photograph in the scene.
    """

    support_m: Floats
    angle_rad: Floats
    height_m: Floats
    strength: Floats
    pixel_m: Floats
    ray: Ints
    photo: Ints


@dataclass(frozen=True, kw_only=True)
class SilhouetteFit:
    """What the edges say of one stem, at the height about which ``Edges.height_m`` counts; metres.

    ``radius_m`` is the girth over 2 pi with its standard deviation ``std_m``; ``shift_m`` (2,) and ``slope`` (2,) what
    the axis is moved and turned by; ``shape_m`` cosine and sine of the harmonics of the support function; ``rays`` how
    many rays carry the stem's edge and ``share`` their part of all; ``photos`` how many photographs they come from;
    ``sectors`` the part of the directions round the stem that they cover; ``noise_m`` the scatter of an edge.
    ``weight`` (N,) is each candidate's probability of being the stem's edge.
    """

    radius_m: float
    std_m: float
    shift_m: Floats
    slope: Floats
    taper: float
    shape_m: Floats
    rays: float
    share: float
    photos: int
    sectors: float
    noise_m: float
    contrast: float
    weight: Floats

    def support(self, angle_rad: Floats, height_m: Floats | float = 0.0) -> Floats:
        """Return the support function at normal angles (N,) and heights about the axis of the cloud's fit."""
        p = np.r_[self.radius_m, self.taper, self.shift_m, self.slope, self.shape_m]
        return np.asarray(
            _design(angle_rad, np.broadcast_to(height_m, np.shape(angle_rad)), len(self.shape_m) // 2) @ p
        )


def fit_silhouette(
    edges: Edges, radius_m: float, *, taper: float = -0.006, settings: SilhouetteSettings | None = None
) -> SilhouetteFit | None:
    """Fit the support function of a stem whose radius is roughly ``radius_m``; None where the edges do not agree."""
    s = settings or SilhouetteSettings()
    if len(np.unique(edges.ray)) < s.min_edges:
        return None
    problem = _Problem(edges, radius_m, taper, s)
    starts, contrast = problem.vote()
    if contrast < s.min_contrast:
        return None
    best = max((problem.refine(start) for start in starts), key=lambda solution: solution.log_likelihood)
    weight, used = best.weight, best.weight > 0.5
    if used.sum() < s.min_edges or weight.sum() < s.min_share * problem.rays:
        return None
    all_round = round(360.0 / s.sector_deg)
    sector = np.floor(np.degrees(edges.angle_rad[used]) / s.sector_deg).astype(np.int64) % all_round
    variance = _clustered_variance(best.information, best.scores[used], sector, problem.prior)
    common_px = s.common_px * float(np.median(edges.pixel_m[used]))
    x = best.x
    return SilhouetteFit(
        radius_m=float(x[0]),
        std_m=float(np.sqrt(variance + common_px**2 + (s.common_std * x[0]) ** 2)),
        shift_m=x[2:4],
        slope=x[4:6],
        taper=float(x[1]),
        shape_m=x[6:],
        rays=float(weight.sum()),
        share=float(weight.sum()) / problem.rays,
        photos=len(np.unique(edges.photo[used])),
        sectors=len(np.unique(sector)) / all_round,
        noise_m=best.noise_m,
        contrast=contrast,
        weight=weight,
    )


def edge_contrast(
    edges: Edges, radius_m: float, *, taper: float = -0.006, settings: SilhouetteSettings | None = None
) -> float:
    """How much better the edges agree on one radius than on any: 1.4 to 1.9 for stems, below 1.1 where there is none.

    NaN without edges.
    """
    if len(edges.ray) == 0:
        return float("nan")
    return _Problem(edges, radius_m, taper, settings or SilhouetteSettings()).vote()[1]


@dataclass(frozen=True, kw_only=True)
class _Solution:
    """Unknowns ``x`` (K,), each edge's probability ``weight`` (N,) and gradient ``scores`` (N, K)."""

    x: Floats
    weight: Floats
    scores: Floats
    information: Floats
    noise_m: float
    log_likelihood: float


class _Problem:
    """The edges of one stem with what both steps of the fit need of them."""

    def __init__(self, edges: Edges, radius_m: float, taper: float, settings: SilhouetteSettings) -> None:
        s = self.s = settings
        self.edges, self.radius_m, self.taper = edges, radius_m, taper
        self.ray = np.asarray(np.unique(edges.ray, return_inverse=True)[1], dtype=np.int64)
        self.rays = int(self.ray.max()) + 1
        self.log_strength = np.log(np.maximum(edges.strength, 1.0))
        self.pixel = s.edge_std_px * edges.pixel_m
        self.design = _design(edges.angle_rad, edges.height_m, len(s.shape_std))
        shape = np.repeat(np.array(s.shape_std) * radius_m, 2)
        self.prior = 1.0 / np.r_[np.inf, s.taper_std, [s.place_std_m] * 2, [s.slope_std] * 2, shape] ** 2
        self.prior_mean = np.zeros(len(self.prior))
        self.prior_mean[1] = taper

    def vote(self) -> tuple[list[Floats], float]:
        """Radius and place (3,) where the most rays have a strong edge: the best few radii, each at its best place.

        Also the votes of the first over those of a typical radius.
        """
        s, edges = self.s, self.edges
        level = edges.support_m - self.taper * edges.height_m
        std = np.hypot(s.vote_std_m, self.pixel)
        shifts = np.arange(-s.place_range_m, s.place_range_m + 1e-9, s.place_step_m)
        order = np.argsort(self.ray, kind="stable")
        first = np.searchsorted(self.ray[order], np.arange(self.rays))
        cosine, sine = np.cos(edges.angle_rad), np.sin(edges.angle_rad)
        low, high = s.radius_range
        radii = np.arange(low * self.radius_m, high * self.radius_m + 0.02, s.radius_step_m)
        tops, places = np.zeros(len(radii)), np.zeros((len(radii), 2))
        for i, radius in enumerate(radii):
            for a in shifts:
                # (len(shifts), N): all places along the second axis at once
                residual = level - radius - a * cosine - shifts[:, None] * sine
                score = self.log_strength * np.exp(-0.5 * (residual / std) ** 2)
                votes = np.maximum.reduceat(score[:, order], first, axis=1).sum(axis=1)
                if votes.max() > tops[i]:
                    tops[i], places[i] = votes.max(), (a, shifts[votes.argmax()])
        peaks = [i for i in range(len(radii)) if tops[i] >= max(tops[max(i - 1, 0) : i + 2])]
        peaks = sorted(peaks, key=lambda i: -tops[i])[: s.starts]
        contrast = float(tops.max()) / max(float(np.median(tops)), 1e-9)
        return [np.array([radii[i], *places[i]]) for i in peaks], contrast

    def refine(self, start: Floats) -> _Solution:
        """Expectation-maximisation from ``start`` (radius and place), first round, then with harmonics."""
        s, edges, design = self.s, self.edges, self.design
        x = self.prior_mean.copy()
        x[[0, 2, 3]] = start
        noise = s.least_noise_m
        for turn in range(s.rounds):
            early = turn < len(s.tolerances_m)
            std = np.hypot(self.pixel, s.tolerances_m[turn] if early else noise)
            weight, log_likelihood = self._responsibility(self._log_fit(x, std))
            precision = weight / std**2
            prior = self.prior.copy()
            if early:  # harmonics would bend a wrong circle through a few edges
                prior[6:] *= s.round_first**2
            information = (design * precision[:, None]).T @ design + np.diag(prior)
            x = np.linalg.solve(information, design.T @ (precision * edges.support_m) + prior * self.prior_mean)
            residual = edges.support_m - design @ x
            excess = float((weight * (residual**2 - self.pixel**2)).sum()) / max(float(weight.sum()) - 4.0, 1.0)
            noise = float(np.sqrt(max(excess, s.least_noise_m**2)))
        # Starts are compared at one tolerance: a larger noise must not look like a better fit.
        _, log_likelihood = self._responsibility(self._log_fit(x, np.hypot(self.pixel, s.tolerances_m[-1])))
        return _Solution(
            x=x,
            weight=weight,
            scores=design * (precision * residual)[:, None],
            information=information,
            noise_m=noise,
            log_likelihood=log_likelihood,
        )

    def _log_fit(self, x: Floats, std: Floats) -> Floats:
        return np.asarray(self.log_strength - 0.5 * ((self.edges.support_m - self.design @ x) / std) ** 2)

    def _responsibility(self, log_fit: Floats) -> tuple[Floats, float]:
        """Probability (N,) that a candidate is the stem's edge, at most one on each ray or none; and the likelihood."""
        none = float(np.log(self.s.background))
        top = np.full(self.rays, none)
        np.maximum.at(top, self.ray, log_fit)
        total = np.exp(none - top)
        part = np.exp(log_fit - top[self.ray])
        np.add.at(total, self.ray, part)
        return np.asarray(part / total[self.ray]), float((top + np.log(total)).sum())


def _design(angle: Floats, height: Floats, order: int) -> Floats:
    """(N, 6 + 2 * order) coefficients of radius, taper, place, slope and harmonics 2, 3, ..."""
    cosine, sine = np.cos(angle), np.sin(angle)
    columns = [np.ones_like(angle), height, cosine, sine, height * cosine, height * sine]
    for k in range(2, 2 + order):
        columns += [np.cos(k * angle), np.sin(k * angle)]
    return np.column_stack(columns)


def _clustered_variance(information: Floats, scores: Floats, sector: Ints, prior: Floats) -> float:
    """Variance of the radius where edges of one sector err together (Liang & Zeger 1986), or the model's if larger."""
    covariance = np.linalg.inv(information)
    names, cluster = np.unique(sector, return_inverse=True)
    sums = np.zeros((len(names), scores.shape[1]))
    np.add.at(sums, cluster, scores)
    few = len(names) / max(len(names) - 3.0, 1.0)  # radius and place are taken from the sectors
    meat = few * sums.T @ sums + np.diag(prior)
    return max(float(covariance[0] @ meat @ covariance[0]), float(covariance[0, 0]))
