"""How the surface of a stem is cut into sectors, layers and patches, and which points lie on it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Least and greatest number of sectors round a stem, 45 to 10 degrees; sparse and thin stems get few.
#: Source: chosen on simulated stems.
SECTORS = (8, 36)
#: Height of a layer of a stem, metres. Source: chosen on simulated stems.
LAYER_M = 0.10
#: Points within such a patch share the error of a depth map and of bark, metres. Source: chosen on simulated stems.
PATCH_M = 0.015
#: What is nearer to the fitted wall than so many standard deviations is bark. Source: 98.8 % of a Gaussian.
WALL_SIGMAS = 2.5
#: What is farther from it than so many is haze, another thing, or not the stem's. Source: 99.7 % of a Gaussian.
OUTSIDE_SIGMAS = 3.0
#: A sector or cell counts as seen with this share of what a well seen one holds: strays do not close an arc, and the
#: density of scans differs by five between sides. Source: chosen on simulated stems.
STRAY_SHARE = 0.1
#: What a well seen sector or cell holds: this percentile of them. Source: not recorded.
WELL_SEEN_PERCENTILE = 90.0
#: A sector belongs to the stem when it is seen in this share of the layers in which anything of the stem is seen;
#: branches and shrubs fill a few. Source: not recorded.
SEEN_LAYERS = 1.0 / 3.0
#: Least reach about a wall that is only roughly known, metres. Source: not recorded.
LEAST_REACH_M = 0.05
#: What is looked at about a wall that is only roughly known, share of the radius. Source: geometry, the inside of a
#: stem must not reach its axis.
REACH_OF_RADIUS = 0.8


def sector_of(offsets: Floats, sectors: int) -> Ints:
    """In which of so many equal sectors offsets (N, 2) from the axis lie, (N,); sector 0 starts at angle -pi."""
    turn = np.arctan2(offsets[:, 1], offsets[:, 0]) / (2.0 * np.pi) + 0.5
    return np.minimum((turn * sectors).astype(np.int64), sectors - 1)


def well_seen(count: NDArray[np.number]) -> NDArray[np.bool_]:
    """Which sectors (S,) are seen, by the points, or their weights, that each of them holds."""
    return np.asarray(count >= max(STRAY_SHARE * float(np.percentile(count, WELL_SEEN_PERCENTILE)), 0.5))


def reach_about_wall(radius_m: float, most_m: float) -> float:
    """How far from a wall of roughly ``radius_m`` points are looked at, at most ``most_m``."""
    return float(np.clip(REACH_OF_RADIUS * radius_m, LEAST_REACH_M, most_m))
