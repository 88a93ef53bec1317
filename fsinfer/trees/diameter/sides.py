"""Which sides of a stem were seen, and how sharply.

Bark fills its side at every height, strays do not. Depth maps leave one side of a stem sharp, where the camera was
near, and the other in a haze that is thicker outwards; there the sharp side decides.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsinfer.trees.cylinder.axis import AxisSettings
from fsinfer.trees.points.sums import MAD_TO_SIGMA, median
from fsinfer.trees.points.surface import (
    LAYER_M,
    SECTORS,
    SEEN_LAYERS,
    STRAY_SHARE,
    WELL_SEEN_PERCENTILE,
    sector_of,
    well_seen,
)

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


#: Sectors in which errors go together: by their noise sharp and hazy sides are told apart. Source: not recorded.
NOISE_SECTORS = 24


@dataclass(frozen=True, kw_only=True)
class SideSettings:
    """Constants of :func:`seen_side`.

    Attributes
    ----------
    points_a_cell: fewer in a sector of a layer, and cells stay empty by chance: then only sectors are looked at.
        Source: statistics, one in 50 stays empty by chance.
    active_layers: layers count that show this share of what the fullest shows. Source: not recorded.
    """

    points_a_cell: float = 4.0
    active_layers: float = 0.5


@dataclass(frozen=True, kw_only=True)
class NoiseSettings:
    """Constants of :func:`relative_noise`, which looks at residuals up to half the window of the axis's fit.

    Attributes
    ----------
    prior_points: points that the noise of the whole stem counts for in a sector's. Source: chosen on simulated stems.
    sharp_percentile: of the circumference; a quarter of it sets what sharp is. Source: chosen on simulated stems.
    model_m: bark and shape depart from the model by that much: no side counts as sharper. Source: chosen on simulated
        stems.
    most: a hazy side is at most that many times noisier than the sharp ones. Source: chosen on simulated stems.
    """

    prior_points: float = 15.0
    sharp_percentile: float = 25.0
    model_m: float = 0.008
    most: float = 10.0


def seen_side(offsets: Floats, foot: Floats, core: Floats, *, settings: SideSettings | None = None) -> Bools:
    """Whether each point lies on a side of the stem that is seen, (N,).

    ``offsets`` (N, 2) are from the axis, ``foot`` (N,) metres along it, ``core`` (N,) probabilities of being bark.
    """
    s = settings or SideSettings()
    total = float(core.sum())
    sectors = int(np.clip(total / (2.0 * s.points_a_cell), *SECTORS))
    sector = sector_of(offsets, sectors)
    count = np.bincount(sector, weights=core, minlength=sectors)
    seen = well_seen(count)
    layer = np.floor((foot - foot.min()) / LAYER_M).astype(np.int64)
    layers = int(layer.max()) + 1
    if total >= s.points_a_cell * sectors * layers:
        cells = np.bincount(layer * sectors + sector, weights=core, minlength=layers * sectors).reshape(layers, sectors)
        full = cells >= STRAY_SHARE * np.percentile(cells, WELL_SEEN_PERCENTILE)
        active = full.mean(axis=1) >= s.active_layers * full.mean(axis=1).max()
        seen &= full[active].mean(axis=0) >= SEEN_LAYERS
    return np.asarray(seen[sector])


def relative_noise(offsets: Floats, residuals: Floats, *, settings: NoiseSettings | None = None) -> Floats:
    """Noise, at least 1, of each of ``NOISE_SECTORS`` sectors in units of that of the sharp sides.

    ``offsets`` (N, 2) from the axis and ``residuals`` (N,) of all points near the wall, haze included.
    """
    s = settings or NoiseSettings()
    near = np.abs(residuals) <= 0.5 * AxisSettings().window_m
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
    return sector_of(offsets, NOISE_SECTORS)


def _spread(values: Floats) -> float:
    return MAD_TO_SIGMA * median(np.abs(values - median(values)))
