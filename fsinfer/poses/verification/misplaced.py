"""Photos that structure from motion placed, but wrongly or on too little evidence, taken out of its model."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsinfer.notices.capture import CaptureCode
from fsinfer.poses.colmap_calls import copy_for_mapping, open_database
from fsinfer.poses.verification.loose_parts import loose_parts
from fsinfer.poses.verification.pair_votes import (
    MIN_SHARE,
    Ballot,
    contradicted,
    pair_votes,
    telling_votes,
    weight_of,
)
from fsinfer.poses.verification.scale_jumps import shrunk, strays, stretches
from fsinfer.poses.verification.stretches import torn_off

#: A pose that hangs on fewer points than this is an accident. Source: judgement.
_MIN_POINTS = 10
#: Matches with trusted photos that must agree with a stretch. Source: as many points as hold a part of a model.
_VOUCHING_MATCHES = 100

#: Photos so many times farther from the middle of all than most are stand nowhere. Source: judgement; 134 km was seen.
_FAR = 50.0

#: What the user is told of photos left out, by how they were found.
LEFT_OUT = {
    "unplaced": CaptureCode.photos_unplaced,
    "astray": CaptureCode.photos_astray,
    "contradicted": CaptureCode.photos_contradicted,
    "loose": CaptureCode.photos_loose,
}


def drop_strays(model: Any, walk: Sequence[str], database: Path | None = None) -> list[str]:
    """Take photos at another scale than the walk out of a ``pycolmap.Reconstruction``; returns their files.

    ``walk`` holds the files of all photos in the order of walking. With the ``database`` of the matches a stretch stays
    all the same whose matches with the photos that are trusted speak for its place: a walk that was begun anew
    elsewhere is a small stretch, too.
    """
    number = {file: index for index, file in enumerate(walk)}
    placed = sorted((number[model.images[i].name], i) for i in model.reg_image_ids())
    centers = np.array([model.images[i].projection_center() for _, i in placed])
    order = np.array([index for index, _ in placed])
    found = strays(centers, order)
    if database is not None and found.any():
        found &= ~_vouched_for(found, stretches(centers, order), [i for _, i in placed], model, database)
    return drop(model, [image_id for is_stray, (_, image_id) in zip(found, placed, strict=True) if is_stray])


def drop_far(model: Any) -> list[str]:
    """Take photos that lie beyond any plot, against the others, out of the model; returns their files."""
    image_ids = sorted(model.reg_image_ids())
    centers = np.array([model.images[i].projection_center() for i in image_ids]).reshape(-1, 3)
    away = np.linalg.norm(centers - np.median(centers, axis=0), axis=1)
    return drop(model, [i for i, far in zip(image_ids, away > _FAR * np.median(away), strict=True) if far])


def shrunk_photos(model: Any, walk: Sequence[str], database: Path) -> list[int]:
    """Image ids of the photos that stand in a stretch placed far too small; see :func:`scale_jumps.shrunk`."""
    number = {file: index for index, file in enumerate(walk)}
    image_ids, votes = pair_votes(model, database, within=1)
    if len(image_ids) < 2:
        return []
    order = np.array([number[model.images[i].name] for i in image_ids])
    centers = np.array([model.images[i].projection_center() for i in image_ids])
    parallax_px = np.full(len(image_ids) - 1, np.nan)
    for vote in votes:
        if abs(vote.first - vote.second) == 1:
            parallax_px[min(vote.first, vote.second)] = vote.parallax_px
    return [image_id for image_id, small in zip(image_ids, shrunk(centers, order, parallax_px), strict=True) if small]


def _vouched_for(
    found: NDArray[np.bool_],
    stretch: NDArray[np.intp],
    image_ids: Sequence[int],
    model: Any,
    database: Path,
) -> NDArray[np.bool_]:
    """Whether the matches of each photo's stretch with the trusted photos speak for its place, (N,)."""
    ids, votes = pair_votes(model, database)
    rank = {image_id: index for index, image_id in enumerate(image_ids)}
    ballot = Ballot.of(votes)
    ends = np.array([rank[image_id] for image_id in ids], np.intp)[ballot.ends]
    vouched = np.zeros(len(found), bool)
    for number in np.unique(stretch[found]):
        mine = stretch == number
        across = (mine[ends] & ~found[ends[:, ::-1]]).any(axis=1)
        cast, for_it = ballot.weight[across].sum(), ballot.weight[across & ballot.agrees].sum()
        if for_it >= _VOUCHING_MATCHES and for_it >= MIN_SHARE * cast:
            vouched |= mine
    return vouched


def drop_contradicted(
    model: Any, database: Path, neighbours: int = 0, *, min_share: float = MIN_SHARE, parts: bool = True
) -> list[str]:
    """Take photos whose own matches speak against their place out of the model; returns their files.

    Of an ordered walk (``neighbours`` > 0) short stretches, too, which their neighbours contradict; see
    :func:`fsinfer.poses.verification.stretches.torn_off`. ``neighbours``, ``min_share``, ``parts``: see
    :func:`fsinfer.poses.verification.pair_votes.contradicted`.
    """
    image_ids, votes = pair_votes(model, database)
    count = len(image_ids)
    torn = torn_off(telling_votes(votes), count, neighbours) if neighbours else np.zeros(count, np.bool_)
    left = [vote for vote in votes if not (torn[vote.first] or torn[vote.second])]
    wrong = torn | contradicted(left, count, neighbours=neighbours, min_share=min_share, parts=parts)
    return drop(model, [image_id for image_id, is_wrong in zip(image_ids, wrong, strict=True) if is_wrong])


def agreeing_matches(model: Any, database: Path, neighbours: int = 0) -> float:
    """Matches that agree with the places of the photos: of two models of the same photos the better one has more."""
    return sum(weight_of(vote, neighbours) for vote in pair_votes(model, database)[1] if vote.agrees)


def without_pairs(database: Path, pairs: Sequence[tuple[int, int]], copy: Path) -> Path:
    """A copy of the database that has forgotten what matches these pairs of images have; returns ``copy``."""
    copy_for_mapping(database, copy)
    with open_database(copy) as opened:
        for first, second in pairs:
            opened.delete_two_view_geometry(first, second)
    return copy


def drop_loose_parts(model: Any) -> list[str]:
    """Take parts that hang on the rest by a few points out of the model; returns their files."""
    image_ids = sorted(model.reg_image_ids())
    number = {image_id: index for index, image_id in enumerate(image_ids)}
    seen = [
        (point, number[element.image_id])
        for point, found in enumerate(model.points3D.values())
        for element in found.track.elements
    ]
    points, photos = np.array(seen, dtype=np.intp).reshape(-1, 2).T
    loose = loose_parts(points, photos, len(image_ids))
    return drop(model, [image_id for image_id, index in number.items() if loose[index]])


def drop_blind_views(model: Any) -> list[str]:
    """Take photos out of the model that lost nearly all their points in the last adjustment; returns their files."""
    blind = []
    for image_id in model.reg_image_ids():
        image = model.images[image_id]
        pose = image.cam_from_world().matrix()
        points = np.array([model.points3D[p.point3D_id].xyz for p in image.get_observation_points2D()]).reshape(-1, 3)
        if int((points @ pose[2, :3] + pose[2, 3] > 0).sum()) < _MIN_POINTS:
            blind.append(image_id)
    return drop(model, blind)


def drop(model: Any, image_ids: Sequence[int]) -> list[str]:
    """Take photos out of the model; returns their files."""
    files = [str(model.images[image_id].name) for image_id in image_ids]
    for image_id in image_ids:
        model.deregister_frame(model.images[image_id].frame_id)
    return files
