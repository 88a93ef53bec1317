"""Where a part of a walk lies in the rest, from matches between photos of both.

What both photos of such a match saw has a place in each part: a similarity takes the one to the other. Matches between
trees that look alike, and points so far away that they have no depth, are in the majority now and then, so that the
place is looked for by random samples (Fischler and Bolles 1981) and its error is measured in the photos.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsinfer.geometry.similarity import Floats, apply, fit_similarity
from fsinfer.poses.colmap_calls import open_database
from fsinfer.poses.pairs import MIN_INLIERS

#: A point agrees where it is seen within this share of the focal length in the photos of both; about eight pixels of a
#: photo of 1280. Source: judgement; parts have drifted a little, each in its own way.
_REACH = 0.008
#: Trials, and how many matches of one pair take part in them. Source: numerics; four samples of 500 are all true where
#: one match of five is, and one pair must not outvote all others.
_TRIALS, _MOST_OF_A_PAIR = 1500, 60
#: Fewer points than this are no evidence. Source: judgement; four fix a similarity and test it once.
_FEWEST = 8


@dataclass(frozen=True, kw_only=True)
class Seen:
    """Points of one part and the photo of the other part, each of a match, that sees the same.

    Attributes
    ----------
    points: (N, 3), in the part's own frame.
    rotation, shift: (N, 3, 3) and (N, 3), ``cam_from_world`` of the photo of this part that belongs to the match.
    rays: (N, 2), where it is seen there, in focal lengths and without distortion.
    photo: (N,), id of that photo.
    """

    points: Floats
    rotation: Floats
    shift: Floats
    rays: Floats
    photo: NDArray[np.intp]

    def errors(self, points: Floats) -> Floats:
        """Of points (N, 3) in this part's frame, seen in its photos: (N,) in focal lengths, infinite behind them."""
        at = np.einsum("nij,nj->ni", self.rotation, points) + self.shift
        ahead = at[:, 2] > 0
        seen = at[:, :2] / np.where(ahead, at[:, 2], 1.0)[:, None]
        return np.where(ahead, np.linalg.norm(seen - self.rays, axis=1), np.inf)

    def chosen(self, which: NDArray[Any]) -> Seen:
        """Those of an index or a mask."""
        return Seen(**{field.name: getattr(self, field.name)[which] for field in fields(self)})


class CommonPoints:
    """The points of a part that the model has, too, by the matches of their photos.

    Attributes
    ----------
    ours, theirs: the N points as the model and as the part have them. pair: (N,), number of the pair of photos that
        each comes from.
    """

    def __init__(self, ours: Seen, theirs: Seen, pair: NDArray[np.intp]) -> None:
        self.ours, self.theirs, self.pair = ours, theirs, pair

    @classmethod
    def of(cls, model: Any, part: Any, database: Path) -> CommonPoints:
        """Of each match between a photo of the model and one of the part whose features both have a point.

        Parameters
        ----------
        model, part: ``pycolmap.Reconstruction`` of photos of ``database``, with the features that it holds.
        """
        ours, theirs = _Lookup(model), _Lookup(part)
        pairs = []
        both: tuple[list[Seen], list[Seen]] = ([], [])
        for number, (first, second, matches) in enumerate(_cross_matches(model, part, database)):
            known = (ours.point_ids(first)[matches[:, 0]] >= 0) & (theirs.point_ids(second)[matches[:, 1]] >= 0)
            both[0].append(ours.seen(first, matches[known, 0]))
            both[1].append(theirs.seen(second, matches[known, 1]))
            pairs.append(np.full(int(known.sum()), number, np.intp))
        return cls(_joined(both[0]), _joined(both[1]), np.concatenate([np.zeros(0, np.intp), *pairs]))

    @classmethod
    def none(cls) -> CommonPoints:
        """No points."""
        return cls(_joined([]), _joined([]), np.zeros(0, np.intp))

    def few_of_each_pair(self) -> CommonPoints:
        """Without most of the points of a pair of photos that has many, so that none outvotes all others."""
        order = np.random.default_rng(0).permutation(len(self.pair))
        return self.chosen(np.sort(order[_rank_within(self.pair[order]) < _MOST_OF_A_PAIR]))

    def chosen(self, which: NDArray[Any]) -> CommonPoints:
        """Those of an index or a mask."""
        return CommonPoints(self.ours.chosen(which), self.theirs.chosen(which), self.pair[which])

    def agrees(self, place: Floats, times: float = 1.0) -> NDArray[np.bool_]:
        """Whether each point lies where it was seen, within so many times the usual reach, (N,)."""
        return np.asarray(np.maximum(*self.errors(place)) < times * _REACH)

    def errors(self, place: Floats) -> tuple[Floats, Floats]:
        """Of the part's points in the model's photos, and of the model's in the part's, (N,) each, in focal lengths."""
        back = np.asarray(np.linalg.inv(place), np.float64)
        return self.ours.errors(apply(place, self.theirs.points)), self.theirs.errors(apply(back, self.ours.points))

    def photos(self, which: NDArray[np.bool_]) -> int:
        """Photos of the model, and of the part, that these points are in; the fewer of both."""
        return min(len(np.unique(seen.photo[which])) for seen in (self.ours, self.theirs))

    def places(self) -> Iterator[Floats]:
        """Similarities (4, 4) from the part to the model, each of three points, with which some others agree."""
        if len(self.pair) < _FEWEST:
            return
        rng = np.random.default_rng(0)
        for _ in range(_TRIALS):
            three = rng.choice(len(self.pair), 3, replace=False)
            found = fit_similarity(self.theirs.points[three], self.ours.points[three])
            if found is not None and int(self.agrees(found).sum()) >= _FEWEST:
                yield found


