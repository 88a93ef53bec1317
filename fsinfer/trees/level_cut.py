"""Crowns that end at one level: not the trees end there, but the cloud, which somebody has cut.

A single crown does not tell its cut from its top: below a cut the stem and the branches make layers that are denser
than the last one, as below a top. Several that end at the same height, with as many points in the last layer as in the
one below it, do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fsinfer.notices.notice import Notice, notice
from fsinfer.notices.stems import StemCode
from fsinfer.trees.diameter.section import Section
from fsinfer.trees.points.cells import rows, thin
from fsinfer.trees.tree import Tree

Floats = NDArray[np.float64]
#: Tops that lie within this of the highest are at one level, metres, and so many make a cut. Source: two real scans cut
#: off at 12 m have 9 and 12 of them, whole ones the highest alone; the three tallest of a hundred trees whose heights
#: scatter by 1 m are so by chance in 1 % of stands.
_LEVEL_M, _LEAST_TOPS = 0.05, 3
#: Points in the last layer of this height, metres, over those in the one below it, from which on the cloud was cut: a
#: canopy thins out. Source: those scans, 0.7 to 1.0 where they are cut and 0.2 and 0.4 where they are whole.
_LAYER_M, _LEAST_SHARE = 0.25, 0.6
#: Points in the layer above over those in the last one, from which on the cloud goes on. Source: judgement; of a cut
#: cloud as many as lie between the highest top and the cut.
_MOST_ABOVE = 0.5
#: Points are thinned to cells of this width before, metres. Source: numerics; as crowns are.
_CELL_M = 0.05
#: Tops this near below the level may be cut as well, metres. Source: judgement; two layers.
_NEAR_M = 0.5

Pair = tuple[Tree, Section]


@dataclass(frozen=True, kw_only=True)
class Uncut:
    """The stems with their heights, those that a cut made taken away, its z (None without one), and what to say."""

    pairs: list[Pair]
    level_m: float | None = None
    told: tuple[Notice, ...] = ()


def without_cut_tops(pairs: Sequence[Pair], points: Floats) -> Uncut:
    """The ``pairs`` in their order, without the heights of those that end where the cloud of (N, 3) was cut off level.

    Heights are z of the cloud, metres.
    """
    tops = _tops(pairs)
    level = float(np.nanmax(tops)) if np.isfinite(tops).any() else np.nan
    if np.count_nonzero(level - tops <= _LEVEL_M) < _LEAST_TOPS or not _ends_at(level, points):
        return Uncut(pairs=list(pairs))
    told = notice(StemCode.cut_off_level, stems=int(np.count_nonzero(level - tops <= _NEAR_M)))
    return Uncut(pairs=without_tops_at(level, pairs), level_m=level, told=(told,))


def without_tops_at(level_m: float, pairs: Sequence[Pair]) -> list[Pair]:
    """The ``pairs`` in their order, without the heights of those that end at the z of a cut, metres."""
    cut = level_m - _tops(pairs) <= _NEAR_M
    return [
        (replace(tree, height_m=None) if ends else tree, section)
        for (tree, section), ends in zip(pairs, cut, strict=True)
    ]


def _tops(pairs: Sequence[Pair]) -> Floats:
    """z of the tops (T,), NaN where none was seen."""
    return np.array([tree.z_ground_m + (np.nan if tree.height_m is None else tree.height_m) for tree, _ in pairs])


def _ends_at(level_m: float, points: Floats) -> bool:
    """Whether the last layer of points (N, 3) below a level is nearly as full as the one below it, that above is not.

    Trees whose tops were not seen may reach above the highest that was: there the cloud goes on.
    """
    near = np.abs(points[:, 2] - (level_m - 0.5 * _LAYER_M)) <= 1.5 * _LAYER_M
    heights = thin(rows(points, near), _CELL_M)[:, 2]
    above = np.count_nonzero(heights > level_m)
    last = np.count_nonzero(heights > level_m - _LAYER_M) - above
    return bool(last >= _LEAST_SHARE * (len(heights) - last - above) and above < _MOST_ABOVE * last)
