"""Plots of pieces of real stems: a scan's own points, seen from fewer sides and thinned, under a known diameter.

The other simulators draw bark and errors by rules. Here every point of a stem was scanned: its bark, whorls, branches,
noise and the misfit of its stations are those of the scan, only the ground is made. Where a stem was scanned well
nearly all round, its section at many heights is known from all points (:mod:`training.simulate.scanned_section`). The
three metres of stem around each become a tree whose breast height is there; of its points those are kept that a sector
or one or two stations show, and of these a share. Errors that all points of a piece share are in the reference too and
do not show.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from training.simulate.scanned_section import Layers, ScannedSection, SectionLimits, across, find_layers, section_at
from training.simulate.stem_cloud import StemCloud, StemTruth

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
#: A station shows no side that it sees at a more grazing angle than this cosine.
GRAZING = 0.1


@dataclass(frozen=True, kw_only=True)
class ScanSpec:
    """What is cut from a scan; lengths in metres.

    Sections are looked for from ``heights_m`` to heights above the stem's foot, ``step_m`` apart, each from the points
    up to ``half_m`` above and below. A piece reaches from ``below_m`` under the section to ``above_m`` over it and as
    far from the bark as ``beside_m``, so that twigs come with it; what is lower than ``foot_m`` above the scan's ground
    stays behind.
    """

    heights_m: tuple[float, float] = (1.0, 8.0)
    step_m: float = 0.25
    half_m: float = 0.15
    below_m: float = 1.3
    above_m: float = 1.7
    beside_m: float = 0.25
    foot_m: float = 0.3
    limits: SectionLimits = field(default_factory=SectionLimits)


@dataclass(frozen=True, kw_only=True)
class Piece:
    """A piece of a real stem: ``points`` (N, 3) about the axis at the section, which lies at z = 0; metres."""

    stem: int
    height_m: float
    section: ScannedSection
    points: Floats


@dataclass(frozen=True, kw_only=True)
class View:
    """What is seen of a stem: a sector of ``sector_deg``, or what so many ``stations`` show."""

    name: str
    sector_deg: float = 360.0
    stations: int = 0


VIEWS = (
    View(name="seen 360"),
    View(name="seen 270", sector_deg=270.0),
    View(name="seen 180", sector_deg=180.0),
    View(name="seen 120", sector_deg=120.0),
    View(name="one station", stations=1),
    View(name="two stations", stations=2),
)


@dataclass(frozen=True, kw_only=True)
class ResampleSpec:
    """How pieces become a plot; lengths in metres, ranges uniform.

    ``shares`` are of the points that are left, drawn at random; ``apart_deg`` the angle between two stations.
    """

    trees: int = 16
    bh_m: float = 1.3
    views: tuple[View, ...] = VIEWS
    shares: tuple[float, ...] = (1.0, 0.3, 0.1)
    apart_deg: tuple[float, float] = (60.0, 150.0)
    spacing_m: float = 4.5
    jitter_m: float = 0.3
    ground_spacing_m: float = 0.08
    ground_noise_m: float = 0.005


@dataclass(frozen=True, kw_only=True)
class ResampledTruth(StemTruth):
    """A stem of a resampled plot: the scan's stem, the height there, the reference's standard error, the share kept.

    ``tags`` are the view's name, ``thinned to N %`` and ``swelling`` where the section departs from the stem's taper.
    """

    stem: int
    height_m: float
    std_cm: float
    share: float


#: By what share a section departs from the taper of the metre around to be one on a swelling, or between two.
SWELLS = 0.015


def pieces_of(
    points: Floats, feet: Sequence[tuple[float, float, float]], radii_m: Sequence[float], spec: ScanSpec | None = None
) -> list[Piece]:
    """Pieces of the stems of a scan (N, 3) whose section is known; stems are numbered from 1.

    ``feet`` (T, 3) are x and y at breast height and z of the ground, ``radii_m`` (T,) what the stems have about there:
    both are only where to begin.
    """
    spec = spec or ScanSpec()
    low, high = spec.heights_m
    found = []
    for number, ((x, y, z), radius) in enumerate(zip(feet, radii_m, strict=True), start=1):
        near = points[np.hypot(points[:, 0] - x, points[:, 1] - y) <= radius + spec.beside_m + 1.0]
        near = near[near[:, 2] >= z + spec.foot_m]
        layers = find_layers(near, np.array([x, y, z + 1.3]), radius, (z + spec.foot_m, z + high + spec.above_m))
        if layers is None:
            continue
        for height in np.arange(low, high + 1e-9, spec.step_m):
            section = section_at(near, layers, z + height, half_m=spec.half_m, limits=spec.limits)
            if section is not None:
                cut = _cut(near, layers, section, spec)
                found.append(Piece(stem=number, height_m=float(height), section=section, points=cut))
    return found


def _cut(points: Floats, layers: Layers, section: ScannedSection, spec: ScanSpec) -> Floats:
    """The points (N, 3) of a piece about its section."""
    rise = points[:, 2] - section.middle[2]
    own = points[(rise >= -spec.below_m) & (rise <= spec.above_m)]
    beside = np.linalg.norm(own[:, :2] - layers.middle_at(own[:, 2]), axis=1)
    return np.asarray(own[beside <= 0.5 * section.mean_m + spec.beside_m] - section.middle)


def seen_by(view: View, angle: Floats, rng: np.random.Generator, apart_deg: tuple[float, float]) -> Bools:
    """Which points (N,), at ``angle`` round their stem, a view from a random side shows.

    A sector shows all that lies in it. Stations, far away, show what faces them, the fewer points the more grazing.
    """
    towards = rng.uniform(0.0, 2.0 * np.pi)
    if not view.stations:
        return np.asarray(np.cos(angle - towards) >= np.cos(np.radians(0.5 * view.sector_deg)) - 1e-12)
    chance = np.zeros(len(angle))
    apart = np.radians(rng.uniform(*apart_deg))
    for station in range(view.stations):
        facing = np.cos(angle - towards - station * apart)
        chance += np.where(facing > GRAZING, facing, 0.0)
    return np.asarray(rng.random(len(angle)) < chance)


def resample(seed: int, pieces: Sequence[Piece], spec: ResampleSpec | None = None) -> StemCloud:
    """One plot of ``trees`` pieces, each turned, seen and thinned at random; the same seed gives the same plot.

    The stems are :class:`ResampledTruth`. Views and shares take turns, so that all are as frequent.
    """
    spec = spec or ResampleSpec()
    rng = np.random.default_rng([seed, 11])
    side = int(np.ceil(np.sqrt(spec.trees)))
    ways = [(view, share) for view in spec.views for share in spec.shares]
    first = seed * spec.trees
    parts, owners, stems = list[Floats](), list[NDArray[np.int64]](), list[StemTruth]()
    for number in range(spec.trees):
        view, share = ways[(first + number) % len(ways)]
        piece = pieces[int(rng.integers(len(pieces)))]
        place = spec.spacing_m * (0.5 + np.array(divmod(number, side))) + rng.uniform(-1.0, 1.0, 2) * spec.jitter_m
        offset, _ = across(piece.points, np.zeros(3), piece.section.slope)
        kept = seen_by(view, np.arctan2(offset[:, 1], offset[:, 0]), rng, spec.apart_deg)
        kept &= rng.random(len(kept)) < share
        turn = rng.uniform(0.0, 2.0 * np.pi)
        rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        own = piece.points[kept]
        own = np.column_stack([own[:, :2] @ rotation.T + place, own[:, 2] + spec.bh_m])
        parts.append(own[own[:, 2] > 0.0])
        owners.append(np.full(len(parts[-1]), number))
        stems.append(_truth(piece, place, number, view, share))
    ground = _ground(rng, spec, side, stems)
    return StemCloud(
        points=np.concatenate([*parts, ground]),
        stems=tuple(stems),
        owner=np.concatenate([*owners, np.full(len(ground), -1)]),
        spacing_m=spec.ground_spacing_m,
    )


def _truth(piece: Piece, place: Floats, number: int, view: View, share: float) -> ResampledTruth:
    tags = [view.name, f"thinned to {100.0 * share:.0f} %"]
    if abs(piece.section.swell) > SWELLS:
        tags.append("swelling")
    return ResampledTruth(
        x_m=float(place[0]),
        y_m=float(place[1]),
        z_ground_m=0.0,
        dbh_cm=100.0 * piece.section.tape_m,
        tree_id=number + 1,
        seen_deg=view.sector_deg if not view.stations else 180.0,
        tags=tuple(tags),
        stem=piece.stem,
        height_m=piece.height_m,
        std_cm=100.0 * piece.section.std_m,
        share=share,
    )


def _ground(rng: np.random.Generator, spec: ResampleSpec, side: int, stems: Sequence[StemTruth]) -> Floats:
    """Flat ground (N, 3) at z = 0 about the stems, none inside of them."""
    size = spec.spacing_m * side
    plan = rng.uniform(0.0, size, (int((size / spec.ground_spacing_m) ** 2), 2))
    free = np.ones(len(plan), dtype=bool)
    for stem in stems:
        free &= np.hypot(plan[:, 0] - stem.x_m, plan[:, 1] - stem.y_m) > 0.005 * stem.dbh_cm
    return np.column_stack([plan[free], rng.normal(0.0, spec.ground_noise_m, int(free.sum()))])
