"""How far apart the stations of a scanner, or the passes of a walk, show one stem, told by the order of its points.

A cloud of several stations is written one after the other, so that of two points beside each other on the bark those
that follow each other in the file come from one station, and the nearest ones from any. Where the stations do not fit
on each other, the nearest points differ by more than those that follow each other:

    2 (noise^2 + offset^2) - 2 noise^2,

half of which is the variance of the stations' offsets across the bark. (The ratio of the mean squared successive
difference to the variance is von Neumann's, Annals of Mathematical Statistics 12, 1941; the nearest neighbours stand in
for the variance here, since bark has a relief of its own, which neighbours share.) Files in another order, such as one
that a program has sorted by place, tell nothing, and give nothing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Floats = NDArray[np.float64]

#: Fewer points tell nothing. Source: numerics.
LEAST_POINTS = 60
#: Points of one line of a scan follow each other at most so far apart on the bark, metres. Source: judgement.
_FOLLOWS_M = 0.1
#: Standard errors by which the two must differ. Source: statistics; most of the nearest are so to each other, too, and
#: their differences count twice.
_SURE = 4.0


def stations_apart_m(places: Floats, residuals: Floats, sure: NDArray[np.bool_]) -> float:
    """Standard deviation across the bark, metres, of what the stations are off; 0 where the file does not tell it.

    ``places`` (N, 3) on a stem's surface in the order of the file, ``residuals`` (N,) of its fit in metres; those of
    ``sure`` (N,) are bark.
    """
    places, residuals = places[sure], residuals[sure]
    if len(places) < LEAST_POINTS:
        return 0.0
    _, nearest = cKDTree(places).query(places[:-1], k=2)
    itself = np.arange(len(places) - 1)
    # Points at the same place are each other's nearest in any order.
    other = np.where(nearest[:, 0] == itself, nearest[:, 1], nearest[:, 0])
    follows = np.linalg.norm(np.diff(places, axis=0), axis=1) <= _FOLLOWS_M
    if follows.sum() < LEAST_POINTS:
        return 0.0
    in_space = residuals[:-1] - residuals[other]
    in_file = np.diff(residuals)
    excess = 0.5 * (in_space**2 - in_file**2)[follows]
    variance = float(excess.mean())
    if variance < _SURE * float(excess.std()) / np.sqrt(len(excess)):
        return 0.0
    return float(np.sqrt(variance))
