"""Simulated clouds as a walk sees them: the second generator, whose errors are not those that the measurement assumes.

:mod:`training.simulate.stem_cloud` draws from the noise model of the measurement (a Gaussian with an outward tail,
the same all round), so an interval that holds there only shows that the arithmetic is right. Here stems grow by other
rules (:mod:`training.simulate.grown_stem`) and points come from stations along a walk:

- a station sees the bark that faces it and that no other stem hides; far stems and grazing sides get fewer points;
- the error lies along the viewing ray, grows with the distance (depth maps) or not (scanners), has heavy tails
  (Student's t with 4 degrees of freedom) and a haze before and behind the bark, log-normal, thicker at grazing;
- every station's depth map is off by a smooth bias over each stem;
- stations drift along the walk, and some walks are torn: the two halves lie centimetres apart (double walls).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from training.simulate.grown_stem import GrownStem, GrowthSpec
from training.simulate.stem_cloud import StemCloud, StemTruth
from training.simulate.surroundings import Parts, Terrain, ground_points, positions, shrub

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
KINDS = ("walked-photo", "walked-lidar")
#: Directions round a stem in which is looked whether a station sees it.
SIDES = 72
#: What makes a class: seen degrees below and above, DBH in metres, lean in degrees, metres to the nearest station.
HALF_DEG, ALL_DEG, THIN_M, LEANS_DEG, FAR_M = 250.0, 300.0, 0.15, 7.0, 6.0


@dataclass(frozen=True, kw_only=True)
class WalkSpec:
    """What to simulate; lengths in metres, ranges uniform over plots unless said.

    ``noise_m`` is the standard deviation of a point 4 m away, ``noise_power`` how it grows with the distance; ``haze``
    the share of points that float, ``bias_of_noise`` each station's smooth bias; ``drift_m`` the random walk of the
    stations' places over the whole walk, ``torn`` the share of plots whose walk is torn and ``tear_m`` by how much.
    ``ring`` is the share of plots that were walked round, ``past`` that of those that one line passes; the others were
    walked along one side and back through the middle.
    """

    kind: str = "walked-photo"
    trees: int = 22
    bh_m: float = 1.3
    dbh_m: tuple[float, float] = (0.08, 0.65)
    min_gap_m: float = 0.5
    area_per_tree_m2: float = 7.0
    spacing_m: tuple[float, float] = (0.009, 0.022)
    top_m: float = 3.6
    slope_deg: tuple[float, float] = (0.0, 20.0)
    bumps_m: tuple[float, float] = (0.0, 0.10)
    shrubs_per_tree: float = 0.6
    stations: int = 48
    reach_m: float = 14.0
    noise_m: tuple[float, float] = (0.003, 0.009)
    noise_power: float = 1.5
    haze: tuple[float, float] = (0.02, 0.10)
    bias_of_noise: tuple[float, float] = (0.1, 0.5)
    drift_m: tuple[float, float] = (0.0, 0.006)
    torn: float = 0.12
    tear_m: tuple[float, float] = (0.02, 0.05)
    ring: float = 0.4
    past: float = 0.35
    growth: GrowthSpec = field(default_factory=GrowthSpec)


def simulate_walk(seed: int, spec: WalkSpec | None = None) -> StemCloud:
    """Simulate one plot; the same seed and spec give the same cloud.

    The classes are tags of each stem: ``all round``, ``half hidden``, ``thin``, ``leaning``, ``far``, ``double wall``.
    """
    spec = spec or WalkSpec()
    if spec.kind not in KINDS:
        msg = f"kind must be one of {', '.join(KINDS)}, got {spec.kind!r}"
        raise ValueError(msg)
    rng = np.random.default_rng([seed, 7, KINDS.index(spec.kind)])
    size = float(np.sqrt(spec.trees * spec.area_per_tree_m2))
    spacing = float(rng.uniform(*spec.spacing_m))
    ground = Terrain(rng, size, slope_deg=spec.slope_deg, bumps_m=spec.bumps_m)
    # Thin stems are as many as thick ones are few: the square root of a uniform draw turned round.
    low, high = spec.dbh_m
    dbh = low + (high - low) * rng.random(spec.trees) ** 1.4
    feet = positions(rng, dbh, size, min_gap_m=spec.min_gap_m)
    stems = [GrownStem(rng, d, spec.bh_m, spec.growth) for d in dbh[: len(feet)]]
    walk = _Walk(rng, spec, size)
    parts, truth = Parts(), list[StemTruth]()
    for number, (stem, foot) in enumerate(zip(stems, feet, strict=True)):
        z_foot = float(ground(foot[None])[0])
        seen = walk.sees(stem, number, feet, dbh)
        points = walk.points(rng, stem, foot, z_foot, seen, spacing)
        parts.add(points, number)
        if len(points) >= LEAST_SEEN:
            truth.append(_truth(stem, foot, z_foot, number, seen, walk))
    ground_points(rng, ground, size, max(spacing, 0.02), parts, sigma_m=float(walk.noise_m))
    for _ in range(rng.poisson(spec.shrubs_per_tree * spec.trees)):
        parts.add(shrub(rng, feet[rng.integers(len(feet))] + rng.normal(0.0, 0.7, 2), ground, spacing))
    return StemCloud(
        points=np.concatenate(parts.points),
        stems=tuple(truth),
        owner=np.concatenate(parts.owner).astype(np.int64),
        spacing_m=spacing,
    )


#: A stem with fewer points is not in the cloud.
LEAST_SEEN = 60


class _Walk:
    """Stations (K, 2) of one walk, how wrong each is, and what it sees."""

    def __init__(self, rng: np.random.Generator, spec: WalkSpec, size: float) -> None:
        self.spec = spec
        k = spec.stations
        middle, t = 0.5 * size, np.linspace(0.0, 1.0, k, endpoint=False)
        how = rng.random()
        if how < spec.ring:
            reach = rng.uniform(0.35, 0.75) * size
            angle = 2.0 * np.pi * t
            places = middle + reach * np.column_stack([np.cos(angle), np.sin(angle)])
        elif how < spec.ring + spec.past:
            beside = rng.choice([-rng.uniform(0.5, 2.0), rng.uniform(0.1, 0.4) * size])
            places = np.column_stack([(1.4 * t - 0.2) * size, np.full(k, beside)])
        else:
            # There along one side, back through the middle.
            there = np.column_stack([2.0 * size * t, np.full(k, -rng.uniform(0.5, 2.0))])
            back = np.column_stack([2.0 * size * (1.0 - t), np.full(k, rng.uniform(0.4, 0.6) * size)])
            places = np.where((t < 0.5)[:, None], there, back)
        self.places = places + rng.normal(0.0, 0.25, (k, 2))
        drift = rng.normal(0.0, 1.0, (k, 2)).cumsum(axis=0)
        self.error = rng.uniform(*spec.drift_m) * drift / np.sqrt(k)
        self.torn_at: int | None = None
        if rng.random() < spec.torn:
            self.torn_at = int(rng.integers(k // 4, 3 * k // 4))
            direction = rng.uniform(0.0, 2.0 * np.pi)
            self.error[self.torn_at :] += rng.uniform(*spec.tear_m) * np.array([np.cos(direction), np.sin(direction)])
        photo = spec.kind == "walked-photo"
        self.noise_m = rng.uniform(*spec.noise_m) if photo else rng.uniform(0.0015, 0.004)
        self.power = spec.noise_power if photo else 0.0
        self.haze = rng.uniform(*spec.haze) * (1.0 if photo else 0.3)
        self.bias = rng.uniform(*spec.bias_of_noise)

    def sees(self, stem: GrownStem, number: int, feet: Floats, dbh: Floats) -> Bools:
        """(SIDES, K): whether each station sees each side of the stem at breast height."""
        center = feet[number] + stem.axis_at(np.array([stem.bh_m]))[0]
        angle = _middles()
        normal = np.column_stack([np.cos(angle), np.sin(angle)])
        bark = center + 0.5 * stem.dbh_m * normal
        to = self.places[None] - bark[:, None]
        distance = np.linalg.norm(to, axis=2)
        facing = (to * normal[:, None]).sum(axis=2) / np.maximum(distance, 1e-9)
        seen = (facing > 0.15) & (distance < self.spec.reach_m)
        for other, (foot, diameter) in enumerate(zip(feet, dbh, strict=False)):
            if other == number:
                continue
            # Distance of the other stem from the line of sight, where it stands between.
            share = ((foot - bark)[:, None] * to).sum(axis=2) / np.maximum(distance, 1e-9) ** 2
            nearest = bark[:, None] + np.clip(share, 0.0, 1.0)[:, :, None] * to
            seen &= np.linalg.norm(nearest - foot, axis=2) > 0.5 * diameter
        return np.asarray(seen)

    def points(
        self, rng: np.random.Generator, stem: GrownStem, foot: Floats, z_foot: float, seen: Bools, spacing: float
    ) -> Floats:
        """Points (N, 3) of the bark as the stations have it."""
        spec = self.spec
        count = int(2.0 * np.pi * 0.5 * stem.dbh_m * spec.top_m / spacing**2)
        angle, height = rng.uniform(0.0, 2.0 * np.pi, count), rng.uniform(0.0, spec.top_m, count)
        center = foot + stem.axis_at(np.array([stem.bh_m]))[0]
        distance = np.linalg.norm(self.places - center, axis=1)
        side = np.minimum((angle / (2.0 * np.pi) * SIDES).astype(np.int64), SIDES - 1)
        # The nearer and the more frontal a station, the more of the points are its own.
        ease = seen * (1.0 / np.maximum(distance, 1.0) ** 2)
        total = ease.sum(axis=1)
        best = (1.0 / np.maximum(distance, 1.0) ** 2).max()
        there = rng.random(count) < np.clip(total[side] / best, 0.0, 1.0)
        angle, height, side = angle[there], height[there], side[there]
        if len(angle) == 0:
            return np.zeros((0, 3))
        share = np.cumsum(ease / np.maximum(total, 1e-12)[:, None], axis=1)
        station = (share[side] < rng.random(len(angle))[:, None]).sum(axis=1).clip(max=len(self.places) - 1)
        points = stem.place(angle, height) + np.array([*foot, z_foot])
        eye = np.column_stack([self.places[station], np.full(len(angle), z_foot + 1.5)])
        ray = points - eye
        length = np.linalg.norm(ray, axis=1)
        ray /= length[:, None]
        grazing = np.clip(-(ray * stem.normals(angle)).sum(axis=1), 0.15, 1.0)
        sigma = self.noise_m * (length / 4.0) ** self.power / np.sqrt(grazing)
        off = sigma * rng.standard_t(4.0, len(angle)) / np.sqrt(2.0)  # t with 4 has the variance 2
        off += self._bias(rng, angle, height, station, sigma)
        floats = rng.random(len(angle)) < self.haze / grazing**0.5
        before = np.where(rng.random(len(angle)) < 0.65, -1.0, 1.0)
        off[floats] += (before * rng.lognormal(np.log(0.02), 0.8, len(angle)))[floats]
        moved = points + off[:, None] * ray
        moved[:, :2] += self.error[station]
        return np.asarray(moved)

    def _bias(
        self, rng: np.random.Generator, angle: Floats, height: Floats, station: NDArray[np.int64], sigma: Floats
    ) -> Floats:
        """Smooth over the stem, another for each station: (N,) metres along the ray."""
        value = np.zeros(len(angle))
        for _ in range(4):
            turns = rng.integers(0, 4, len(self.places))[station]
            rise = (2.0 * np.pi / rng.uniform(0.3, 1.5, len(self.places)))[station]
            start = rng.uniform(0.0, 2.0 * np.pi, len(self.places))[station]
            value += np.cos(turns * angle + rise * height + start)
        return np.asarray(self.bias * sigma * value / np.sqrt(2.0))


def _middles() -> Floats:
    return np.asarray((np.arange(SIDES) + 0.5) / SIDES * 2.0 * np.pi)


def _truth(stem: GrownStem, foot: Floats, z_foot: float, number: int, seen: Bools, walk: _Walk) -> StemTruth:
    x, y = foot + stem.axis_at(np.array([stem.bh_m]))[0]
    degrees = 360.0 * float(seen.any(axis=1).mean())
    nearest = float(np.linalg.norm(walk.places[seen.any(axis=0)] - [x, y], axis=1).min(initial=np.inf))
    tags = []
    if degrees < HALF_DEG:
        tags.append("half hidden")
    elif degrees >= ALL_DEG:
        tags.append("all round")
    if stem.dbh_m < THIN_M:
        tags.append("thin")
    if stem.lean_deg >= LEANS_DEG:
        tags.append("leaning")
    if nearest >= FAR_M:
        tags.append("far")
    if walk.torn_at is not None and seen[:, : walk.torn_at].any() and seen[:, walk.torn_at :].any():
        tags.append("double wall")
    return StemTruth(
        x_m=float(x), y_m=float(y), z_ground_m=z_foot, dbh_cm=100.0 * stem.tape_m(), tree_id=number + 1,
        seen_deg=degrees, tags=tuple(tags),
    )  # fmt: skip
