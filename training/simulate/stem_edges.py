"""Simulated edges of stems in photographs: what the interval of the edges is judged on.

A stem that grows by its own rules (:mod:`training.simulate.grown_stem`) is looked at by cameras on an arc. An edge is
where a ray grazes the hull of the section, and it is wrong by what photographs do, none of which the fit knows of:

- the cameras drift along their walk, which moves both edges of a photograph by the same;
- light from one side moves the edges of the bright and the dark side by parts of a pixel;
- on part of the directions something covers one side (a twig, a fern, a neighbour of the same bark): the edge that is
  seen there lies elsewhere, at about the same place in all photographs from there;
- the border of a shadow lies on the bark, at one angle of the stem, stronger than the true edge here and there;
- leaves and bark make edges anywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsinfer.trees.diameter.edge_set import Edges
from training.simulate.grown_stem import GrownStem, GrowthSpec

Floats = NDArray[np.float64]
#: Heights of the bands of a strip about breast height, metres.
BANDS_M = np.linspace(-0.2, 0.2, 6)


@dataclass(frozen=True, kw_only=True)
class EdgeSpec:
    """Ranges (uniform) over stems; metres, pixels, degrees."""

    dbh_m: tuple[float, float] = (0.08, 0.6)
    arc_deg: tuple[float, float] = (5.0, 360.0)
    photos: tuple[int, int] = (5, 30)
    distance_m: tuple[float, float] = (2.5, 10.0)
    pixels_per_m_at_1m: float = 900.0
    edge_px: float = 0.5
    drift_m: tuple[float, float] = (0.0, 0.004)
    light_px: tuple[float, float] = (0.0, 0.3)
    covered: float = 0.35
    cover_deg: tuple[float, float] = (20.0, 80.0)
    cover_m: tuple[float, float] = (-0.03, 0.05)
    shadow: float = 0.4
    junk: float = 1.5


@dataclass(frozen=True, kw_only=True)
class SimulatedEdges:
    """Edges of one stem, what a tape reads (metres), the radius known before, and the arc of the directions."""

    edges: Edges
    dbh_m: float
    known_m: float
    arc_deg: float


def simulate_edges(seed: int, spec: EdgeSpec | None = None) -> SimulatedEdges:
    """Simulate the edges of one stem; the same seed and spec give the same edges."""
    s = spec or EdgeSpec()
    rng = np.random.default_rng([seed, 11])
    stem = GrownStem(rng, float(rng.uniform(*s.dbh_m)), 1.3, GrowthSpec(lean_deg=(0.0, 0.0), sweep_m=(0.0, 0.0)))
    arc, count = float(rng.uniform(*s.arc_deg)), int(rng.integers(*s.photos))
    first = rng.uniform(0.0, 2.0 * np.pi)
    towards = first + np.radians(arc) * np.linspace(0.0, 1.0, count) + rng.normal(0.0, 0.02, count)
    distance = float(rng.uniform(*s.distance_m)) * rng.uniform(0.8, 1.25, count)
    drift = rng.uniform(*s.drift_m) * rng.normal(0.0, 1.0, (count, 2)).cumsum(axis=0) / np.sqrt(count)
    light, light_at = rng.uniform(*s.light_px), rng.uniform(0.0, 2.0 * np.pi)
    covered = rng.random() < s.covered
    cover_at, cover = rng.uniform(0.0, 2.0 * np.pi), np.radians(rng.uniform(*s.cover_deg))
    cover_m = rng.uniform(*s.cover_m)
    shadow_at = rng.uniform(0.0, 2.0 * np.pi) if rng.random() < s.shadow else None
    hulls = [_hull(stem, 1.3 + band) for band in BANDS_M]
    rows = []
    for photo, (direction, away) in enumerate(zip(towards, distance, strict=True)):
        pixel = away / s.pixels_per_m_at_1m
        for side, sign in enumerate((-1.0, 1.0)):
            # Right and left of the camera, turned towards it by the slant of the grazing ray.
            slant = np.arcsin(min(0.5 * stem.dbh_m / away, 0.9))
            angle = direction + sign * (0.5 * np.pi - slant)
            normal = np.array([np.cos(angle), np.sin(angle)])
            off = float(drift[photo] @ normal) + light * pixel * np.cos(angle - light_at)
            hidden = covered and abs(np.angle(np.exp(1j * (angle - cover_at)))) < 0.5 * cover
            for band, height in enumerate(BANDS_M):
                true = float((hulls[band] @ normal).max())
                ray = (photo * 2 + side) * len(BANDS_M) + band
                place = true + off + (cover_m if hidden else 0.0) + rng.normal(0.0, s.edge_px * pixel)
                rows.append((place, angle, height, rng.uniform(2.0, 12.0), pixel, ray, photo))
                if shadow_at is not None:
                    bark = 0.5 * stem.dbh_m * np.array([np.cos(shadow_at), np.sin(shadow_at)])
                    across = float(bark @ normal)
                    if across > 0.0 and np.cos(shadow_at - direction) > 0.0:
                        rows.append((across, angle, height, rng.uniform(2.0, 14.0), pixel, ray, photo))
                for _ in range(rng.poisson(s.junk)):
                    junk = rng.uniform(0.0, 0.8 * stem.dbh_m + 0.04)
                    rows.append((junk, angle, height, rng.uniform(1.2, 8.0), pixel, ray, photo))
    known = 0.5 * stem.dbh_m * rng.uniform(0.85, 1.25)
    return SimulatedEdges(edges=edges_from_rows(rows), dbh_m=stem.tape_m(), known_m=float(known), arc_deg=arc)


def edges_from_rows(rows: Sequence[Sequence[float]]) -> Edges:
    """Edges from rows of support (m), angle (rad), height (m), strength, pixel (m), ray and photo."""
    table = np.array(rows, dtype=np.float64)
    return Edges(
        support_m=table[:, 0],
        angle_rad=table[:, 1],
        height_m=table[:, 2],
        strength=table[:, 3],
        pixel_m=table[:, 4],
        ray=table[:, 5].astype(np.int64),
        photo=table[:, 6].astype(np.int64),
        own=np.ones(len(table), dtype=bool),
    )


def _hull(stem: GrownStem, height: float) -> Floats:
    """(N, 2) the bark at one height; the greatest of its products with a normal is the support."""
    angle = np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False)
    radius = stem.radius_at(angle, np.full(len(angle), height))
    return np.asarray(radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]))
