"""Which sides of a stem were seen, and how sharply.

Bark fills its side at every height, strays do not. Depth maps leave one side of a stem sharp, where the camera was
near, and the other in a haze that is thicker outwards; there the sharp side decides.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

SECTORS = 36  # 10 degrees
LAYER_M = 0.10
POINTS_A_CELL = 4.0  # fewer, and cells stay empty by chance: then only sectors are looked at
LEAST_SHARE = 0.10  # of what a well seen sector holds; the density of scans differs by five between sides
LEAST_LAYERS = 1.0 / 3.0  # of the layers in which the stem is seen; branches and shrubs fill a few


def seen_side(offsets: Floats, foot: Floats, core: Floats) -> Bools:
    """Whether each point lies on a side of the stem that is seen, (N,).

    ``offsets`` (N, 2) are from the axis, ``foot`` (N,) metres along it, ``core`` (N,) probabilities of being bark.
    """
    total = float(core.sum())
    sectors = int(np.clip(total / (2.0 * POINTS_A_CELL), 8, SECTORS))
    angle = np.arctan2(offsets[:, 1], offsets[:, 0]) / (2.0 * np.pi) + 0.5
    sector = np.minimum((angle * sectors).astype(np.int64), sectors - 1)
    count = np.bincount(sector, weights=core, minlength=sectors)
    seen = count >= max(LEAST_SHARE * float(np.percentile(count, 90)), 0.5)
    layer = np.floor((foot - foot.min()) / LAYER_M).astype(np.int64)
    layers = int(layer.max()) + 1
    if total >= POINTS_A_CELL * sectors * layers:
        cells = np.bincount(layer * sectors + sector, weights=core, minlength=layers * sectors).reshape(layers, sectors)
        full = cells >= LEAST_SHARE * np.percentile(cells, 90)
        active = full.mean(axis=1) >= 0.5 * full.mean(axis=1).max()
        seen &= full[active].mean(axis=0) >= LEAST_LAYERS
    return np.asarray(seen[sector])


NOISE_SECTORS = 24
NOISE_WINDOW_M = 0.06
NOISE_PRIOR = 15.0  # points that the noise of the whole stem counts for in a sector's
SHARP_PERCENTILE = 25.0  # a quarter of the circumference sets what sharp is
MODEL_M = 0.008  # bark and shape depart from the model by that much: no side counts as sharper
MOST = 10.0  # a hazy side is at most that many times noisier than the sharp ones


def relative_noise(offsets: Floats, residuals: Floats) -> Floats:
    """Noise, at least 1, of each of ``NOISE_SECTORS`` sectors in units of that of the sharp sides.

    ``offsets`` (N, 2) from the axis and ``residuals`` (N,) of all points near the wall, haze included.
    """
    near = np.abs(residuals) <= NOISE_WINDOW_M
    sector, values = noise_sector(offsets[near]), residuals[near]
    if len(values) < NOISE_SECTORS:
        return np.ones(NOISE_SECTORS)
    whole = _spread(values) ** 2
    variance = np.full(NOISE_SECTORS, np.nan)
    for number in range(NOISE_SECTORS):
        own = values[sector == number]
        if len(own) >= 3:
            variance[number] = (len(own) * _spread(own) ** 2 + NOISE_PRIOR * whole) / (len(own) + NOISE_PRIOR)
    if np.isnan(variance).all():
        return np.ones(NOISE_SECTORS)
    variance += MODEL_M**2
    sharp = float(np.nanpercentile(variance, SHARP_PERCENTILE))
    return np.asarray(np.nan_to_num(np.sqrt(np.clip(variance / sharp, 1.0, MOST**2)), nan=1.0))


def noise_sector(offsets: Floats) -> NDArray[np.int64]:
    """Index (N,) of the sector of ``relative_noise`` in which each of the offsets (N, 2) lies."""
    angle = np.arctan2(offsets[:, 1], offsets[:, 0]) / (2.0 * np.pi) + 0.5
    return np.minimum((angle * NOISE_SECTORS).astype(np.int64), NOISE_SECTORS - 1)


def _spread(values: Floats) -> float:
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))
