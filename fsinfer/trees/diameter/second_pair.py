"""Whether a second pair of sides of a stem has the same size: what edges alone have to show.

A photograph sees a stem end at two sides. A strip of bark, the border of a shadow or a twig before the stem has two
edges as well, and all photographs from about there agree on them. Seen from another direction they lie elsewhere, and
a stem does not. So the photographs are parted by the direction they look from: one part has to find the stem by itself,
with its own vote and fit, and the other, which had no say in it, has to have its edges where that fit puts them. A few
photographs with a pixel of a centimetre seldom tell a size by themselves, but they can refute one. A part knows little
of the stem's place along its own line of sight, which is what the other part sees across, and cameras stand a little
aside; both move the two sides by the same, so that the distance between them stays, and that is what counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fsinfer.trees.diameter.edge_set import Edges, chosen_edges
from fsinfer.trees.diameter.silhouette import SilhouetteFit, fit_silhouette
from fsinfer.trees.diameter.silhouette_settings import SilhouetteSettings

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


#: Steps in which the place of the stem across the other part's line of sight is looked for, metres. Source: numerics.
SHIFT_STEP_M = 0.004


@dataclass(frozen=True, kw_only=True)
class SecondPairSettings:
    """Constants of :func:`second_pair`.

    Attributes
    ----------
    min_apart_deg: between the mean directions of both parts, for a thin stem, so that it is seen from 60 degrees of its
        sides at least. Source: geometry, a false edge on the bark moves by half a radius then.
    least_apart_deg: for a thick one. A stem with something on its bark is thicker than that, so that it moves by more
        than its radius times the sine of the angle; where this is more than the place of a stem is looked for in,
        the other part cannot take it for the same. Source: geometry; 15 degrees are a quarter of the sides.
    weak_apart_deg: where both parts find the stem by themselves with ``min_share`` of the rays, so much is enough for
        half a support. Source: geometry, a strip on the bark of a stem twice as thick moves by a third of its own width
        at least.
    min_contrast: of each part, more than of the whole: a part of few rays has peaks of its own. Source: renders only,
        stems have 1.4 to 1.9.
    min_photos: in which the edges agree, in each part. Source: renders only, as for the stem itself but one less.
    reach_std: standard deviations within which an edge is where it should be. Source: statistics, 87 %.
    min_share: of the other part's rays that must have one there. Source: statistics, between the 87 % of a stem and the
        20 to 50 % that edges at random places reach.
    weak_share: with so many of them it is half a support. Source: statistics, more than edges at random places reach;
        renders only, one of the stems of the undergrown plot of seed 955027 has 0.67.
    both_std, both_share: where both parts find the stem by themselves, with radii that differ by so many standard
        deviations at most, this share of the rays is enough: two sizes that are found apart are seldom the same by
        chance, and a fit of few sides is bent where the others look. Source: statistics, 95 %; renders only, four of
        four such stems on three development plots are within 0.4 cm, with shares of 0.56 to 0.77.
    most_std: of the radius found, as a share of it: beyond, nothing is told. Source: statistics, a third of the range
        in which the vote looks.
    outer_shares: of the photographs, in order of their direction, that each part is made of: where most look from the
        middle, halves are near to each other and both ends are not. What is asked of the angle between parts grows as
        it does for photographs that are spread evenly, of which both ends tell no more than halves. Source: renders
        only, a stem of 9.1 cm seen in 70 photographs from three quarters of its sides, whose halves are 29 degrees
        apart and say 9.1 and 9.2 cm, had no diameter on the plot of seed 955034.
    min_outer_photos: in a part where those between are left out. Source: statistics, twice ``min_photos``: what is
        asked more often has to be surer.
    """

    min_apart_deg: float = 30.0
    least_apart_deg: float = 15.0
    weak_apart_deg: float = 20.0
    min_contrast: float = 1.3
    min_photos: int = 3
    reach_std: float = 1.5
    min_share: float = 0.7
    weak_share: float = 0.6
    both_std: float = 2.0
    both_share: float = 0.5
    most_std: float = 0.12
    outer_shares: tuple[float, ...] = (0.5, 0.35)
    min_outer_photos: int = 6


@dataclass(frozen=True, kw_only=True)
class SecondPair:
    """What two parts of the photographs say of each other; ``agree`` says whether it counts by itself.

    ``weak`` says that only the angle between them is too small for that, or the share of rays, and not by much: beside
    something else that has the size it counts, too.

    ``radii_m`` are those that each found by itself, None for nothing, ``shares`` the parts of the other's rays that
    have their edge there. ``apart_deg`` is the angle between the directions from which both look, of 90 at most:
    opposite photographs see the same two sides.
    """

    radii_m: tuple[float | None, float | None]
    shares: tuple[float, float]
    apart_deg: float
    agree: bool
    weak: bool = False


def second_pair(
    edges: Edges,
    radius_m: float,
    *,
    taper: float,
    silhouette: SilhouetteSettings | None = None,
    settings: SecondPairSettings | None = None,
) -> SecondPair:
    """Measure a stem whose radius is roughly ``radius_m`` twice, from two parts of the photographs of its edges.

    The parts are the halves of the photographs by their direction; where these do not agree, the outermost of them.
    """
    s = settings or SecondPairSettings()
    of_fit = replace(silhouette or SilhouetteSettings(), min_contrast=s.min_contrast)
    asked: list[SecondPair] = []
    for share in s.outer_shares:
        first, second, apart = _parted(edges, share)
        parts = [chosen_edges(edges, first), chosen_edges(edges, second)]
        if asked and min(len(np.unique(part.photo)) for part in parts) < s.min_outer_photos:
            break
        asked.append(_pair(parts, apart, (1.0 - share) / 0.5, radius_m, taper, of_fit, s))
        if asked[-1].agree:
            break
    return max(asked, key=lambda pair: (pair.agree, pair.weak))


def _pair(
    parts: Sequence[Edges],
    apart: float,
    stretch: float,
    radius_m: float,
    taper: float,
    of_fit: SilhouetteSettings,
    s: SecondPairSettings,
) -> SecondPair:
    """What two ``parts`` of the edges say of each other, ``apart`` degrees from each other.

    ``stretch`` is by how much evenly spread photographs would be farther apart in these parts than in halves.
    """
    fits = [fit_silhouette(part, radius_m, taper=taper, settings=of_fit) for part in parts]
    shares: list[float] = []
    for fit, other in zip(fits, parts[::-1], strict=True):
        sure = fit is not None and fit.photos >= s.min_photos and fit.std_m <= s.most_std * fit.radius_m
        shares.append(_share(fit, other, of_fit, s) if fit is not None and sure else 0.0)
    # What both found by themselves has to be the same.
    found = [share for share, fit in zip(shares, fits, strict=True) if fit is not None]
    same, least = _same_size(fits, s), min(found, default=0.0)
    enough = s.both_share if same else s.min_share
    needed = stretch * _needed_deg(fits, of_fit.place_range_m, s)
    agree = apart >= needed and bool(found) and least >= enough
    nearly_apart = same and apart >= stretch * s.weak_apart_deg and least >= s.min_share
    nearly_there = apart >= needed and bool(found) and least >= s.weak_share
    weak = not agree and (nearly_apart or nearly_there)
    first_m, second_m = (None if fit is None else fit.radius_m for fit in fits)
    return SecondPair(
        radii_m=(first_m, second_m), shares=(shares[0], shares[1]), apart_deg=apart, agree=agree, weak=weak
    )


def _needed_deg(fits: Sequence[SilhouetteFit | None], place_m: float, s: SecondPairSettings) -> float:
    """How far apart both parts have to look from: what is false must move by more than ``place_m``."""
    thinnest = min((fit.radius_m for fit in fits if fit is not None), default=0.0)
    moved_enough = np.degrees(np.arcsin(min(place_m / max(thinnest, place_m), 1.0)))
    return float(np.clip(moved_enough, s.least_apart_deg, s.min_apart_deg))


def _same_size(fits: Sequence[SilhouetteFit | None], s: SecondPairSettings) -> bool:
    """Whether both parts found a radius, and the same one."""
    one, other = fits
    if one is None or other is None:
        return False
    return abs(one.radius_m - other.radius_m) <= s.both_std * float(np.hypot(one.std_m, other.std_m))


def _share(fit: SilhouetteFit, other: Edges, of_fit: SilhouetteSettings, s: SecondPairSettings) -> float:
    """Share of the rays of ``other`` with an edge where ``fit`` puts it; none where they are of too few photographs."""
    if len(np.unique(other.photo)) < s.min_photos:
        return 0.0
    std = np.sqrt((of_fit.edge_std_px * other.pixel_m) ** 2 + of_fit.offset_m**2 + fit.noise_m**2 + fit.std_m**2)
    ray = np.unique(other.ray, return_inverse=True)[1]
    # Across the line of sight of the other part: the direction that its sides lie in.
    across = np.cos(other.angle_rad - 0.5 * np.angle(np.exp(2j * other.angle_rad).sum()))
    apart = other.support_m - fit.support(other.angle_rad, other.height_m)
    best = 0
    for shift in np.arange(-of_fit.place_range_m, of_fit.place_range_m + 1e-9, SHIFT_STEP_M):
        there = np.abs(apart - shift * across) <= s.reach_std * std
        best = max(best, len(np.unique(ray[there])))
    return best / (int(ray.max()) + 1)


def _parted(edges: Edges, share: float) -> tuple[Bools, Bools, float]:
    """Which edges (N,) belong to the first and to the last ``share`` of the photographs by direction; degrees between.

    Directions are those of the sides, a line and no arrow: opposite photographs have the same.
    """
    photos, which = np.unique(edges.photo, return_inverse=True)
    if len(photos) < 2:
        return np.ones(len(which), dtype=bool), np.zeros(len(which), dtype=bool), 0.0
    double = np.exp(2j * edges.angle_rad)
    sums = np.zeros(len(photos), dtype=np.complex128)
    np.add.at(sums, which, double)
    turn = np.angle(sums) % (2.0 * np.pi)  # twice the angle of the line
    order = np.argsort(turn)
    gaps = np.diff(np.r_[turn[order], turn[order[0]] + 2.0 * np.pi])
    order = np.roll(order, -(int(gaps.argmax()) + 1))
    count = max(int(share * len(order)), 1)
    # Halves of an odd number: the one in the middle is in the last.
    halves = [order[:count], order[-(len(order) - count if share == 0.5 else count) :]]
    mean = [np.exp(1j * turn[half]).sum() for half in halves]
    between = abs(float(np.angle(mean[0] * np.conj(mean[1]))))
    first, last = (np.isin(which, half) for half in halves)
    return first, last, float(np.degrees(between)) / 2.0
