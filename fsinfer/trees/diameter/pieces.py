"""Whether a circle goes through one surface, or through several thin things that stand apart.

In a thicket there are circles through any three saplings, as round and as high as a stem. But bark goes on from where
it is seen to where something hides it, while saplings and shoots are as wide as they are deep: what lies on the circle
is several pieces, each not much wider than the scatter about it. A stem of which branches hide stripes has pieces that
are many times wider than its bark is rough.

Of a cloud that tells the errors of its points nothing is said here: haze has any shape, and the photographs show what
is a shrub.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsinfer.trees.diameter.circle import POINTS_A_SECTOR
from fsinfer.trees.points.surface import sector_of, well_seen

Floats = NDArray[np.float64]
#: Width of a sector, metres, and the greatest number of them. Source: judgement; thin shoots, which gaps of their own
#: width part.
SECTOR_M, SECTORS = 0.01, 72
#: Fewer sectors do not show gaps. Source: judgement; four pieces and as many gaps, two sectors each.
LEAST_SECTORS = 16
#: Points in the same square of this side, metres, across the stem count as one: those of a cloud that was thinned to
#: voxels stand in columns, which are no pieces. Source: half of ``SECTOR_M``.
PLACE_M = 0.005
#: Things that stand apart are so many pieces or more, whose mean width, weighted by itself, is less than so many times
#: the scatter. Source: simulated scans with thickets, ray-cast, apart from the simulators of the tests: rings of
#: saplings had 4 to 31, stems in four pieces and more 41 and above; a fork at breast height 45.
PIECES, WIDTH_SIGMAS = 4, 20.0
#: They leave more than so much of the circle free; what hides a stem of a rough scan in narrow stripes leaves it one.
#: Source: judgement; saplings of 2 to 4 cm, a decimetre apart and more.
FREE = 0.5


@dataclass(frozen=True, kw_only=True)
class Pieces:
    """How many pieces a wall is seen in, their mean width (weighted by itself; metres), and the share of the circle."""

    number: int
    width_m: float
    share: float

    def stand_apart(self, sigma_m: float) -> bool:
        """Whether they are several things and not one surface that scatters by ``sigma_m`` metres."""
        return self.number >= PIECES and self.width_m < WIDTH_SIGMAS * sigma_m and self.share < 1.0 - FREE


def pieces_of(offsets: Floats, radius_m: float) -> Pieces | None:
    """The pieces of a wall of points ``offsets`` (N, 2) from its axis, metres; None where they are too few to tell."""
    girth = 2.0 * np.pi * radius_m
    places = len(np.unique(np.floor(offsets / PLACE_M), axis=0))
    sectors = int(min(girth / SECTOR_M, SECTORS, places / POINTS_A_SECTOR))
    if sectors < LEAST_SECTORS:
        return None
    seen = well_seen(np.bincount(sector_of(offsets, sectors), minlength=sectors))
    if seen.all():
        return Pieces(number=1, width_m=girth, share=1.0)
    # From a gap on, so that no piece goes over the end.
    turned = np.roll(seen, -int(np.flatnonzero(~seen)[0])).astype(np.int64)
    steps = np.diff(turned, prepend=0, append=0)
    width = (np.flatnonzero(steps == -1) - np.flatnonzero(steps == 1)) * (girth / sectors)
    mean = float((width**2).sum() / width.sum())
    return Pieces(number=len(width), width_m=mean, share=float(seen.mean()))
