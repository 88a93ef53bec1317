"""Where the bark of a stem lies, side by side: what is left of its points when they are asked for more than a diameter.

A stem's fit keeps three harmonics, each held by a prior. Two halves of a stem that were pushed into each other leave
corners that no prior expects; they show in the mean distance of the bark from the axis in each of some dozen sectors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsinfer.trees.cylinder.axis import AxisFit
from fsinfer.trees.points.sums import weighted_sum
from fsinfer.trees.points.surface import SECTORS, sector_of

Floats = NDArray[np.float64]
#: Sectors of a profile. Source: numerics, the finest in which stems are cut; 2 to 5 cm of bark.
PROFILE_SECTORS = SECTORS[1]
#: Points of the bark without which a sector says nothing. Source: statistics, their mean is known to half of the noise.
LEAST_IN_SECTOR = 5.0


@dataclass(frozen=True, kw_only=True)
class SideProfile:
    """Mean distance of the bark from a stem's axis over ``radius_m``, in each of ``PROFILE_SECTORS`` equal sectors.

    ``mean_m`` (K,) metres, taper taken out; ``precision`` (K,) one over its variance by the points' noise alone, 1/m^2,
    and 0 where the side was not seen. Sector 0 starts at the angle -pi from the x axis.
    """

    radius_m: float
    mean_m: Floats
    precision: Floats

    @property
    def seen(self) -> int:
        """How many of the sectors were seen."""
        return int(np.count_nonzero(self.precision))


def side_profile(fit: AxisFit, offsets: Floats) -> SideProfile:
    """The profile of a ``fit`` whose points lie at ``offsets`` (N, 2) from its axis."""
    sector = sector_of(offsets, PROFILE_SECTORS)
    # The residuals are about the harmonics that were fitted, whose derivatives are their negatives.
    over_radius = fit.residuals_m - weighted_sum(fit.shape_m, fit.jacobian[:, 6:].T)
    weight = fit.core / fit.noise_m**2
    count = np.bincount(sector, weights=fit.core, minlength=PROFILE_SECTORS)
    precision = np.bincount(sector, weights=weight, minlength=PROFILE_SECTORS)
    mean = np.bincount(sector, weights=weight * over_radius, minlength=PROFILE_SECTORS) / np.maximum(precision, 1e-12)
    seen = count >= LEAST_IN_SECTOR
    return SideProfile(
        radius_m=fit.radius_m, mean_m=np.where(seen, mean, 0.0), precision=np.where(seen, precision, 0.0)
    )
