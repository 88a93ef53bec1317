"""Stems whose walls are blurred: another search, with more noise, among the points that belong to no clear stem.

A stem that was photographed from afar only, from two ends of the walk, stands in the cloud as two walls some
centimetres apart, or as a haze, which is too rough for the first search. More noise there would let shrubs pass; what
is taken here has to stand as high and as far round as a shrub does not.

In such a haze fits from neighbouring places end differently, and the first search takes the first that passes, which
may stand half beside the stem, or sees none pass. So its rough stems are looked for again, and the better one counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fsinfer.trees.cylinder.axis import AxisSettings
from fsinfer.trees.search.remaining import apart, search_again
from fsinfer.trees.search.stem import Stem, StemSettings
from fsinfer.trees.search.verify import INDEX_CELL_M, Gradient

Floats = NDArray[np.float64]
#: Least radius, metres, share of the girth seen, and metres of supported height. Source: renders only, the undergrown
#: plots of seeds 955022 to 955024: what is left there beside the stems found and has all of it is a stem; shrubs are
#: lower, the rims of other stems thinner or seen from one side.
LEAST_RADIUS_M, LEAST_ARC, LEAST_LENGTH_M = 0.1, 0.5, 1.8
#: What stands as near to a stem, or to a stronger candidate, is its ghost, metres. Source: renders only, as before.
APART_M = 0.3
#: The fit may find so many times the noise that is allowed, so that more can be told from as much. Source: numerics.
BEYOND = 1.1


def with_blurred(
    thinned: Floats, stems: Sequence[Stem], cell_m: float, s: StemSettings, gradient_at: Gradient = np.zeros_like
) -> list[Stem]:
    """The ``stems`` found among points (N, 3) of x, y, height above ground, metres, and those that are blurred.

    A rough one of ``stems`` gives way to a better one in its place. The points, ``cell_m``, and ``gradient_at``, the
    slope of the ground, are those of the first search.
    """
    if s.blurred_sigma_m <= s.max_sigma_m:
        return list(stems)
    own = replace(
        s,
        radius_m=(max(LEAST_RADIUS_M, s.radius_m[0]), s.radius_m[1]),
        min_arc=max(LEAST_ARC, s.min_arc),
        min_length_m=max(LEAST_LENGTH_M, s.min_length_m),
        max_sigma_m=s.blurred_sigma_m,
    )
    usual = AxisSettings()
    axis = replace(usual, sigma_m=(usual.sigma_m[0], max(BEYOND * s.blurred_sigma_m, usual.sigma_m[1])))
    clear = [stem for stem in stems if stem.axis.sigma_m <= s.rough_m]
    rough = [row for row, stem in enumerate(stems) if stem.axis.sigma_m > s.rough_m]
    result = list(stems)
    for found in search_again(
        thinned, clear, cell_m, own, index_cell_m=INDEX_CELL_M, gradient_at=gradient_at, apart_m=APART_M, axis=axis
    ):
        near = [row for row in rough if not apart(found, stems[row], APART_M)]
        if not near:
            result.append(found)
        elif len(near) == 1 and not apart(found, stems[near[0]], 0.0) and found.quality > stems[near[0]].quality:
            result[near[0]] = found
    return result
