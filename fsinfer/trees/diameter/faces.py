"""Where the cloud has a stem's surface sharply, on sides of which no photograph shows an edge.

Edges lie to the right and left of those who look. A stem that is seen from one direction, or from there and the
opposite one, has none towards them, and its section is a guess there: one of 45 cm was given 1.7 cm too thin, with a
front 3.5 cm inside of the true one. But its front is what depth maps know best. Points of a sector that lie within
millimetres of each other are where the bark is to some millimetres; those of a hazy one are off by centimetres
(docs/trials-accuracy.md, "Sharp faces").

A sector counts where the opposite one is known too, by edges or as sharp a face: the girth is made of widths (Cauchy),
and one side of a width says where the stem stands and nothing of its size.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsinfer.trees.diameter.sides import NOISE_SECTORS
from fsinfer.trees.points.sums import MAD_TO_SIGMA, median

Floats = NDArray[np.float64]

#: Degrees of a sector. Source: mathematics.
SECTOR_DEG = 360.0 / NOISE_SECTORS


@dataclass(frozen=True, kw_only=True)
class FaceSettings:
    """Constants of :func:`sharp_faces` and of what the fit makes of them; lengths in metres.

    "Six plots": renders only, 74 stems of the plots of seeds 955025 to 955030 (docs/trials-accuracy.md).

    Attributes
    ----------
    half_length_m: of the piece of stem about breast height. Source: as the strips of the photographs.
    window_m, window_share: points count so far from the surface that the edges have, and at most that share of the
        radius. Source: judgement, three times what edges were off by on a side that they do not see.
    min_points: of a sector. Source: statistics, their median is known to a third of their scatter.
    sharp_m: greatest scatter of a sector. Source: renders only, six plots and that of seed 955036
        (docs/trials-accuracy.md, "Sharp faces"): those within 0.4 cm have their medians within 0.3 to 0.5 cm of the
        hull (rms) on four and within 0.9 and 1.3 cm on two, where parts of the walk do not stand where they should;
        from 0.4 to 0.6 cm as limit nothing changes on the six, and one oval stem of the seventh is half as wrong.
    own_std_m: what a sector's median is off by beside its scatter. Source: six plots.
    alike_std_m: what all of them are off by together: outwards, to one side (two parts of the walk do not stand where
        they should), and as an oval. Source: six plots; from 0.2 to 0.4 cm outwards and as an oval nothing
        changes but the intervals.
    hull_share: the hull lies outside of the median of the bark by this share of the radius. Source: renders only, true
        sections of 955030: 0.6 to 0.8 % in each of four classes of diameter.
    """

    half_length_m: float = 0.25
    window_m: float = 0.12
    window_share: float = 0.8
    min_points: int = 10
    sharp_m: float = 0.006
    own_std_m: float = 0.003
    alike_std_m: tuple[float, ...] = (0.004, 0.01, 0.01, 0.004, 0.004)
    hull_share: float = 0.007


@dataclass(frozen=True, kw_only=True)
class Faces:
    """The surface in M sectors about the axis that the edges count from: the median of the points there.

    ``support_m`` (M,) is its distance from the axis along the outward normal ``angle_rad`` (M,), ``std_m`` (M,) the
    standard deviation of its own error. What they err by together is in the fit
    (:class:`fsinfer.trees.diameter.edge_problem.EdgeProblem`).
    """

    angle_rad: Floats
    support_m: Floats
    std_m: Floats

    @property
    def sector(self) -> NDArray[np.int64]:
        """(M,) index of the sector."""
        return sector_of_angle(self.angle_rad)


def sector_of_angle(angle_rad: Floats) -> NDArray[np.int64]:
    """Index (N,) of the sector in which each of the angles (N,) lies."""
    return np.asarray(np.floor(np.degrees(angle_rad) / SECTOR_DEG).astype(np.int64) % NOISE_SECTORS)


@dataclass(frozen=True, kw_only=True)
class SupportFunction:
    """Support function of a leaning, tapered stem about an axis: what a silhouette's fit knows of it; metres.

    ``shift_m`` (2,) and ``slope`` (2,) are of its own axis, ``shape_m`` cosine and sine of the harmonics 2, 3, ...
    """

    radius_m: float
    taper: float
    shift_m: Floats
    slope: Floats
    shape_m: Floats

    def at(self, angle_rad: Floats, height_m: Floats) -> Floats:
        """Distance (N,) of the tangent with outward normal ``angle_rad`` (N,) from the axis, at ``height_m`` (N,)."""
        place = self._place(height_m)
        own = self._own(angle_rad)[0] + self.taper * height_m
        return np.asarray(own + place[:, 0] * np.cos(angle_rad) + place[:, 1] * np.sin(angle_rad))

    def normals_at(self, offsets_m: Floats, height_m: Floats) -> Floats:
        """Angle (N,) of the outward normal where the section is in the direction of ``offsets_m`` (N, 2).

        The point of a convex curve with normal angle t lies at t + atan(p'(t) / p(t)) (Santalo 2004, section 1.2);
        both are taken at the point's own direction, which is right to second order.
        """
        from_middle = offsets_m - self._place(height_m)
        direction = np.arctan2(from_middle[:, 1], from_middle[:, 0])
        own, slope = self._own(direction)
        return np.asarray(direction - np.arctan2(slope, own))

    def _place(self, height_m: Floats) -> Floats:
        return np.asarray(self.shift_m + height_m[:, None] * self.slope)

    def _own(self, angle_rad: Floats) -> tuple[Floats, Floats]:
        """Support function (N,) about the stem's own middle, and its derivative."""
        value, slope = np.full(len(angle_rad), self.radius_m), np.zeros(len(angle_rad))
        for number, (cosine, sine) in enumerate(self.shape_m.reshape(-1, 2)):
            order = number + 2
            turn = order * angle_rad
            value += cosine * np.cos(turn) + sine * np.sin(turn)
            slope += order * (sine * np.cos(turn) - cosine * np.sin(turn))
        return value, slope


def sharp_faces(
    offsets_m: Floats,
    height_m: Floats,
    support: SupportFunction,
    seen: NDArray[np.bool_],
    *,
    settings: FaceSettings | None = None,
) -> Faces | None:
    """The sharp sectors of a stem that the edges do not see; None where there are none.

    Parameters
    ----------
    offsets_m: (N, 2) points within ``half_length_m`` of breast height from the axis, along its two directions across.
    height_m: (N,) along it.
    support: the section that the edges gave, with its place, slope and taper.
    seen: (24,) whether the edges see the sector.
    """
    s = settings or FaceSettings()
    angle = support.normals_at(offsets_m, height_m)
    outside = (offsets_m * np.column_stack([np.cos(angle), np.sin(angle)])).sum(axis=1) - support.at(angle, height_m)
    inside = np.abs(outside) < min(s.window_m, s.window_share * support.radius_m)
    sector = sector_of_angle(angle)
    scatter, middle = np.full(NOISE_SECTORS, np.inf), np.zeros(NOISE_SECTORS)
    for number in np.flatnonzero(~seen):
        own = outside[inside & (sector == number)]
        if len(own) >= s.min_points:
            middle[number] = median(own)
            scatter[number] = MAD_TO_SIGMA * median(np.abs(own - middle[number]))
    sharp = scatter <= s.sharp_m
    known = sharp | seen
    used = np.flatnonzero(sharp & np.roll(known, NOISE_SECTORS // 2))
    if len(used) == 0:
        return None
    at = np.radians(SECTOR_DEG * (used + 0.5))
    return Faces(
        angle_rad=at,
        support_m=support.at(at, np.zeros(len(at))) + middle[used],
        std_m=np.hypot(s.own_std_m, scatter[used]),
    )
