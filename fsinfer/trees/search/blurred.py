"""Stems whose walls are blurred: another search, with more noise, among the points that belong to no stem yet.

A stem that was photographed from afar only, from two ends of the walk, stands in the cloud as two walls some
centimetres apart, which is too rough for the first search. More noise there would let shrubs pass; what is taken here
has to stand as high and as far round as a shrub does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fsinfer.trees.cylinder.axis import AxisSettings
from fsinfer.trees.search.remaining import search_again
from fsinfer.trees.search.stem import Stem, StemSettings
from fsinfer.trees.search.verify import INDEX_CELL_M

Floats = NDArray[np.float64]
#: Least radius, metres, share of the girth seen, and metres of supported height. Source: renders only, the undergrown
#: plots of seeds 955022 to 955024: what is left there beside the stems found and has all of it is a stem; shrubs are
#: lower, the rims of other stems thinner or seen from one side.
LEAST_RADIUS_M, LEAST_ARC, LEAST_LENGTH_M = 0.1, 0.5, 1.8
#: What stands as near to a stem, or to a stronger candidate, is its ghost, metres. Source: renders only, as before.
APART_M = 0.3
#: The fit may find so many times the noise that is allowed, so that more can be told from as much. Source: numerics.
BEYOND = 1.1


def find_blurred(thinned: Floats, stems: Sequence[Stem], cell_m: float, s: StemSettings) -> list[Stem]:
    """Stems with more noise than the first search allows among points (N, 3) of x, y, height above ground, metres.

    ``stems`` are those found; the points and ``cell_m`` are those of the first search.
    """
    if s.blurred_sigma_m <= s.max_sigma_m:
        return []
    own = replace(
        s,
        radius_m=(max(LEAST_RADIUS_M, s.radius_m[0]), s.radius_m[1]),
        min_arc=max(LEAST_ARC, s.min_arc),
        min_length_m=max(LEAST_LENGTH_M, s.min_length_m),
        max_sigma_m=s.blurred_sigma_m,
    )
    usual = AxisSettings()
    axis = replace(usual, sigma_m=(usual.sigma_m[0], max(BEYOND * s.blurred_sigma_m, usual.sigma_m[1])))
    found = search_again(thinned, stems, cell_m, own, index_cell_m=INDEX_CELL_M, apart_m=APART_M, axis=axis)
    # What is no more blurred than other stems, the first search has refused for another reason.
    return [stem for stem in found if stem.axis.sigma_m > s.max_sigma_m]