def _cross_matches(model: Any, part: Any, database: Path) -> Iterator[tuple[int, int, NDArray[np.intp]]]:
    """(photo of the model, photo of the part, matches (N, 2) in that order) of each pair that passed the check."""
    import pycolmap

    ours = set(model.reg_image_ids())
    theirs = set(part.reg_image_ids()) - ours
    with open_database(database) as opened:
        ids, counts = opened.read_two_view_geometry_num_inliers()
        for pair_id, count in zip(ids, counts, strict=True):
            first, second = pycolmap.pair_id_to_image_pair(pair_id)
            if count < MIN_INLIERS or not (
                (first in ours and second in theirs) or (second in ours and first in theirs)
            ):
                continue
            matches = np.asarray(opened.read_two_view_geometry(first, second).inlier_matches, np.intp)
            yield (first, second, matches) if first in ours else (second, first, matches[:, ::-1])


class _Lookup:
    """Points and rays of the features of a model's photos."""

    def __init__(self, model: Any) -> None:
        self._model = model
        self._ids: dict[int, NDArray[np.int64]] = {}

    def point_ids(self, photo: int) -> NDArray[np.int64]:
        """Of each feature of a photo the id of its point, -1 for none, (N,)."""
        if photo not in self._ids:
            features = self._model.images[photo].points2D
            self._ids[photo] = np.array([p.point3D_id if p.has_point3D() else -1 for p in features], np.int64)
        return self._ids[photo]

    def seen(self, photo: int, features: NDArray[np.intp]) -> Seen:
        image = self._model.images[photo]
        ids, count = self.point_ids(photo)[features], len(features)
        where = np.array([image.points2D[int(i)].xy for i in features], np.float64).reshape(-1, 2)
        rays = self._model.cameras[image.camera_id].cam_from_img(where) if count else where
        matrix = image.cam_from_world().matrix()
        return Seen(
            points=np.array([self._model.points3D[int(i)].xyz for i in ids], np.float64).reshape(-1, 3),
            rotation=np.broadcast_to(matrix[:, :3], (count, 3, 3)),
            shift=np.broadcast_to(matrix[:, 3], (count, 3)),
            rays=np.asarray(rays, np.float64).reshape(-1, 2),
            photo=np.full(count, photo, np.intp),
        )


def _joined(parts: list[Seen]) -> Seen:
    if not parts:
        none = np.zeros((0, 3))
        return Seen(points=none, rotation=np.zeros((0, 3, 3)), shift=none, rays=none[:, :2], photo=np.zeros(0, np.intp))
    return Seen(**{field.name: np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(Seen)})


def _rank_within(group: NDArray[np.intp]) -> NDArray[np.intp]:
    """Of each entry how many of its group stand before it, (N,)."""
    order = np.argsort(group, kind="stable")
    sorted_group = group[order]
    starts = np.flatnonzero(np.r_[True, sorted_group[1:] != sorted_group[:-1]]) if len(group) else np.zeros(0, np.intp)
    sizes = np.diff(np.r_[starts, len(group)])
    rank = np.empty(len(group), np.intp)
    rank[order] = np.arange(len(group)) - np.repeat(starts, sizes)
    return rank
