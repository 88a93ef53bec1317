"""What the points of a model say of the matches between its photos.

Two photos that look at the same have matches whose points, as the model has them from one of them, lie where the other
one sees them. That is more than agreeing with the epipolar lines: litter, bark and rows of stems repeat along them, and
a photo is put metres on by matches that all lie on their lines.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsinfer.poses.colmap_calls import open_database
from fsinfer.poses.pairs import MIN_INLIERS

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class PointVote:
    """Two photos by COLMAP's numbers, the smaller first, and their matches.

    Attributes
    ----------
    points: how often a feature of a match has a point in the model, in either photo.
    error: how far from the feature of the other photo those points are seen in it, median, in focal lengths; infinite
        behind it, NaN without points.
    """

    first: int
    second: int
    matches: int
    points: int
    error: float


def point_votes(model: Any, database: Path, only: Collection[tuple[int, int]] | None = None) -> list[PointVote]:
    """The votes of all pairs of placed photos of a ``pycolmap.Reconstruction`` whose matches count in ``database``.

    ``only``: of these pairs, by COLMAP's numbers, the smaller first.
    """
    return list(_votes(model, database, only))


def agreeing_share(votes: Sequence[PointVote], within: float) -> float:
    """Share of the matches of these pairs whose error is below ``within`` focal lengths; 0 where there are none."""
    cast = sum(vote.matches for vote in votes)
    return sum(vote.matches for vote in votes if vote.error < within) / cast if cast else 0.0


def _votes(model: Any, database: Path, only: Collection[tuple[int, int]] | None) -> Iterator[PointVote]:
    import pycolmap

    placed = set(model.reg_image_ids())
    with open_database(database) as opened:
        rays = {i: _rays(model, i, opened.read_keypoints(i)) for i in sorted(placed)}
        points = _points_of_features(model, {i: len(found) for i, found in rays.items()})
        poses = {i: np.asarray(model.images[i].cam_from_world().matrix(), np.float64) for i in placed}
        for pair_id, count in zip(*opened.read_two_view_geometry_num_inliers(), strict=True):
            first, second = pycolmap.pair_id_to_image_pair(pair_id)
            if count < MIN_INLIERS or first not in placed or second not in placed:
                continue
            if only is not None and (first, second) not in only:
                continue
            matches = np.asarray(opened.read_two_view_geometry(first, second).inlier_matches, np.intp)
            errors = [
                _errors(points[one][matches[:, k]], poses[other], rays[other][matches[:, 1 - k]])
                for k, (one, other) in enumerate(((first, second), (second, first)))
            ]
            both = np.concatenate(errors)
            yield PointVote(
                first=first,
                second=second,
                matches=len(matches),
                points=len(both),
                error=float(np.median(both)) if len(both) else float("nan"),
            )


def _rays(model: Any, image_id: int, keypoints: Any) -> Floats:
    """Of the features of a photo (N, 2), in focal lengths and without distortion."""
    camera = model.cameras[model.images[image_id].camera_id]
    return np.asarray(camera.cam_from_img(np.asarray(keypoints, np.float64)[:, :2]), np.float64).reshape(-1, 2)


def _points_of_features(model: Any, count: dict[int, int]) -> dict[int, Floats]:
    """Of each photo's features (N, 3) the point that it sees, NaN where it sees none."""
    points = {image_id: np.full((features, 3), np.nan) for image_id, features in count.items()}
    for point in model.points3D.values():
        xyz = point.xyz
        for element in point.track.elements:
            points[element.image_id][element.point2D_idx] = xyz
    return points


def _errors(points: Floats, pose: Floats, rays: Floats) -> Floats:
    """How far from the rays (N, 2) of a photo the points (N, 3) are seen in it, where there is one; (K,).

    A ray that the lens model has no answer for is passed over.
    """
    known = np.isfinite(points[:, 0]) & np.isfinite(rays).all(axis=1)
    at = points[known] @ pose[:, :3].T + pose[:, 3]
    ahead = at[:, 2] > 0
    seen = at[:, :2] / np.where(ahead, at[:, 2], 1.0)[:, None]
    return np.where(ahead, np.linalg.norm(seen - rays[known], axis=1), np.inf)
