"""Whether a second pair of sides of a stem has the same size: what edges alone have to show.

A photograph sees a stem end at two sides. A strip of bark, the border of a shadow or a twig before the stem has two
edges as well, and all photographs from about there agree on them. Seen from another direction they lie elsewhere, and
a stem does not. So the photographs are parted by the direction they look from, and each part has to find the stem by
itself: its own vote, its own fit, no start from the other. The sides move with the cameras by a pose error, but both
by the same, so that the distance between them stays.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsinfer.trees.diameter.silhouette import Edges, SilhouetteSettings, fit_silhouette

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class SecondPairSettings:
    """Constants of :func:`second_pair`.

    Attributes
    ----------
    min_apart_deg: between the mean directions of both parts, so that a stem is seen from 60 degrees of its sides at
        least. Source: geometry, a false edge on the bark moves by half a radius then.
    min_photos: in which the edges agree, in each part. Source: renders only, as for the stem itself but one less.
    gate: standard deviations between the two radii. Source: statistics, 95 %.
    most_std: of the difference, share of the radius: beyond, anything agrees. Source: statistics, a third of the range
        in which the vote looks.
    """

    min_apart_deg: float = 30.0
    min_photos: int = 3
    gate: float = 2.0
    most_std: float = 0.12


@dataclass(frozen=True, kw_only=True)
class SecondPair:
    """Radii (2) of the two parts of the photographs, None where one found nothing; ``agree`` says whether it counts.

    ``apart_deg`` is the angle between the directions from which both parts look, of 90 at most: opposite photographs
    see the same two sides.
    """

    radii_m: tuple[float | None, float | None]
    apart_deg: float
    agree: bool


def second_pair(
    edges: Edges,
    radius_m: float,
    *,
    taper: float,
    silhouette: SilhouetteSettings | None = None,
    settings: SecondPairSettings | None = None,
) -> SecondPair:
    """Measure a stem whose radius is roughly ``radius_m`` twice, from two parts of the photographs of its edges."""
    s = settings or SecondPairSettings()
    first, apart = _parted(edges)
    found = [fit_silhouette(_of(edges, part), radius_m, taper=taper, settings=silhouette) for part in (first, ~first)]
    radii = tuple(None if fit is None else fit.radius_m for fit in found)
    agree = apart >= s.min_apart_deg
    std2 = 0.0
    for fit in found:
        agree = agree and fit is not None and fit.photos >= s.min_photos
        std2 += 0.0 if fit is None else fit.std_m**2
    if agree:
        one, other = (float(radius) for radius in radii if radius is not None)
        std = float(np.sqrt(std2))
        agree = abs(one - other) <= s.gate * std and std <= s.most_std * 0.5 * (one + other)
    return SecondPair(radii_m=(radii[0], radii[1]), apart_deg=apart, agree=agree)


def _parted(edges: Edges) -> tuple[Bools, float]:
    """Which edges (N,) belong to the first half of the photographs, in order of their direction, and degrees between.

    Directions are those of the sides, a line and no arrow: opposite photographs have the same.
    """
    photos, which = np.unique(edges.photo, return_inverse=True)
    if len(photos) < 2:
        return np.ones(len(edges.photo), dtype=bool), 0.0
    double = np.exp(2j * edges.angle_rad)
    sums = np.zeros(len(photos), dtype=np.complex128)
    np.add.at(sums, which, double)
    turn = np.angle(sums) % (2.0 * np.pi)  # twice the angle of the line
    order = np.argsort(turn)
    gaps = np.diff(np.r_[turn[order], turn[order[0]] + 2.0 * np.pi])
    order = np.roll(order, -(int(gaps.argmax()) + 1))
    half = order[: len(order) // 2]
    mean = [np.exp(1j * turn[part]).sum() for part in (half, order[len(order) // 2 :])]
    between = abs(float(np.angle(mean[0] * np.conj(mean[1]))))
    first = np.zeros(len(photos), dtype=bool)
    first[half] = True
    return np.asarray(first[which]), float(np.degrees(between)) / 2.0


def _of(edges: Edges, chosen: Bools) -> Edges:
    return Edges(
        support_m=edges.support_m[chosen],
        angle_rad=edges.angle_rad[chosen],
        height_m=edges.height_m[chosen],
        strength=edges.strength[chosen],
        pixel_m=edges.pixel_m[chosen],
        ray=edges.ray[chosen],
        photo=edges.photo[chosen],
    )
