"""Whether the points of two parts lie on each other."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from fsinfer.geometry.similarity import Floats, apply

#: One board alone is believed where this share of the part's points lies near points of the model, and so many times
#: more than after half a turn; near is this share of the usual distance between points. Fewer points tell nothing.
#: Source: judgement.
LEAST_NEAR, TIMES_TURNED, _NEAR_STEPS, _FEWEST_POINTS = 0.12, 2.0, 0.5, 100
#: Points at which the usual distance is looked at. Source: numerics.
_MOST_PROBES = 2000


def near_shares(model: Any, part: Any, where: Floats, middle: Floats) -> tuple[float, float]:
    """Shares of the part's points that lie on those of the model: at its place, and after half a turn.

    One board may hang on the wrong side of a pair (the same number on both faces): then the part lies turned by half
    a circle, and its points beside those of the model. What the place is held against is that half turn about the
    upright through the board, ``middle``.
    """
    if min(model.num_points3D(), part.num_points3D()) < _FEWEST_POINTS:
        return 0.0, 0.0
    ours = np.array([point.xyz for point in model.points3D.values()])
    theirs = apply(where, np.array([point.xyz for point in part.points3D.values()]))
    tree = cKDTree(ours)
    up = mean_up(model)
    turn = 2 * np.outer(up, up) - np.eye(3)  # half a turn about the upright
    step = float(np.median(tree.query(ours[:: max(1, len(ours) // _MOST_PROBES)], k=2)[0][:, 1]))
    reach = _NEAR_STEPS * step
    near = float((tree.query(theirs)[0] < reach).mean())
    return near, float((tree.query((theirs - middle) @ turn.T + middle)[0] < reach).mean())


def mean_up(model: Any) -> Floats:
    """Mean direction to the sky of the photos of a model, (3,): against their downward axes."""
    ups = np.array([-model.images[i].cam_from_world().rotation.matrix()[1] for i in model.reg_image_ids()])
    mean: Floats = ups.mean(axis=0) / np.linalg.norm(ups.mean(axis=0))
    return mean
