"""Stems too thick for the search: a second, coarser one among the points that belong to no stem yet.

A wider range of radii in the first search would make it slower for everybody, and would let rows of shrubs and thin
stems pass for a part of a large circle. What is taken for a giant here has to be seen over more of its girth and over
more of its height, and nothing may stand within it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fsinfer.trees.points.cells import thin
from fsinfer.trees.search.remaining import search_again
from fsinfer.trees.search.stem import Stem, StemSettings
from fsinfer.trees.search.verify import Gradient

Floats = NDArray[np.float64]
#: Cells of the search, metres, and of its index: the wall of a stem of more than a metre is straight over several of
#: them. Source: geometry.
CELL_M, INDEX_CELL_M = 0.04, 1.0
#: Radii overlap those of the first search by this share, so that nothing falls between. Source: geometry.
OVERLAP = 0.9
#: Votes a band: three times those of the first search, of whose cells a giant fills more. Source: geometry.
VOTES = 3.0
#: Share of the girth seen, metres of supported height, share of the ring in a start, and of points well inside.
#: Source: simulated stems of 1.4 to 2.4 m, seeds 43000 to 43011; a quarter of the girth tells a curve from a bank.
LEAST_ARC, LEAST_LENGTH_M, LEAST_RING, MOST_FILLED = 0.25, 1.2, 0.15, 0.1
#: A stem of the first search is thick from this radius on, metres. Source: renders only, seed 955025: an arc of shrubs
#: with a radius of 59 cm, seen over 1.0 m and 65 degrees.
THICK_M = 0.3
#: Candidates looked at, strongest first: a hectare of giants has fewer. Source: numerics.
MOST = 200


def find_giants(
    slab: Floats, stems: Sequence[Stem], spacing_m: float, s: StemSettings, gradient_at: Gradient = np.zeros_like
) -> tuple[Stem, ...]:
    """Stems of more than the first search's radius among points (N, 3) of x, y, height above ground, metres.

    ``stems`` are those found; ``spacing_m`` is that of the points; ``gradient_at`` gives the slope of the ground. None
    overlaps another or a stem.
    """
    if s.giant_radius_m <= s.radius_m[1] or len(slab) < s.min_points:
        return ()
    own = replace(
        s,
        radius_m=(OVERLAP * s.radius_m[1], s.giant_radius_m),
        cell_m=CELL_M,
        min_votes=VOTES * s.min_votes,
        min_arc=max(LEAST_ARC, s.min_arc),
        min_length_m=max(LEAST_LENGTH_M, s.min_length_m),
        min_ring=max(LEAST_RING, s.min_ring),
        max_filled=min(MOST_FILLED, s.max_filled),
    )
    cell_m = max(CELL_M, spacing_m)
    return search_again(
        thin(slab, 0.5 * cell_m), stems, cell_m, own, index_cell_m=INDEX_CELL_M, gradient_at=gradient_at, most=MOST
    )


def is_no_giant(stem: Stem, coverage: float, s: StemSettings) -> bool:
    """Whether a thick stem shows less of its girth at breast height, and of its height, than it has to.

    ``coverage`` is the share that its section shows. Shrubs that stand in an arc pass for a part of a large circle
    over some layers; where they have no diameter either, nothing is left of them. Of stems that the first search looks
    for as well, those are meant that are thick and not seen over the height that a giant has to have.
    """
    radius = stem.axis.radius_m
    low = radius > THICK_M and stem.length_m < LEAST_LENGTH_M
    return (radius > s.radius_m[1] or low) and coverage < LEAST_ARC
