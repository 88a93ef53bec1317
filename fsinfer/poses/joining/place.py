"""The place of a part in the rest of the walk: what may tell it, and what speaks for it.

Places are proposed by boards (that both parts know, or that one knows and two photos of the other see), by points that
matches say are common, and by photos that both have. The one that most sightings of boards and most common points agree
with is the best; it is believed where the evidence is enough and no other place has nearly as much.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from itertools import chain, combinations_with_replacement
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from fsinfer.geometry.rotation import turn_deg
from fsinfer.geometry.similarity import Floats, apply, fit_similarity, rotation_of, scale_of
from fsinfer.poses.boards import Board, BoardSighting, by_number
from fsinfer.poses.joining.common_points import CommonPoints
from fsinfer.poses.joining.evidence import Evidence
from fsinfer.poses.joining.known_boards import KnownBoards
from fsinfer.poses.joining.overlap import LEAST_NEAR, TIMES_TURNED, mean_up, near_shares
from fsinfer.poses.joining.steps import Steps

_log = logging.getLogger(__name__)

#: Photos that two parts must have in common for a similarity from them. Source: two fix it, the third checks.
_COMMON_PHOTOS = 3
#: Boards nearer to each other than so many sides hang on one post. Source: judgement.
_ONE_POST = 4.0
#: Photos that both have agree where their centres lie within this share of their spread, and their directions within so
#: many degrees (medians). Source: judgement.
_CENTER_SHARE, _TURN_DEG = 0.1, 3.0
#: Directions to the sky of the photos of two parts may differ so much, degrees. Source: people hold a phone level
#: within some degrees, plots slope by some more.
_MAX_TILT_DEG = 30.0
#: Places differ where the turn between them is larger, in degrees, or the shift, in extents of the part. Source:
#: judgement.
_OTHER_TURN_DEG, _OTHER_SHIFT = 10.0, 0.25
#: So many of the best proposals are refined. Source: numerics.
_REFINED = 12
#: Errors, in focal lengths, beyond which they count less; and those that a place is refined with, in usual reaches.
#: Source: two pixels of a photo of 1280; the refinement begins far away.
_SOFT, _WIDE = 0.002, 3.0
#: Steps of a refinement at most. Source: numerics.
_STEPS = 30


class _Ties:
    """All that ties a part to the model."""

    def __init__(
        self,
        model: Any,
        part: Any,
        ours: Sequence[Board],
        theirs: Sequence[Board],
        sightings: Sequence[BoardSighting],
        *,
        points: CommonPoints,
        steps: Steps,
    ) -> None:
        self.model, self.part, self.ours, self.theirs, self.points, self.steps = (
            model, part, ours, theirs, points, steps
        )  # fmt: skip
        centers = np.array([part.images[i].projection_center() for i in part.reg_image_ids()])
        self.middle, self.extent = centers.mean(axis=0), _spread(centers)
        self._up, self._part_up = mean_up(model), mean_up(part)
        known = {board.number for board in ours}
        unknown = [board for board in self.theirs if board.number not in known]
        self.boards = [KnownBoards(ours, part, sightings), KnownBoards(unknown, model, sightings, back=True)]
        self.number = np.concatenate([known.number for known in self.boards])

    def places(self) -> Iterator[Floats]:
        of_photos = chain.from_iterable(known.places() for known in self.boards)
        proposed = chain(_of_boards(self.ours, self.theirs), of_photos, self.points.places())
        return (place for place in proposed if self._allowed(place))

    def _allowed(self, place: Floats) -> bool:
        cosine = self._up @ (rotation_of(place) @ self._part_up)
        tilt_deg = float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
        return tilt_deg <= _MAX_TILT_DEG and self.steps.same_pace(place)

    def differ(self, one: Floats, other: Floats) -> bool:
        """Whether two places of the part are not the same but for errors."""
        shift = float(np.linalg.norm(apply(one, self.middle) - apply(other, self.middle)))
        ratio = abs(np.log(scale_of(one) / scale_of(other)))
        return bool(
            turn_deg(rotation_of(one), rotation_of(other)) > _OTHER_TURN_DEG
            or shift > _OTHER_SHIFT * self.extent * scale_of(one)
            or ratio > _OTHER_SHIFT
        )

    def proposals(self) -> Iterator[tuple[Evidence, Floats]]:
        """Places with what speaks for each of them roughly."""
        for place in self.places():
            yield self.evidence(place, _WIDE), place

    def evidence(self, place: Floats, times: float = 1.0) -> Evidence:
        """What speaks for a place within so many times the usual reaches."""
        board, point = self.agrees(place, times), self.points.agrees(place, times)
        counts = [(board[self.number == n], n) for n in np.unique(self.number)]
        numbers = [n for found, n in counts if 2 * found.sum() >= len(found)]
        return Evidence(
            boards=len(numbers),
            sightings=int(board.sum()),
            missed=int((~board).sum()),
            points=int(point.sum()),
            photos=self.points.photos(point),
            goes_on=self.steps.go_on(place),
            ordered=self.steps.ordered,
        )

    def agrees(self, place: Floats, times: float = 1.0) -> NDArray[np.bool_]:
        """Whether each sighting of a known board fits, in the order of ``number``."""
        return np.concatenate([known.agrees(place, times) for known in self.boards])

    def refined(self, place: Floats) -> Floats:
        """With the least errors in the photos of both, of what agrees at least roughly."""
        for _ in range(3):
            near = self.points.agrees(place, _WIDE)
            board = self.agrees(place, _WIDE)
            if not board.any() and near.sum() < 3:
                return place
            place = self._adjusted(place, self.points.chosen(near), board)
        return place

    def _adjusted(self, place: Floats, points: CommonPoints, board: NDArray[np.bool_]) -> Floats:
        middle, unit = self.middle, self.extent or 1.0

        def placed(step: Floats) -> Floats:
            change: Floats = np.eye(4)
            change[:3, :3] = np.exp(step[6]) * Rotation.from_rotvec(step[:3]).as_matrix()
            change[:3, 3] = middle + unit * step[3:6] - change[:3, :3] @ middle
            return np.asarray(place @ change, np.float64)

        def residuals(step: Floats) -> Floats:
            now = placed(step)
            corners = np.concatenate([known.residuals(now) for known in self.boards])[board].ravel()
            errors = np.concatenate([corners, *points.errors(now)])
            return np.asarray(np.clip(errors, -1.0, 1.0), np.float64)

        found = least_squares(residuals, np.zeros(7), loss="soft_l1", f_scale=_SOFT, max_nfev=_STEPS)
        return placed(np.asarray(found.x, np.float64))


def find_place(
    model: Any,
    part: Any,
    ours: Sequence[Board],
    theirs: Sequence[Board],
    sightings: Sequence[BoardSighting],
    *,
    database: Path | None = None,
    walk: Sequence[str] = (),
    least_boards: int = 0,
) -> Floats | None:
    """The similarity (4, 4) that takes ``part`` to ``model``, or None where nothing trustworthy tells it.

    Parameters
    ----------
    model, part: ``pycolmap.Reconstruction``. ours, theirs: the boards in ``model`` and in ``part``.
    database: of the matches. walk: files in the order of walking. least_boards: that must speak for a place.
    """
    common = sorted(set(model.reg_image_ids()) & set(part.reg_image_ids()))
    if len(common) >= _COMMON_PHOTOS and not least_boards:
        found = _by_photos(model, part, common)
        if found is not None:
            return found
    points = CommonPoints.none() if database is None else CommonPoints.of(model, part, database).few_of_each_pair()
    ties = _Ties(model, part, ours, theirs, sightings, points=points, steps=Steps(model, part, walk))
    # Look-alike trees speak for false places with hundreds of points: what can never be believed is no proposal.
    proposed = [(evidence, place) for evidence, place in ties.proposals() if evidence.possible]
    proposed.sort(key=lambda entry: -entry[0].score)
    refined = [ties.refined(place) for _, place in _distinct(proposed, ties)]
    judged = sorted(((ties.evidence(place), place) for place in refined), key=lambda entry: -entry[0].balance)
    believed = [(evidence, place) for evidence, place in judged if _believed(ties, evidence, place)]
    if not believed:
        if judged:
            _log.info("a part of %d photos stays apart; the most speaks for %s", part.num_reg_images(), judged[0][0])
        return None
    evidence, best = believed[0]
    rivals = [other for other, place in believed if ties.differ(best, place)]
    if rivals and rivals[0].rivals(evidence):
        _log.info("a part of %d photos could lie in two places: %s, %s", part.num_reg_images(), evidence, rivals[0])
        return None
    if evidence.boards < least_boards:
        _log.info("a part of %d photos stays apart for now: %s", part.num_reg_images(), evidence)
        return None
    _log.info("a part of %d photos is joined: %s", part.num_reg_images(), evidence)
    return best


def _believed(ties: _Ties, evidence: Evidence, place: Floats) -> bool:
    if not evidence.boards:
        return evidence.enough(overlap=False)
    agreeing = set(ties.number[ties.agrees(place)])
    corners = [b.corners for b in ties.ours if b.number in agreeing]
    corners += [apply(place, b.corners) for b in ties.theirs if b.number in agreeing]
    middles = np.array([square.mean(axis=0) for square in corners])
    side = float(np.linalg.norm(corners[0][1] - corners[0][0]))
    overlap = False
    if np.linalg.norm(middles - middles[0], axis=1).max() < _ONE_POST * side:
        # Boards of one post that have the same number on both sides may be taken for each other's back.
        near, turned = near_shares(ties.model, ties.part, place, middles[0])
        overlap = near > LEAST_NEAR and near > TIMES_TURNED * turned
        if turned > LEAST_NEAR and turned > TIMES_TURNED * near:
            return False
    return evidence.enough(overlap)


def _distinct(proposed: Sequence[tuple[Evidence, Floats]], ties: _Ties) -> list[tuple[Evidence, Floats]]:
    """The best of each cluster of places, in their order; so many as are refined."""
    kept: list[tuple[Evidence, Floats]] = []
    for evidence, place in proposed:
        if evidence.score > 0 and all(ties.differ(place, other) for _, other in kept):
            kept.append((evidence, place))
            if len(kept) == _REFINED:
                break
    return kept


def _by_photos(model: Any, part: Any, common: Sequence[int]) -> Floats | None:
    """From the centres of photos that both have, if these and their directions agree."""
    ours = np.array([model.images[i].projection_center() for i in common])
    theirs = np.array([part.images[i].projection_center() for i in common])
    found = fit_similarity(theirs, ours)
    if found is None:
        return None
    residual = float(np.median(np.linalg.norm(apply(found, theirs) - ours, axis=1)))
    turns = [
        turn_deg(
            model.images[i].cam_from_world().rotation.matrix() @ rotation_of(found),
            part.images[i].cam_from_world().rotation.matrix(),
        )
        for i in common
    ]
    return found if residual < _CENTER_SHARE * _spread(ours) and float(np.median(turns)) < _TURN_DEG else None


def _of_boards(ours: Sequence[Board], theirs: Sequence[Board]) -> Iterator[Floats]:
    """From every board of a number that both parts see, each alone, and from every two of them."""
    shared = []
    numbers = by_number(theirs)
    for board in ours:
        shared += [(board, other) for other in numbers.get(board.number, [])]
    for (one, its), (two, others) in combinations_with_replacement(shared, 2):
        if one is not two and its is others:
            continue
        pairs = [(one, its)] if one is two and its is others else [(one, its), (two, others)]
        found = fit_similarity(
            np.concatenate([their.corners for _, their in pairs]), np.concatenate([our.corners for our, _ in pairs])
        )
        if found is not None:
            yield found


def _spread(centers: Floats) -> float:
    """RMS distance of centres (N, 3) from their middle."""
    return float(np.sqrt(((centers - centers.mean(axis=0)) ** 2).sum(axis=1).mean()))
