"""Parts of a torn walk put together: by photos that both have, or by boards that both see.

Each part is right in itself and has a scale, a place and a turn of its own: a similarity joins it to the rest. It is
estimated from what both know, checked against all that both know, and adjusted with everything else afterwards.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from itertools import combinations_with_replacement
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from fsinfer.geometry.similarity import Floats, apply, fit_similarity, rotation_of, scale_of
from fsinfer.poses.boards import Board, BoardSighting, boards_in, by_number

_log = logging.getLogger(__name__)

#: Corners of a board agree in two parts where they lie within this share of its side; farther boards by the drift of
#: a part, this share of their distance from the board that joins. Source: judgement.
_CORNER_SHARE, _DRIFT_SHARE = 0.25, 0.04
#: Photos that two parts must have in common for a similarity from them. Source: two fix it, the third checks.
_COMMON_PHOTOS = 3
#: One board alone is believed where this share of the part's points lies near points of the model, and so many times
#: more than after half a turn; near is this share of the usual distance between points. Fewer points tell nothing.
#: Source: judgement.
_LEAST_NEAR, _TIMES_TURNED, _NEAR_STEPS, _FEWEST_POINTS = 0.12, 2.0, 0.5, 100
#: Points at which the usual distance is looked at. Source: numerics.
_MOST_PROBES = 2000
#: Photos that both have agree where their centres lie within this share of their spread, and their directions within so
#: many degrees (medians). Source: judgement.
_CENTER_SHARE, _TURN_DEG = 0.1, 3.0
#: Directions to the sky of the photos of two parts may differ so much, degrees. Source: people hold a phone level
#: within some degrees, plots slope by some more.
_MAX_TILT_DEG = 30.0


def join_parts(model: Any, parts: Sequence[Any], sightings: Sequence[BoardSighting]) -> tuple[list[str], list[Any]]:
    """Join to ``model`` each part that can be; returns the files of the photos that were gained, and the other parts.

    Parameters
    ----------
    model: ``pycolmap.Reconstruction``; it is changed.
    parts: further reconstructions of photos from the same database, the largest first. One that is joined may show
        the way for another, so that all are tried again after each.
    """
    left = [(part, boards_in(part, sightings)) for part in parts]
    gained: list[str] = []
    progress = bool(left)
    while progress:
        progress = False
        ours = boards_in(model, sightings)
        for pair in left:
            where = _place_of(model, pair[0], ours, pair[1])
            if where is not None:
                gained += _take_over(model, pair[0], where)
                left.remove(pair)
                progress = bool(left)
                break
    return gained, [part for part, _ in left]


def _place_of(model: Any, part: Any, ours: Sequence[Board], theirs: Sequence[Board]) -> Floats | None:
    """The similarity that takes the part to the model, or None where nothing trustworthy tells it."""
    common = sorted(set(model.reg_image_ids()) & set(part.reg_image_ids()))
    if len(common) >= _COMMON_PHOTOS:
        found = _by_photos(model, part, common)
        if found is not None:
            return found
    best: tuple[list[tuple[Board, Board]], Floats] | None = None
    for candidate in _candidates(ours, theirs):
        if _tilt_deg(model, part, candidate) > _MAX_TILT_DEG:
            continue
        agreeing = _agreeing(ours, theirs, candidate)
        if agreeing and (best is None or len(agreeing) > len(best[0])):
            refined = fit_similarity(
                np.concatenate([their.corners for _, their in agreeing]),
                np.concatenate([our.corners for our, _ in agreeing]),
            )
            best = (agreeing, candidate if refined is None else refined)
    if best is None:
        return None
    agreed, place = best
    if len(agreed) == 1 and not _overlaps(model, part, place, agreed[0][0].corners.mean(axis=0)):
        _log.info("a part of %d photos shares one board with the rest and nothing else", part.num_reg_images())
        return None
    return place


def _by_photos(model: Any, part: Any, common: Sequence[int]) -> Floats | None:
    """From the centres of photos that both have, if these and their directions agree."""
    ours = np.array([model.images[i].projection_center() for i in common])
    theirs = np.array([part.images[i].projection_center() for i in common])
    found = fit_similarity(theirs, ours)
    if found is None:
        return None
    spread = float(np.sqrt(((ours - ours.mean(axis=0)) ** 2).sum(axis=1).mean()))
    residual = float(np.median(np.linalg.norm(apply(found, theirs) - ours, axis=1)))
    turns = [
        _angle_deg(
            model.images[i].cam_from_world().rotation.matrix() @ rotation_of(found),
            part.images[i].cam_from_world().rotation.matrix(),
        )
        for i in common
    ]
    return found if residual < _CENTER_SHARE * spread and float(np.median(turns)) < _TURN_DEG else None


def _candidates(ours: Sequence[Board], theirs: Sequence[Board]) -> Iterator[Floats]:
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


def _agreeing(ours: Sequence[Board], theirs: Sequence[Board], where: Floats) -> list[tuple[Board, Board]]:
    """Boards of both that lie at the same place; each of them once."""
    agreeing = []
    taken: set[int] = set()
    middle = np.mean([board.corners.mean(axis=0) for board in ours], axis=0)
    for other in theirs:
        moved = apply(where, other.corners)
        errors = [
            (float(np.linalg.norm(moved - board.corners, axis=1).max()), number)
            for number, board in enumerate(ours)
            if board.number == other.number and number not in taken
        ]
        if not errors:
            continue
        error, number = min(errors)
        board = ours[number]
        far = float(np.linalg.norm(board.corners.mean(axis=0) - middle))
        if error < max(_CORNER_SHARE * board.side, _DRIFT_SHARE * far):
            agreeing.append((board, other))
            taken.add(number)
    return agreeing


def _tilt_deg(model: Any, part: Any, where: Floats) -> float:
    """Angle between the mean directions to the sky of the photos of both."""
    up = [_mean_up(model), rotation_of(where) @ _mean_up(part)]
    return float(np.degrees(np.arccos(np.clip(up[0] @ up[1], -1.0, 1.0))))


def _mean_up(model: Any) -> Floats:
    ups = np.array([-model.images[i].cam_from_world().rotation.matrix()[1] for i in model.reg_image_ids()])
    mean: Floats = ups.mean(axis=0) / np.linalg.norm(ups.mean(axis=0))
    return mean


def _overlaps(model: Any, part: Any, where: Floats, middle: Floats) -> bool:
    """Whether the points of the part lie on those of the model, where one board alone speaks for its place.

    One board may hang on the wrong side of a pair (the same number on both faces): then the part lies turned by half
    a circle, and its points beside those of the model. What the place is held against is that half turn about the
    upright through the board, ``middle``.
    """
    ours = np.array([point.xyz for point in model.points3D.values()])
    theirs = apply(where, np.array([point.xyz for point in part.points3D.values()]))
    if min(len(ours), len(theirs)) < _FEWEST_POINTS:
        return False
    tree = cKDTree(ours)
    up = _mean_up(model)
    turn = 2 * np.outer(up, up) - np.eye(3)  # half a turn about the upright
    step = float(np.median(tree.query(ours[:: max(1, len(ours) // _MOST_PROBES)], k=2)[0][:, 1]))
    reach = _NEAR_STEPS * step
    near = float((tree.query(theirs)[0] < reach).mean())
    turned = float((tree.query((theirs - middle) @ turn.T + middle)[0] < reach).mean())
    return near > _LEAST_NEAR and near > _TIMES_TURNED * turned


def _take_over(model: Any, part: Any, where: Floats) -> list[str]:
    """Add the photos and points of ``part`` to ``model``; returns the files of the photos that it had not."""
    import pycolmap

    part.transform(pycolmap.Sim3d(scale_of(where), pycolmap.Rotation3d(rotation_of(where)), where[:3, 3]))
    had = set(model.reg_image_ids())
    gained = []
    for image_id in sorted(set(part.reg_image_ids()) - had):
        image = part.images[image_id]
        pose = image.cam_from_world()
        if not model.exists_camera(image.camera_id):
            model.add_camera_with_trivial_rig(pycolmap.Camera(part.cameras[image.camera_id].todict()))
        if model.exists_image(image_id):
            frame = model.frames[model.images[image_id].frame_id]
            frame.set_cam_from_world(image.camera_id, pose)
            model.register_frame(frame.frame_id)
        else:
            keypoints = np.array([point.xy for point in image.points2D]).reshape(-1, 2)
            copy = pycolmap.Image(name=image.name, keypoints=keypoints, camera_id=image.camera_id, image_id=image_id)
            model.add_image_with_trivial_frame(copy, pose)
        gained.append(str(image.name))
    for point in part.points3D.values():
        _add_point(model, point)
    return gained


def _add_point(model: Any, point: Any) -> None:
    """Add a point, or its observations to the point that the model has there already."""
    import pycolmap

    free, known = [], None
    for element in point.track.elements:
        if not model.images[element.image_id].has_pose:
            continue
        seen = model.images[element.image_id].points2D[element.point2D_idx]
        if not seen.has_point3D():
            free.append(element)
        elif known is None:
            known = seen.point3D_id
    if known is not None:
        seen_by = {element.image_id for element in model.points3D[known].track.elements}
        for element in free:
            if element.image_id not in seen_by:
                model.add_observation(known, element)
                seen_by.add(element.image_id)
    elif len(free) >= 2:
        track = pycolmap.Track()
        for element in free:
            track.add_element(element.image_id, element.point2D_idx)
        model.add_point3D(point.xyz, track, point.color)


def _angle_deg(first: Floats, second: Floats) -> float:
    cosine = (np.trace(first @ second.T) - 1) / 2
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
