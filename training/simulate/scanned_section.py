"""What a tape would read on a scanned stem, from all of its points: medians round the stem, no circle, no noise model.

The reference of :mod:`training.simulate.resampled_scan`. The measurement fits a tapering stem with harmonics to a
metre of it by expectation-maximisation. Here the axis is the line through the middles of thin layers, a section is the
median distance of its points in each of 36 directions, and the diameter is the girth of the outline's convex hull over
pi, as of a tape that spans hollows. Noise makes the hull of an outline longer: by how much, and how sure the girth is,
is seen by drawing the bark anew piece by piece (bootstrap, Efron and Tibshirani 1993, chapters 6 and 10).

Within a direction bark is averaged: a tape rides ridges narrower than 10 degrees, a median does not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
#: Directions round a stem: enough for its shape, few enough that each has its points.
BINS = 36
MIDDLES = (np.arange(BINS) + 0.5) * 2.0 * np.pi / BINS
#: Layers that make the axis are so far apart and half as thick as this, metres.
LAYER_M, LAYER_HALF_M = 0.10, 0.10
#: The axis and the taper at a height are lines through the layers so far up and down, metres, at least so many.
AXIS_HALF_M, LEAST_LAYERS = 0.5, 7
#: Bark is drawn anew in pieces of one direction and so high, metres.
PATCH_M = 0.05
#: What is farther from the wall than this is a branch or a neighbour, metres; strays are counted as far as this.
WALL_M, STRAY_M = 0.05, 0.15
#: A direction of a section, and one of a layer, with fewer points is not filled; a layer needs so many directions.
LEAST_POINTS, LEAST_OF_LAYER, LEAST_BINS = 4, 2, 15
#: Rounds that move a middle; of a layer, in the first of which the wall may be anywhere near.
ROUNDS, LOOSE_ROUNDS = 12, 4
#: A middle that moves by less, metres, is found.
STILL_M = 1e-4
DRAWS = 200
#: From a median absolute deviation to a standard deviation, of a Gaussian.
MAD = 1.4826
#: From a Gaussian's median to its first tenth, in standard deviations.
TENTH = 1.282


@dataclass(frozen=True, kw_only=True)
class Layers:
    """A stem layer by layer: heights z (K,), ascending, middles (K, 2) and median radii (K,); metres."""

    z: Floats
    middles: Floats
    radii: Floats

    def middle_at(self, z: Floats) -> Floats:
        """Middles (N, 2) at heights (N,), those of the last layers beyond them."""
        return np.column_stack([np.interp(z, self.z, self.middles[:, axis]) for axis in (0, 1)])


@dataclass(frozen=True, kw_only=True)
class SectionLimits:
    """What a section must be to serve as a reference: lengths in metres, the others shares; see ScannedSection."""

    filled: float = 0.8
    wall_m: float = 0.013
    stray: float = 0.1
    std_m: float = 0.002


@dataclass(frozen=True, kw_only=True)
class ScannedSection:
    """One section of a scanned stem; lengths in metres.

    ``middle`` (3,) and ``slope`` (2,), dx/dz and dy/dz, are of the axis. ``tape_m`` is the girth of the hull over pi,
    ``std_m`` its standard error, ``mean_m`` twice the mean radius, ``swell`` by what share that is more than the line
    through the radii of the metre around. ``filled`` is the share of the directions with points enough, ``wall_m`` the
    inward spread of the points across the wall where it is largest (two walls show there), ``stray`` the share of
    points nearer than 15 cm that are not on the wall, ``outline`` (BINS,) the radii.
    """

    middle: Floats
    slope: Floats
    tape_m: float
    std_m: float
    mean_m: float
    swell: float
    filled: float
    wall_m: float
    stray: float
    points: int
    outline: Floats

    @property
    def oval(self) -> complex:
        """The second harmonic: its part of the mean radius, and as its angle twice the direction of the longest side.

        The stems of a scan whose stations do not fit together are all longest in one direction.
        """
        return complex(2.0 * np.mean(self.outline * np.exp(2.0j * MIDDLES)) / np.mean(self.outline))


def find_layers(points: Floats, start: Floats, radius_m: float, heights: tuple[float, float]) -> Layers | None:
    """Follow a stem through points (N, 3) from ``start`` (3,) up and down to ``heights``, z; None where it is lost.

    ``radius_m`` is what it may have about there.
    """
    found: dict[float, tuple[Floats, float]] = {}
    up = np.arange(start[2], heights[1], LAYER_M)
    down = np.arange(start[2] - LAYER_M, heights[0], -LAYER_M)
    for way in (up, down):
        middle, radius = start[:2], radius_m
        for z in way:
            layer = _middle(points[np.abs(points[:, 2] - z) <= LAYER_HALF_M, :2], middle, radius)
            if layer is not None:
                middle, radius = layer
                found[float(z)] = layer
    if len(found) < LEAST_LAYERS:
        return None
    z = np.array(sorted(found))
    return Layers(z=z, middles=np.array([found[h][0] for h in z]), radii=np.array([found[h][1] for h in z]))


def section_at(
    points: Floats, layers: Layers, z: float, *, half_m: float, limits: SectionLimits | None = None, seed: int = 0
) -> ScannedSection | None:
    """The section of a stem at height ``z`` from points (N, 3) up to ``half_m`` along the axis beside it.

    None where the axis is not known or the section is not within the ``limits``.
    """
    limits = limits or SectionLimits()
    own = np.abs(layers.z - z) <= AXIS_HALF_M
    if own.sum() < LEAST_LAYERS:
        return None
    lines = np.polyfit(layers.z[own] - z, np.column_stack([layers.middles[own], layers.radii[own]]), 1)
    slope, taper, middle, radius = lines[0, :2], float(lines[0, 2]), lines[1, :2], float(lines[1, 2])
    offset, along = across(points, np.array([*middle, z]), slope)
    near = (np.abs(along) <= half_m) & (np.linalg.norm(offset, axis=1) <= radius + 2.0 * STRAY_M)
    offset, along = offset[near], along[near]
    level, moved = radius, np.zeros(2)
    for _ in range(ROUNDS):
        distance = np.linalg.norm(offset - moved, axis=1) - taper * along
        wall = np.abs(distance - level) <= WALL_M
        side = bins_of(offset - moved)
        outline = _medians(side[wall], distance[wall])
        known = np.isfinite(outline)
        if known.mean() < limits.filled:
            return None
        step = _first_harmonic(outline)
        level, moved = float(step[0]), moved + step[1:]
    smooth = _smooth(outline)
    off = distance - smooth[side]
    near = np.abs(off) <= STRAY_M
    wall_m, stray = _thickest(side[wall], off[wall]), float((np.abs(off[near]) > WALL_M).mean())
    if wall_m > limits.wall_m or stray > limits.stray:
        return None
    drawn = _drawn_anew(side[wall], along[wall], distance[wall], known, np.random.default_rng(seed))
    filled = float(known.mean())
    # A gap is filled from its two ends; what is there may differ as the stem's sides differ.
    std = float(np.hypot(drawn.std(), 2.0 * (1.0 - filled) * smooth.std()))
    if std > limits.std_m:
        return None
    return ScannedSection(
        middle=np.array([*(middle + moved), z]),
        slope=slope,
        tape_m=2.0 * tape_of(smooth) - float(drawn.mean()),
        std_m=std,
        mean_m=2.0 * float(smooth.mean()),
        swell=float(smooth.mean()) / radius - 1.0,
        filled=filled,
        wall_m=wall_m,
        stray=stray,
        points=int(wall.sum()),
        outline=smooth,
    )


def across(points: Floats, middle: Floats, slope: Floats) -> tuple[Floats, Floats]:
    """Offsets (N, 2) of points (N, 3) in the plane perpendicular to an axis, and how far (N,) along it they lie.

    ``middle`` (3,) is where the axis crosses the plane, ``slope`` (2,) its dx/dz and dy/dz.
    """
    axis = np.array([*slope, 1.0]) / np.sqrt(1.0 + slope @ slope)
    first = np.array([1.0, 0.0, 0.0]) - axis[0] * axis
    first /= np.linalg.norm(first)
    rest = points - middle
    return rest @ np.column_stack([first, np.cross(axis, first)]), rest @ axis


def bins_of(offset: Floats) -> Ints:
    """The direction (N,) in 0 .. BINS - 1 of each offset (N, 2)."""
    turns = np.arctan2(offset[:, 1], offset[:, 0]) / (2.0 * np.pi)
    return np.asarray(np.minimum((turns % 1.0) * BINS, BINS - 1), dtype=np.int64)


def tape_of(outline: Floats) -> float:
    """Girth over pi of the convex hull of radii (BINS,) round a middle, with arcs between the directions."""
    angle = np.linspace(0.0, 2.0 * np.pi, 360, endpoint=False)
    radius = np.interp(angle, MIDDLES, outline, period=2.0 * np.pi)
    hull = ConvexHull(radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]))
    return float(hull.area / np.pi)  # the "area" of a hull in the plane is its girth


def _middle(plan: Floats, start: Floats, radius: float) -> tuple[Floats, float] | None:
    """Middle (2,) and radius of a layer (N, 2), from the medians of its directions; None where too few have points."""
    middle = start
    for number in range(ROUNDS):
        distance = np.linalg.norm(plan - middle, axis=1)
        near = np.abs(distance - radius) <= (2.0 if number < LOOSE_ROUNDS else 1.0) * WALL_M
        outline = _medians(bins_of(plan - middle)[near], distance[near], LEAST_OF_LAYER)
        if np.isfinite(outline).sum() < LEAST_BINS:
            return None
        found = _first_harmonic(outline)
        middle, radius = middle + found[1:], float(found[0])
        if number >= LOOSE_ROUNDS and float(np.abs(found[1:]).max()) < STILL_M:
            break
    return middle, radius


def _first_harmonic(outline: Floats) -> Floats:
    """Mean radius and shift in x and y (3,) of radii (BINS,) with gaps; directions far off, such as branches, apart."""
    known = np.isfinite(outline)
    model = np.column_stack([np.ones(BINS), np.cos(MIDDLES), np.sin(MIDDLES)])[known]
    first = np.linalg.lstsq(model, outline[known], rcond=None)[0]
    off = np.abs(outline[known] - model @ first)
    kept = off <= 3.0 * MAD * np.median(off) + 1e-9
    return np.asarray(np.linalg.lstsq(model[kept], outline[known][kept], rcond=None)[0])


def _medians(side: Ints, distance: Floats, least: int = LEAST_POINTS) -> Floats:
    """Median distance (BINS,) of each direction, NaN where it has too few points."""
    order = np.argsort(side, kind="stable")
    groups = np.split(distance[order], np.searchsorted(side[order], np.arange(1, BINS)))
    return np.array([np.median(g) if len(g) >= least else np.nan for g in groups])


def _smooth(outline: Floats) -> Floats:
    """Gaps filled from their ends, then each direction with half of the weight of its two neighbours."""
    known = np.isfinite(outline)
    whole = np.interp(MIDDLES, MIDDLES[known], outline[known], period=2.0 * np.pi)
    return np.asarray(0.5 * whole + 0.25 * (np.roll(whole, 1) + np.roll(whole, -1)))


def _drawn_anew(
    side: Ints, along: Floats, distance: Floats, known: NDArray[np.bool_], rng: np.random.Generator
) -> Floats:
    """The tape (DRAWS,) of as many stems, of which each direction has its pieces of bark drawn with repeats."""
    outlines = np.full((DRAWS, BINS), np.nan)
    layer = np.floor(along / PATCH_M)
    for k in np.flatnonzero(known):
        own = np.flatnonzero(side == k)
        own = own[np.argsort(distance[own])]
        _, piece = np.unique(layer[own], return_inverse=True)
        count = int(piece.max()) + 1
        times = rng.multinomial(count, np.full(count, 1.0 / count), size=DRAWS)[:, piece]
        # The median of points that count so many times each.
        upto = times.cumsum(axis=1)
        half = 0.5 * upto[:, -1:]
        below, above = ((upto < half).sum(axis=1), (upto <= half).sum(axis=1))
        outlines[:, k] = 0.5 * (distance[own[below]] + distance[own[above]])
    return np.array([tape_of(_smooth(outline)) for outline in outlines])


def _thickest(side: Ints, off: Floats) -> float:
    """Largest spread across the wall, on its inner side, over three neighbouring directions.

    Of two walls one is inside the other somewhere; twigs are outside only. From the innermost tenth of the points: a
    second wall of few points is a second wall.
    """
    spreads = [
        float(np.median(off[own]) - np.quantile(off[own], 0.1)) / TENTH
        for own in ((side - k + 1) % BINS < 3 for k in range(BINS))
        if own.sum() >= 3 * LEAST_POINTS
    ]
    return max(spreads, default=0.0)
