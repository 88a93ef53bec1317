"""Plots whose ground is a valley, a bank, a ditch or a mound, with clean stems on it, and undergrowth that hides it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tests.support.stem_clouds import wall

Floats = NDArray[np.float64]
Shape = Callable[[Floats, Floats], Floats]
DBH_M, TAPER, HALF_M = 0.3, -0.01, 10.0
#: Stems in rows, and some on the flank of what lies along the middle.
FEET = np.array(
    [(x, y) for x in (-7.0, 0.0, 7.0) for y in (-7.0, 0.0, 7.0)]
    + [(9.0, 3.0), (9.0, -3.0), (1.5, 3.0), (-1.5, -3.0), (3.0, -3.0), (-3.0, 3.0)]
)


def valley(deg: float) -> Shape:
    """Both sides rise from the middle; a negative angle makes it a crest."""
    return lambda x, y: np.tan(np.radians(deg)) * np.sqrt(x**2 + 1.0)


def bank(height: float, *, width: float = 3.0, middle: float = 0.0) -> Shape:
    """A step of the whole plot; at its border it is a terrace."""
    return lambda x, y: height * np.clip((x - middle) / width + 0.5, 0.0, 1.0)


def ditch(depth: float) -> Shape:
    """Three metres wide."""
    return lambda x, y: -depth * np.exp(-(x**2) / (2 * 0.75**2))


def stream(depth: float, middle: float) -> Shape:
    """Cut into level ground by banks of 0.6 m, a bed of 1.2 m between them."""
    return lambda x, _y: -depth * np.clip((1.2 - np.abs(x - middle)) / 0.6, 0.0, 1.0)


def mound(height: float) -> Shape:
    """Of a windthrow, about the middle."""
    return lambda x, y: height * np.exp(-(x**2 + y**2) / (2 * 0.9**2))


def slope(degrees: float) -> Shape:
    """All of it."""
    return lambda x, _y: np.tan(np.radians(degrees)) * x


def hummocks(x: Floats, y: Floats) -> Floats:
    """Waves of 12 m that rise and fall by 0.8 m."""
    return np.asarray(0.45 * np.sin(x / 2) + 0.34 * np.cos(y / 2))


def gentle(x: Floats, y: Floats) -> Floats:
    """A slope with waves of 8 m and 15 cm."""
    return np.asarray(0.1 * x + 0.15 * np.sin(x / 1.2) * np.cos(y / 1.5))


SHAPES: dict[str, Shape] = {
    "valley_12deg": valley(12.0),
    "valley_15deg": valley(15.0),
    "valley_25deg": valley(25.0),
    "crest_25deg": valley(-25.0),
    "bank_1m": bank(1.0),
    "bank_1_5m": bank(1.5),
    "bank_2m": bank(2.0),
    "ditch_0_5m": ditch(0.5),
    "ditch_1m": ditch(1.0),
    "hummocks": hummocks,
    "mound_0_5m": mound(0.5),
    "mound_1m": mound(1.0),
    "terrace_0_5m": bank(0.5, width=0.4, middle=8.2),
    "terrace_down_0_5m": bank(-0.5, width=0.4, middle=8.2),
    "cut_2_5m": bank(2.5, width=1.2, middle=4.5),
    "stream_2m": stream(2.0, 4.8),
    "slope_30deg": slope(30.0),
    "slope_38deg": slope(38.0),
    "gentle": gentle,
}


@dataclass(frozen=True, kw_only=True)
class ReliefPlot:
    """Points (N, 3) in metres, z up; ``ground_m`` (T,) is the height of the ground at the stems of ``FEET``."""

    points: Floats
    ground_m: Floats


def relief_plot(shape: Shape, *, patches: int = 0, seed: int = 1) -> ReliefPlot:
    """A plot of 20 m on ``shape`` with ``patches`` of undergrowth, domes through which no ground is seen."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-HALF_M, HALF_M, (int(200 * (2 * HALF_M) ** 2), 2))
    ground = np.column_stack([xy, shape(*xy.T) + rng.normal(0.0, 0.01, len(xy))])
    parts = []
    for _ in range(patches):
        at = FEET[rng.integers(len(FEET))] + rng.normal(0.0, 1.2, 2)
        radius, height = rng.uniform(0.4, 0.8), rng.uniform(0.3, 0.9)
        ground = ground[np.hypot(*(ground[:, :2] - at).T) >= radius]
        count = int(np.pi * radius**2 * 600)
        away, angle = radius * np.sqrt(rng.random(count)), rng.uniform(0.0, 2.0 * np.pi, count)
        leaves = at + away[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        top = height * np.sqrt(1.0 - (away / radius) ** 2) * (1.0 - 0.5 * rng.random(count) ** 1.5)
        parts.append(np.column_stack([leaves, shape(*leaves.T) + top]))
    feet_m = np.asarray(shape(*FEET.T))
    for foot, height in zip(FEET, feet_m, strict=True):
        bark = wall(rng, radius=DBH_M / 2, spacing_m=0.02, taper=TAPER)
        parts.append(bark + rng.normal(0.0, 0.003, bark.shape) + [*foot, height])
    return ReliefPlot(points=np.concatenate([ground, *parts]), ground_m=feet_m)
