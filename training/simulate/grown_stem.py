"""Stems as they grow, by rules that the measurement does not share: form, root flare, flat sides, furrowed bark, sweep.

The measurement's model is a straight tapering stem whose section has three harmonics with Gaussian priors. Nothing of
that is assumed here: the radius follows a form exponent towards the tree's top, the foot has root lobes, the section
is flattened or dented on one side, bark is plates between furrows, and the axis bends. The truth is the girth of the
section's convex hull, which a tape reads.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class GrowthSpec:
    """Ranges (uniform) of what a stem is like; lengths in metres.

    ``form`` is the exponent b of r = R ((H - h) / (H - bh))^b, 0.5 a paraboloid and 1 a cone, ``height_of_dbh`` the
    tree's height H over its DBH; ``flare`` the root lobes' part of the radius at the ground and ``flare_fall_m`` how
    fast they end; ``oval_std`` the spread of the second harmonic; ``flat`` how deep the flat side or dent is, part of
    the radius, on a third of the stems; ``furrow`` the depth of furrows, part of the radius, ``furrow_apart_m`` their
    distance; ``lean_deg`` the lean, ``sweep_m`` how far the axis leaves its chord over two metres.
    """

    form: tuple[float, float] = (0.5, 1.1)
    height_of_dbh: tuple[float, float] = (45.0, 110.0)
    flare: tuple[float, float] = (0.0, 0.45)
    flare_fall_m: tuple[float, float] = (0.12, 0.35)
    oval_std: float = 0.016
    flat: tuple[float, float] = (0.0, 0.04)
    furrow: tuple[float, float] = (0.0, 0.03)
    furrow_apart_m: tuple[float, float] = (0.03, 0.07)
    lean_deg: tuple[float, float] = (0.0, 12.0)
    sweep_m: tuple[float, float] = (0.0, 0.03)


class GrownStem:
    """One stem about its foot; angles count round the axis, heights vertically from the foot."""

    def __init__(self, rng: np.random.Generator, dbh_m: float, bh_m: float, spec: GrowthSpec | None = None) -> None:
        s = spec or GrowthSpec()
        self.dbh_m, self.bh_m = dbh_m, bh_m
        self.lean_deg = float(rng.uniform(*s.lean_deg))
        azimuth = rng.uniform(0.0, 2.0 * np.pi)
        self._slope = np.tan(np.radians(self.lean_deg)) * np.array([np.cos(azimuth), np.sin(azimuth)])
        bend = rng.uniform(0.0, 2.0 * np.pi)
        # Over two metres a parabola c h^2 leaves its chord by c in the middle.
        self._bend = rng.uniform(*s.sweep_m) * np.array([np.cos(bend), np.sin(bend)])
        self._form = rng.uniform(*s.form)
        self._top_m = max(rng.uniform(*s.height_of_dbh) * dbh_m, 6.0)
        self._flare, self._fall = rng.uniform(*s.flare), rng.uniform(*s.flare_fall_m)
        self._roots, self._root_start = int(rng.integers(3, 7)), rng.uniform(0.0, 2.0 * np.pi)
        self._oval = abs(rng.normal(0.0, s.oval_std)) * np.sqrt(2.0)
        self._oval_at = rng.uniform(0.0, np.pi)
        self._flat = rng.uniform(*s.flat) if rng.random() < 1.0 / 3.0 else 0.0
        self._flat_at, self._flat_wide = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.5, 1.2)
        self._furrow = rng.uniform(*s.furrow)
        count = max(int(2.0 * np.pi * 0.5 * dbh_m / rng.uniform(*s.furrow_apart_m)), 5)
        self._furrows = (np.arange(count) + rng.uniform(-0.3, 0.3, count)) * 2.0 * np.pi / count
        self._wander = rng.uniform(0.1, 0.4), rng.uniform(0.3, 0.9), rng.uniform(0.0, 2.0 * np.pi)
        self._gap = 2.0 * np.pi / count

    def radius_at(self, angle: Floats, height: Floats) -> Floats:
        """Distance (N,) of the bark from the axis at angles and heights (N,)."""
        rise = np.clip(self._top_m - height, 0.1, None) / (self._top_m - self.bh_m)
        mean = 0.5 * self.dbh_m * rise**self._form
        lobes = 1.0 + 0.6 * np.cos(self._roots * angle - self._root_start)
        shape = 1.0 + self._flare * np.exp(-height / self._fall) * lobes
        shape = shape + self._oval * np.cos(2.0 * (angle - self._oval_at))
        off = np.abs(np.angle(np.exp(1j * (angle - self._flat_at))))
        shape = shape - self._flat * np.clip(1.0 - (off / self._flat_wide) ** 2, 0.0, None)
        return np.asarray(mean * (shape - self._furrow * self._depth(angle, height)))

    def _depth(self, angle: Floats, height: Floats) -> Floats:
        """1 (N,) in the middle of a furrow, 0 on the plates between."""
        share, length, start = self._wander
        moved = angle + share * self._gap * np.sin(2.0 * np.pi * height / length + start)
        off = np.abs(np.angle(np.exp(1j * (moved[:, None] - self._furrows)))).min(axis=1)
        return np.asarray(np.exp(-((off / (0.22 * self._gap)) ** 2)))

    def axis_at(self, height: Floats) -> Floats:
        """(N, 2) place of the axis over the foot."""
        return np.asarray(height[:, None] * self._slope + ((height - 1.0) ** 2 - 1.0)[:, None] * self._bend)

    def place(self, angle: Floats, height: Floats) -> Floats:
        """Points (N, 3) of the bark over the foot; sections are perpendicular to the chord of the axis."""
        first, second = self._across()
        radius = self.radius_at(angle, height)
        on_axis = np.column_stack([self.axis_at(height), height])
        return np.asarray(
            on_axis + (radius * np.cos(angle))[:, None] * first + (radius * np.sin(angle))[:, None] * second
        )

    def normals(self, angle: Floats) -> Floats:
        """Outward unit normals (N, 3) of the smooth stem."""
        first, second = self._across()
        return np.asarray(np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second)

    def _across(self) -> tuple[Floats, Floats]:
        along = np.array([*(self._slope + 2.0 * (self.bh_m - 1.0) * self._bend), 1.0])
        along /= np.linalg.norm(along)
        first = np.array([1.0, 0.0, 0.0]) - along[0] * along
        first /= np.linalg.norm(first)
        return first, np.cross(along, first)

    def tape_m(self) -> float:
        """What a tape reads at breast height: the girth of the section's convex hull over pi."""
        angle = np.linspace(0.0, 2.0 * np.pi, 1440, endpoint=False)
        radius = self.radius_at(angle, np.full(len(angle), self.bh_m))
        section = radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        return float(ConvexHull(section).area / np.pi)  # the "area" of a hull in the plane is its girth
