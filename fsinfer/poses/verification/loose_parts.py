"""Parts of a model that hang on the rest by a handful of points.

A part of the walk whose photos share hundreds of points among themselves but only a few dozen with all other photos is
joined by a hinge: a few false matches or a poor view turn it by degrees, and no reprojection error shows it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from fsinfer.poses.verification.spanning_tree import cut, strongest_ties, tie_graph

#: Points that a part must share with the rest. Source: in models that were right no part of two photos or more shared
#: fewer than 124 (two rendered videos, five rendered plots, 23 phone photos); parts of three wrong ones that were
#: turned shared 45 to 84.
MIN_POINTS = 100
#: A single photo is placed by its own points: it turns nothing but itself, and consistency judges its depth. Source:
#: this reasoning.
MIN_PHOTOS = 2


def loose_parts(
    points: NDArray[np.intp],
    photos: NDArray[np.intp],
    count: int,
    *,
    min_points: int = MIN_POINTS,
    min_photos: int = MIN_PHOTOS,
) -> NDArray[np.bool_]:
    """Whether each of ``count`` photos belongs to a part that is loosely joined to the largest one, (count,) bool.

    Parameters
    ----------
    points, photos: (K,) number of the point and of the photo of every observation.
    min_points: points that are seen from both sides of a firm joint.
    min_photos: smaller parts are not looked at.

    Notes
    -----
    Joints are looked for along the maximum spanning tree of the photos, whose edges count the points two photos share:
    the edge of the tree between two parts is the best pair across any cut between them. Cut first at the weakest edge,
    the smaller part is loose where too few points are seen from both its sides; where the two halves of a model hang
    on each other by a hinge, the larger one stays.
    """
    _, rows = np.unique(points, return_inverse=True)
    height = int(rows.max()) + 1 if len(rows) else 0
    sees = csr_array((np.ones(len(rows)), (rows, photos)), shape=(height, count))
    sees.data[:] = 1.0  # a photo may see a point twice
    shared = (sees.T @ sees).tocoo()
    off = shared.row != shared.col
    tree = strongest_ties(tie_graph(shared.row[off], shared.col[off], shared.data[off], count))
    loose = np.zeros(count, dtype=bool)
    for edge in np.argsort(-tree.data, kind="stable"):
        if 1.0 / tree.data[edge] >= min_points:
            break  # this pair alone is joint enough
        side, other = (part & ~loose for part in cut(tree, edge))
        small = side if side.sum() <= other.sum() else other
        large = other if small is side else side
        if small.sum() < min_photos:
            continue
        both = (sees[:, small].sum(axis=1) > 0) & (sees[:, large].sum(axis=1) > 0)
        if int(both.sum()) < min_points:
            loose |= small
    return loose
