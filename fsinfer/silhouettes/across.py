"""What is roughly known of a stem without a size: how wide is what stands at its place below breast height.

Circles and edges go through the twigs of a sapling as if it were a tree. But no stem is thicker at breast height than
it is below, and where its foot is free of twigs the cloud has it about as narrow as it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from fsinfer.notices.notice import notice
from fsinfer.notices.stems import StemCode
from fsinfer.trees import Section, Tree
from fsinfer.trees.rough_dbh import rough_dbh_cm

Floats = NDArray[np.float64]

#: Heights above the foot where layers begin, metres, and how high each is: above herbs and roots, up to breast height.
#: Source: judgement.
LAYERS_M, LAYER_M = (0.4, 0.7, 1.0), 0.3
#: What stands so far from the place may be the stem's, metres. Source: renders only, saplings of three plots of another
#: renderer stand up to 0.3 m from where their twigs were taken for a stem.
REACH_M = 0.3
#: Points that are so near to each other in plan, metres, are of one thing. Source: judgement; a few times as far as
#: neighbours on bark in a cloud of photographs.
LINK_M = 0.02
#: A layer shows something by so many points and such a share of its own in one thing. Source: judgement; of a stem seen
#: from far away scraps are left, which are narrower.
LEAST_POINTS, LEAST_SHARE = 20, 0.3
#: Points so near to the surface of a measured stem are its own, metres. Source: judgement; noise and bent stems.
OF_OTHERS_M = 0.05


def with_sizes_below(pairs: Sequence[tuple[Tree, Section]], xyz: Floats) -> list[tuple[Tree, Section]]:
    """The stems, those of whose size nothing is known with what stands below them in the cloud (N, 3), metres."""
    measured = [section for _, section in pairs if section.dbh_m is not None]
    levels = [tree.z_ground_m for tree, section in pairs if section.dbh_m is not None]
    told = []
    for tree, section in pairs:
        if section.dbh_m is None and rough_dbh_cm(tree) is None:
            place = np.array([tree.x_m, tree.y_m, tree.z_ground_m])
            near = _without(_about(xyz, place), place, measured, levels)
            across = across_m(near - place)
            if across is not None:
                reasons = (*tree.reasons, notice(StemCode.stands_across, across_cm=100.0 * across))
                told.append((replace(tree, reasons=reasons), replace(section, reasons=reasons)))
                continue
        told.append((tree, section))
    return told


def across_m(points: Floats) -> float | None:
    """Width of the thing that is narrowest among those of the layers, metres; None where no layer shows one.

    ``points`` (N, 3) are about the foot of a stem, z up, metres.
    """
    height = points[:, 2]
    layers = [points[(height >= low) & (height < low + LAYER_M), :2] for low in LAYERS_M]
    return min((width for width in map(_width, layers) if width is not None), default=None)


def _about(xyz: Floats, place: Floats) -> Floats:
    away = np.abs(xyz[:, :2] - place[:2])
    return np.asarray(xyz[(away <= REACH_M).all(axis=1)])


def _without(points: Floats, place: Floats, stems: Sequence[Section], levels: Sequence[float]) -> Floats:
    """Of points (M, 3) those that are of none of the measured ``stems`` whose feet are at the ``levels``."""
    for stem, level in zip(stems, levels, strict=True):
        reach = (stem.dbh_m or 0.0) / 2.0 + OF_OTHERS_M
        if float(np.linalg.norm(stem.center - place[:2])) < 3.0 * REACH_M + reach:
            up = (points[:, 2] - level - stem.bh_m)[:, None]
            points = points[np.linalg.norm(points[:, :2] - stem.center - up * stem.slope, axis=1) > reach]
    return points


def _width(xy: Floats) -> float | None:
    """Of the thing with most of the points (M, 2), along its longer axis and without the strays at its ends."""
    if len(xy) < LEAST_POINTS:
        return None
    pairs = cKDTree(xy).query_pairs(LINK_M, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs), dtype=bool), (pairs[:, 0], pairs[:, 1])), shape=(len(xy), len(xy)))
    thing = connected_components(graph, directed=False)[1]
    counts = np.bincount(thing)
    if counts.max() < max(LEAST_POINTS, LEAST_SHARE * len(xy)):
        return None
    own = xy[thing == counts.argmax()]
    own = own - own.mean(axis=0)
    along = own @ np.linalg.eigh(own.T @ own)[1][:, 1]
    low, high = np.percentile(along, (2.5, 97.5))
    return float(high - low)
