"""What the diameters up a stem and the one at breast height tell of each other: a smooth taper through all of them.

The points of a half-seen or hazy stem err alike at all heights, and each height errs for itself; the diameter at breast
height is better known, by the edges in the photographs above all. Taken together as a Gaussian process over the height
(Rasmussen and Williams 2006, chapter 2): a straight taper, a second derivative of white noise (an integrated Wiener
process from breast height up and down), the butt's swell, and what whorls and scars add at each height. A part of the
errors of the measured diameters is common to a stem. Outliers count less (Student's t, by reweighting).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

#: Rounds of reweighting. Source: numerics.
ROUNDS = 4
#: No diameter is known better, cm. Source: numerics.
LEAST_STD_CM = 0.02
#: Standard deviation of a stem's diameter before anything is measured, in diameters. Source: numerics.
ANY_SIZE = 2.0


@dataclass(frozen=True, kw_only=True)
class TaperSettings:
    """Constants of :func:`smooth_taper`; diameters in units of that at breast height.

    Attributes
    ----------
    slope: mean change of the diameter per metre of height, and its standard deviation between stems. Source: forestry
        practice, a stem of 30 cm loses 1.2 cm a metre.
    bend: standard deviation of the slope after a metre. Source: chosen on three walks through the
        rendered plots of seeds 955055 and 955057 (docs/trials-accuracy.md).
    foot: standard deviation of the butt's swell at 0.5 m. Source: as ``bend``.
    foot_fall_m: height over which it falls off. Source: as ``bend``.
    local: of what whorls and scars add. Source: as ``bend``.
    wider: the standard deviations of single heights are too small by so much. Source: as ``bend``.
    common: share of the variance of a height's error that all heights of the stem share. Source: as ``bend``.
    freedom: degrees of freedom of Student's t. Source: judgement.
    """

    slope: tuple[float, float] = (-0.04, 0.04)
    bend: float = 0.1
    foot: float = 0.06
    foot_fall_m: float = 0.28
    local: float = 0.005
    wider: float = 1.6
    common: float = 0.3
    freedom: float = 4.0


def smooth_taper(
    heights_m: Floats,
    diameters_cm: Floats,
    stds_cm: Floats,
    *,
    breast_height: tuple[float, float, float],
    settings: TaperSettings | None = None,
) -> tuple[Floats, Floats]:
    """Diameters (N,) and their standard deviations (N,) in cm at ``heights_m`` (N,), by all that was measured.

    ``diameters_cm`` and ``stds_cm`` (N,) are those of each height by itself; ``breast_height`` is the height in metres
    at which the stem's diameter was measured, that diameter, and its standard deviation, in cm.
    """
    s = settings or TaperSettings()
    at, dbh, dbh_std = breast_height[0], breast_height[1], max(breast_height[2], LEAST_STD_CM)
    if not len(heights_m):
        return np.zeros(0), np.zeros(0)
    above = np.append(heights_m, at) - at
    mean_slope, slope_std = (value * dbh for value in s.slope)
    swell = s.foot * dbh * np.exp(-np.maximum(np.append(heights_m, at) - 0.5, 0.0) / s.foot_fall_m)
    prior = (ANY_SIZE * dbh) ** 2 + slope_std**2 * np.outer(above, above)
    prior += (s.bend * dbh) ** 2 * _integrated_wiener(above)
    prior += np.outer(swell, swell) + (s.local * dbh) ** 2 * np.eye(len(above))
    own = np.append(s.wider * np.maximum(stds_cm, LEAST_STD_CM), 0.0)
    single = np.append((1.0 - s.common) * own[:-1] ** 2, dbh_std**2)
    shared = s.common * np.outer(own, own)
    total = np.append(own[:-1] ** 2, dbh_std**2)
    expected = dbh + mean_slope * above
    off = np.append(diameters_cm, dbh) - expected
    weight = np.ones(len(off))
    for _ in range(ROUNDS):
        gain = np.linalg.solve(prior + shared + np.diag(single / weight), prior).T
        smooth = gain @ off
        square = (off - smooth) ** 2 / total
        weight = (s.freedom + 1.0) / (s.freedom + square)
        weight[-1] = 1.0  # what the diameter at breast height may be off by is in its interval
    variance = np.diag(prior - gain @ prior)[:-1]
    return (expected + smooth)[:-1], np.sqrt(np.maximum(variance, 0.0))


def _integrated_wiener(above: Floats) -> Floats:
    """Covariance (N, N) of an integrated Wiener process of unit rate from 0 upward, and of another downward."""
    distance = np.abs(above)
    near, far = np.minimum.outer(distance, distance), np.maximum.outer(distance, distance)
    same_side = np.sign(above)[:, None] == np.sign(above)[None, :]
    return np.where(same_side, near**2 * (3.0 * far - near) / 6.0, 0.0)
