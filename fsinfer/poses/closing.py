"""A walk that was followed from photo to photo is closed: where it comes back to a place, its photos see one point.

By the pairs next to each other alone a walk drifts. To map it once more by all pairs that it tells to be true took as
long as following it and half as long again; from where it has drifted to one adjustment brings it back, for the true
pairs tell the same everywhere. Whether it did is asked of these pairs.
"""

from __future__ import annotations

import logging
from collections.abc import Set as AbstractSet
from copy import deepcopy
from pathlib import Path
from typing import Any

from fsinfer.poses.chain import FEWEST_POINTS
from fsinfer.poses.refinement import adjust_to_judge, larger_than_usual
from fsinfer.poses.thinning import add_points, join_points
from fsinfer.poses.verification.point_votes import agreeing_share, point_votes

_log = logging.getLogger(__name__)

#: Observations farther off go, pixels of photos no larger than those that features are looked for in, and points whose
#: rays meet at less. Source: COLMAP's mapper.
_MOST_ERROR_PX, _LEAST_ANGLE_DEG = 4.0, 1.5
#: A true pair is right where its points are seen within so many focal lengths. Source: numerics; as far as an
#: observation may be off, 4 of some 1,000 pixels.
_RIGHT = 0.004
#: Share of the true pairs' matches that must be right. Source: judgement; all but a thousandth of a rendered walk of
#: 300 photos that had drifted by 8 to 12 cm, 0.93 to 0.98 before it was closed; renders only.
_CLOSED = 0.99
#: The mean error may grow by this factor: photos of another visit see a point from elsewhere. Source: numerics; 1.07 to
#: 1.10 of that walk, and from 1.4 on of synthetic ones that had to be adjusted once more.
_MOST_WORSE = 1.25
#: Adjustments at most; what is not closed then is mapped anew. Source: numerics; synthetic walks that drift by one to
#: five pixels from photo to photo are closed by one, or by two.
_MOST_ROUNDS = 2


def closed(followed: Any, true: AbstractSet[tuple[int, int]], database: Path) -> Any | None:
    """A followed walk with the points of all matches, adjusted to them; None where true pairs are wrong in it.

    Parameters
    ----------
    followed: ``pycolmap.Reconstruction`` of :func:`fsinfer.poses.chain.follow_walk`. true: pairs by COLMAP's numbers of
        their photos, the smaller first. database: with the matches of all pairs but those that are false or doubted.
    """
    import pycolmap

    model = deepcopy(followed)
    # A feature that has a point where the walk drifted to would keep that of another visit away.
    for number in list(model.points3D):
        model.delete_point3D(number)
    add_points(model, database)
    error = followed.compute_mean_reprojection_error()
    most_px = _MOST_ERROR_PX * larger_than_usual(model)
    for _ in range(_MOST_ROUNDS):
        adjust_to_judge(model)
        join_points(model, database)
        pycolmap.ObservationManager(model).filter_all_points3D(most_px, _LEAST_ANGLE_DEG)
        share, worse = right_share(model, true, database), model.compute_mean_reprojection_error() / error
        _log.info("%.3f of the true pairs' matches are right, and errors %.2f of what they were", share, worse)
        if share >= _CLOSED and worse <= _MOST_WORSE:
            return model
    return None


def right_share(model: Any, true: AbstractSet[tuple[int, int]], database: Path) -> float:
    """Share of the matches of true pairs whose points are seen where they should be; 0 where there are none."""
    votes = [vote for vote in point_votes(model, database, true) if vote.points >= FEWEST_POINTS]
    return agreeing_share(votes, _RIGHT)
