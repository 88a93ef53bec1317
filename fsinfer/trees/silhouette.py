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
    rounds: int = 10
    place_std_m: float = 0.05  # priors: where the cloud has the axis ...
    slope_std: float = 0.03
    taper_std: float = 0.006  # ... radius per metre of height
    shape_std: tuple[float, ...] = (0.016, 0.008, 0.004)  # harmonics 2, 3, 4, part of the radius, as in the cloud's fit
    edge_std_px: float = 0.5  # of one edge in one band
    background: float = 0.13  # likelihood of "none of these is the stem's edge", against an edge of strength 1
    min_contrast: float = 1.3  # votes of the best radius over those of the median one; 1.4 to 1.9 on rendered stems
    least_noise_m: float = 0.001
    sector_deg: float = 15.0  # edges seen under about the same angle err together: bark is no smooth curve
    common_px: float = (
        0.06  # what all edges share (blur, light from one side, undistortion), pixels of the typical photo
    )
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
    strength: (N,) edge strength over the median of its photograph's strip; at least 1.
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
    if len(edges.ray) == 0:
        return None
    _, ray = np.unique(edges.ray, return_inverse=True)
    rays = int(ray.max()) + 1
    if rays < s.min_edges:
        return None
    log_strength = np.log(np.maximum(edges.strength, 1.0))
    order = len(s.shape_std)
    design = _design(edges.angle_rad, edges.height_m, order)
    pixel = s.edge_std_px * edges.pixel_m
    x = np.zeros(design.shape[1])
    x[1] = taper
    x[[0, 2, 3]], contrast = _vote(edges, log_strength, ray, rays, radius_m, taper, s)
    if contrast < s.min_contrast:
        return None
    prior_mean = np.zeros(len(x))
    prior_mean[1] = taper
    shape = np.repeat(np.array(s.shape_std) * radius_m, 2)
    prior = 1.0 / np.r_[np.inf, s.taper_std, [s.place_std_m] * 2, [s.slope_std] * 2, shape] ** 2
    noise = s.tolerances_m[0]
    weight, information = np.zeros(len(ray)), np.diag(prior)
    for turn in range(s.rounds):
        tolerance = s.tolerances_m[turn] if turn < len(s.tolerances_m) else max(noise, s.least_noise_m)
        std = np.hypot(pixel, tolerance)
        weight = _responsibility(log_strength - 0.5 * ((edges.support_m - design @ x) / std) ** 2, ray, rays, s)
        precision = weight / std**2
        information = (design * precision[:, None]).T @ design + np.diag(prior)
        x = np.linalg.solve(information, (design * precision[:, None]).T @ edges.support_m + prior * prior_mean)
        residual = edges.support_m - design @ x
        excess = float((weight * (residual**2 - pixel**2)).sum()) / max(float(weight.sum()) - 4.0, 1.0)
        noise = float(np.sqrt(max(excess, s.least_noise_m**2)))
    used = weight > 0.5
    if used.sum() < s.min_edges or weight.sum() < s.min_share * rays:
        return None
    sector = np.floor(np.degrees(edges.angle_rad) / s.sector_deg).astype(np.int64) % round(360.0 / s.sector_deg)
    scores = design * (precision * residual)[:, None]
    variance = _clustered_variance(information, scores, sector[used], used, prior)
    typical_px = float(np.median(edges.pixel_m[used]))
    std_m = float(np.sqrt(variance + (s.common_px * typical_px) ** 2 + (s.common_std * x[0]) ** 2))
    return SilhouetteFit(
        radius_m=float(x[0]),
        std_m=std_m,
        shift_m=x[2:4],
        slope=x[4:6],
        taper=float(x[1]),
        shape_m=x[6:],
        rays=float(weight.sum()),
        share=float(weight.sum()) / rays,
        photos=len(np.unique(edges.photo[used])),
        sectors=len(np.unique(sector[used])) / round(360.0 / s.sector_deg),
        noise_m=noise,
        contrast=contrast,
        weight=weight,
    )


def _design(angle: Floats, height: Floats, order: int) -> Floats:
    """(N, 6 + 2 * order) coefficients of radius, taper, place, slope and harmonics 2, 3, ..."""
    cosine, sine = np.cos(angle), np.sin(angle)
    columns = [np.ones_like(angle), height, cosine, sine, height * cosine, height * sine]
    for k in range(2, 2 + order):
        columns += [np.cos(k * angle), np.sin(k * angle)]
    return np.column_stack(columns)


def _vote(
    edges: Edges, log_strength: Floats, ray: Ints, rays: int, radius_m: float, taper: float, s: SilhouetteSettings
) -> tuple[Floats, float]:
    """Radius and place (3,) at which the most rays have a strong edge, and its votes over those of a typical radius."""
    level = edges.support_m - taper * edges.height_m
    std = np.hypot(s.vote_std_m, s.edge_std_px * edges.pixel_m)
    shifts = np.arange(-s.place_range_m, s.place_range_m + 1e-9, s.place_step_m)
    low, high = s.radius_range
    best = (-np.inf, np.array([radius_m, 0.0, 0.0]))
    tops = []
    order = np.argsort(ray, kind="stable")
    starts = np.searchsorted(ray[order], np.arange(rays))
    cosine, sine = np.cos(edges.angle_rad), np.sin(edges.angle_rad)
    for radius in np.arange(low * radius_m, high * radius_m + 0.02, s.radius_step_m):
        tops.append(0.0)
        for a in shifts:
            # (len(shifts), N): all places along the second axis at once
            residual = level - radius - a * cosine - shifts[:, None] * sine
            score = log_strength * np.exp(-0.5 * (residual / std) ** 2)
            votes = np.maximum.reduceat(score[:, order], starts, axis=1).sum(axis=1)
            top = int(votes.argmax())
            tops[-1] = max(tops[-1], float(votes[top]))
            if votes[top] > best[0]:
                best = (float(votes[top]), np.array([radius, a, shifts[top]]))
    return best[1], best[0] / float(np.median(tops))


def _responsibility(log_likelihood: Floats, ray: Ints, rays: int, s: SilhouetteSettings) -> Floats:
    """Probability (N,) that a candidate is the stem's edge: at most one on each ray, or none."""
    none = float(np.log(s.background))
    top = np.full(rays, none)
    np.maximum.at(top, ray, log_likelihood)
    total = np.exp(none - top)
    likelihood = np.exp(log_likelihood - top[ray])
    np.add.at(total, ray, likelihood)
    return np.asarray(likelihood / total[ray])


def _clustered_variance(
    information: Floats, scores: Floats, sector: Ints, used: NDArray[np.bool_], prior: Floats
) -> float:
    """Variance of the radius where edges of one sector err together (Liang & Zeger 1986), or the model's if larger."""
    covariance = np.linalg.inv(information)
    names, cluster = np.unique(sector, return_inverse=True)
    sums = np.zeros((len(names), scores.shape[1]))
    np.add.at(sums, cluster, scores[used])
    few = len(names) / max(len(names) - 3.0, 1.0)  # radius and place are taken from the sectors
    meat = few * sums.T @ sums + np.diag(np.where(np.isfinite(prior), prior, 0.0))
    return max(float(covariance[0] @ meat @ covariance[0]), float(covariance[0, 0]))
