"""Which sides of a stem were seen, and how sharply.

Bark fills its side at every height, strays do not. Depth maps leave one side of a stem sharp, where the camera was
near, and the other in a haze that is thicker outwards; there the sharp side decides.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsinfer.trees.points.sums import median

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class SideSettings:
    """Constants of :func:`seen_side`."""

    sectors: tuple[int, int] = (8, 36)  # 45 to 10 degrees
    layer_m: float = 0.10
    points_a_cell: float = 4.0  # fewer, and cells stay empty by chance: then only sectors are looked at
    least_share: float = 0.10  # of what a well seen sector holds; the density of scans differs by five between sides
    least_layers: float = 1.0 / 3.0  # of the layers in which the stem is seen; branches and shrubs fill a few


@dataclass(frozen=True, kw_only=True)
class NoiseSettings:
    """Constants of :func:`relative_noise`."""

    window_m: float = 0.06
    prior_points: float = 15.0  # that the noise of the whole stem counts for in a sector's
    sharp_percentile: float = 25.0  # a quarter of the circumference sets what sharp is
    model_m: float = 0.008  # bark and shape depart from the model by that much: no side counts as sharper
    most: float = 10.0  # a hazy side is at most that many times noisier than the sharp ones


NOISE_SECTORS = 24  # what relative_noise and noise_sector agree on


def seen_side(offsets: Floats, foot: Floats, core: Floats, *, settings: SideSettings | None = None) -> Bools:
    """Whether each point lies on a side of the stem that is seen, (N,).

    ``offsets`` (N, 2) are from the axis, ``foot`` (N,) metres along it, ``core`` (N,) probabilities of being bark.
    """
    s = settings or SideSettings()
    total = float(core.sum())
    sectors = int(np.clip(total / (2.0 * s.points_a_cell), *s.sectors))
    angle = np.arctan2(offsets[:, 1], offsets[:, 0]) / (2.0 * np.pi) + 0.5
    sector = np.minimum((angle * sectors).astype(np.int64), sectors - 1)
    count = np.bincount(sector, weights=core, minlength=sectors)
    seen = count >= max(s.least_share * float(np.percentile(count, 90)), 0.5)
    layer = np.floor((foot - foot.min()) / s.layer_m).astype(np.int64)
    layers = int(layer.max()) + 1
    if total >= s.points_a_cell * sectors * layers:
        cells = np.bincount(layer * sectors + sector, weights=core, minlength=layers * sectors).reshape(layers, sectors)
        full = cells >= s.least_share * np.percentile(cells, 90)
        active = full.mean(axis=1) >= 0.5 * full.mean(axis=1).max()
        seen &= full[active].mean(axis=0) >= s.least_layers
    return np.asarray(seen[sector])


def relative_noise(offsets: Floats, residuals: Floats, *, settings: NoiseSettings | None = None) -> Floats:
    """Noise, at least 1, of each of ``NOISE_SECTORS`` sectors in units of that of the sharp sides.

    ``offsets`` (N, 2) from the axis and ``residuals`` (N,) of all points near the wall, haze included.
    """
    s = settings or NoiseSettings()
    near = np.abs(residuals) <= s.window_m
    sector, values = noise_sector(offsets[near]), residuals[near]
    if len(values) < NOISE_SECTORS:
        return np.ones(NOISE_SECTORS)
    whole = _spread(values) ** 2
    variance = np.full(NOISE_SECTORS, np.nan)
    for number in range(NOISE_SECTORS):
        own = values[sector == number]
        if len(own) >= 3:
            variance[number] = (len(own) * _spread(own) ** 2 + s.prior_points * whole) / (len(own) + s.prior_points)
    if np.isnan(variance).all():
        return np.ones(NOISE_SECTORS)
    variance += s.model_m**2
    sharp = float(np.nanpercentile(variance, s.sharp_percentile))
    return np.asarray(np.nan_to_num(np.sqrt(np.clip(variance / sharp, 1.0, s.most**2)), nan=1.0))


def noise_sector(offsets: Floats) -> NDArray[np.int64]:
    """Index (N,) of the sector of ``relative_noise`` in which each of the offsets (N, 2) lies."""
    angle = np.arctan2(offsets[:, 1], offsets[:, 0]) / (2.0 * np.pi) + 0.5
    return np.minimum((angle * NOISE_SECTORS).astype(np.int64), NOISE_SECTORS - 1)


def _spread(values: Floats) -> float:
    return 1.4826 * median(np.abs(values - median(values)))
