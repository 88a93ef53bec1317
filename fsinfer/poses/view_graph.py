"""What the pairs of a walk say together before anything is mapped: the focal length, and which pairs cannot be true.

A mapper that begins with a focal length a sixth too long, or follows false matches to a tree that looks like another,
bends the walk, and most of its time then goes into adjusting what cannot fit. Both can be told from the pairs alone:
the fundamental matrices tell the focal length (Fetzer, Reis and Stricker 2020, by COLMAP), and the turns between the
photos of true pairs add up to one direction of each photo (rotation averaging, by COLMAP).
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsinfer.geometry.rotation import turn_deg
from fsinfer.poses.colmap_calls import SEED, call, copy_for_mapping, database_cache, open_database
from fsinfer.poses.pairs import MIN_INLIERS

_log = logging.getLogger(__name__)

#: Pairs that must tell a focal length, and their share of those that can. Source: judgement; on four rendered plots of
#: 200 photos 1,800 to 2,100 pairs do, four fifths.
_LEAST_PAIRS, _LEAST_SHARE = 10, 0.5
#: Pairs that count, at least, for each photo but one. Source: judgement; a walk is held together by half of its steps
#: at least.
_LEAST_STEPS = 0.5
#: Focal lengths over the longer side that are believed. Source: phones' widest and longest lenses have 0.36 and 3.3.
_SHORTEST, _LONGEST = 0.3, 4.0
#: The focal lengths that all pairs and photos that follow each other tell differ by no more than this factor. Source:
#: judgement; a map made with one a tenth off mends it.
_DIFFERS = 1.1
#: A pair whose turn differs by more from the photos' directions contradicts them, degrees. Source: numerics; at 4 on
#: four rendered plots 256 of 297 false pairs of photos that are no neighbours go, and 229 of 4,994 true ones, of which
#: those that agree with the finished model come back; renders only.
_CONTRADICTS_DEG = 4.0
#: More than this share of the pairs that are no neighbours cannot be false: then it is the directions that are.
#: Source: judgement.
_MOST_FALSE = 0.5
#: What a mapper begins with: turns nearer than this to the photos' directions, degrees; rays that meet at more than
#: this, degrees; and less of the way than this straight ahead. Source: COLMAP asks for 16 degrees and 0.95, and its
#: angle of a pair may be another by a degree or two.
_BEGINS_DEG, _BEGINS_ANGLE_DEG, _BEGINS_AHEAD = 2.0, 20.0, 0.9
#: So many pairs to begin with. Source: judgement.
_BEGINNINGS = 3


@dataclass(frozen=True, kw_only=True)
class PairTurn:
    """Two photos by COLMAP's numbers, their matches, and the place of the second camera as the pair alone tells it.

    Attributes
    ----------
    turn: (3, 3) from the first camera to the second. ahead: share of the way that is straight ahead.
    angle_deg: at which the rays of the matches meet, median. flat: the matches may all lie in one plane.
    differs_deg: from the directions that all pairs together give the photos; NaN where one of them has none.
    """

    first: int
    second: int
    matches: int
    turn: NDArray[np.float64]
    ahead: float
    angle_deg: float
    flat: bool
    differs_deg: float = float("nan")


def calibrate(database: Path, work: Path, rank: Mapping[int, int] | None = None) -> None:
    """Give cameras of unknown focal length the one that the fundamental matrices of their pairs tell, if they do.

    Radial distortion is left out, so that it comes out some per cent too short of a phone's photos; the mapper goes on
    from there. Where photos that follow each other tell another than all pairs do, they are right: what looks alike is
    taken for the same in the others, of a rendered ground whose leaves repeat in three quarters of them.

    Parameters
    ----------
    work: folder for a copy. rank: of each photo of a walk, by COLMAP's number, the place in the order of walking.
    """
    by_all = _told_focal(database, work, lambda _pair: True)
    if rank is not None and by_all:
        by_next = _told_focal(database, work, lambda pair: abs(rank[pair[0]] - rank[pair[1]]) == 1)
        for number, camera in by_next.items():
            found = by_all[number].camera.mean_focal_length() / camera.camera.mean_focal_length()
            if camera.believed and not (by_all[number].believed and 1 / _DIFFERS <= found <= _DIFFERS):
                by_all[number] = camera
    with open_database(database) as opened:
        for number, told in sorted(by_all.items()):
            if told.believed:
                _log.info("focal length of camera %d: %s px", number, told.camera.params[0])
                told.camera.has_prior_focal_length = True
                opened.update_camera(told.camera)


@dataclass(frozen=True, kw_only=True)
class _Told:
    """A ``pycolmap.Camera`` with the focal length that pairs told, and whether it is to be believed."""

    camera: Any
    believed: bool


def _told_focal(database: Path, work: Path, counts: Callable[[tuple[int, int]], bool]) -> dict[int, _Told]:
    """What the pairs of photos that count tell of the cameras of unknown focal length, by their numbers."""
    import pycolmap

    with open_database(database) as opened:
        unknown = {camera.camera_id for camera in opened.read_all_cameras() if not camera.has_prior_focal_length}
        camera_of = {image.image_id: image.camera_id for image in opened.read_all_images()}
        every = configurations(opened)
    before = {pair: kind for pair, kind in every.items() if counts(pair)}
    if not unknown or not before:
        return {}
    told = work / "calibrated.db"
    copy_for_mapping(database, told)
    with open_database(told) as opened:
        for pair_id in opened.read_two_view_geometries()[0]:
            pair = pycolmap.pair_id_to_image_pair(pair_id)
            if pair not in before:
                opened.delete_two_view_geometry(*pair)
    options = pycolmap.ViewGraphCalibrationOptions()
    options.random_seed = SEED
    options.reestimate_relative_pose = False
    result = {}
    if call(pycolmap.calibrate_view_graph, told, options):
        with open_database(told) as opened:
            found = {camera.camera_id: camera for camera in opened.read_all_cameras()}
            after = configurations(opened)
        for number in unknown:
            pairs = [pair for pair in before if {camera_of[i] for i in pair} == {number}]
            # Of photos that follow each other there is a pair fewer than there are photos.
            few = len(pairs) < _LEAST_STEPS * (list(camera_of.values()).count(number) - 1)
            believed = not few and _is_told(found[number], [(before[pair], after.get(pair)) for pair in pairs])
            result[number] = _Told(camera=found[number], believed=believed)
    told.unlink(missing_ok=True)
    return result


def configurations(opened: Any) -> dict[tuple[int, int], Any]:
    """The ``pycolmap.TwoViewGeometryConfiguration`` of each pair that counts, of a database of ``open_database``."""
    import pycolmap

    pair_ids, geometries = opened.read_two_view_geometries()
    return {
        pycolmap.pair_id_to_image_pair(pair_id): geometry.config
        for pair_id, geometry in zip(pair_ids, geometries, strict=True)
        if len(geometry.inlier_matches) >= MIN_INLIERS
    }


def _is_told(camera: Any, pairs: Sequence[tuple[Any, Any]]) -> bool:
    """Whether a camera's new focal length is to be believed, by its pairs' configurations before and after."""
    import pycolmap

    kinds = pycolmap.TwoViewGeometryConfiguration
    can_tell = [after for before, after in pairs if before in (kinds.UNCALIBRATED, kinds.CALIBRATED)]
    agreeing = sum(after == kinds.CALIBRATED for after in can_tell)
    focal = camera.mean_focal_length() / max(camera.width, camera.height)
    enough = bool(agreeing >= max(_LEAST_PAIRS, _LEAST_SHARE * len(can_tell)))
    return enough and bool(_SHORTEST <= focal <= _LONGEST)


def pair_turns(database: Path) -> list[PairTurn]:
    """The pairs of a database that count and whose cameras' places can be told, each beside the others."""
    import pycolmap

    turns: list[PairTurn] = []
    graph = pycolmap.PoseGraph()
    kinds = pycolmap.TwoViewGeometryConfiguration
    with open_database(database) as opened:
        cameras = {camera.camera_id: camera for camera in opened.read_all_cameras()}
        camera_of = {image.image_id: cameras[image.camera_id] for image in opened.read_all_images()}
        places = {i: np.asarray(opened.read_keypoints(i), dtype=np.float64)[:, :2] for i in camera_of}
        for pair_id, geometry in zip(*opened.read_two_view_geometries(), strict=True):
            first, second = pycolmap.pair_id_to_image_pair(pair_id)
            if len(geometry.inlier_matches) < MIN_INLIERS or not call(
                pycolmap.estimate_two_view_geometry_pose,
                camera_of[first], places[first], camera_of[second], places[second], geometry,
            ):  # fmt: skip
                continue
            moved = geometry.cam2_from_cam1
            edge = pycolmap.PoseGraphEdge(moved)
            edge.num_matches = len(geometry.inlier_matches)
            graph.add_edge(first, second, edge)
            turns.append(
                PairTurn(
                    first=first,
                    second=second,
                    matches=len(geometry.inlier_matches),
                    turn=moved.rotation.matrix(),
                    ahead=float(abs(moved.translation[2])),
                    angle_deg=float(np.degrees(geometry.tri_angle)),
                    flat=geometry.config not in (kinds.CALIBRATED, kinds.UNCALIBRATED),
                )
            )
    return _beside_the_others(turns, graph, database)


def _beside_the_others(turns: Sequence[PairTurn], graph: Any, database: Path) -> list[PairTurn]:
    """The pairs with how much each differs from all together."""
    import pycolmap

    if not turns:
        return []
    model = pycolmap.Reconstruction()
    model.load(database_cache(database))
    options = pycolmap.RotationEstimatorOptions()
    options.random_seed = SEED
    if not call(pycolmap.run_rotation_averaging, options, graph, model, []):
        return list(turns)
    directions = {i: image.cam_from_world().rotation.matrix() for i, image in model.images.items() if image.has_pose}
    return [
        replace(turn, differs_deg=turn_deg(directions[turn.second] @ directions[turn.first].T, turn.turn))
        if turn.first in directions and turn.second in directions
        else turn
        for turn in turns
    ]


def contradicting(turns: Sequence[PairTurn], rank: Mapping[int, int], neighbours: int) -> list[tuple[int, int]]:
    """Pairs of photos that are no neighbours in the walk and turn in a way that contradicts all others.

    Parameters
    ----------
    rank: of each photo, by COLMAP's number, in the order of walking. neighbours: so many photos on, pairs are believed:
        the matches of photos that stand side by side are true, though what they tell of the turn may be poor.
    """
    far = [turn for turn in turns if abs(rank[turn.first] - rank[turn.second]) > neighbours]
    false = [(turn.first, turn.second) for turn in far if turn.differs_deg > _CONTRADICTS_DEG]
    return false if len(false) <= _MOST_FALSE * len(far) else []


def beginnings(turns: Sequence[PairTurn]) -> list[tuple[int, int]]:
    """Pairs for a mapper to begin with, the most matches first: of a wide angle, with depth, and uncontradicted."""
    good = [
        turn
        for turn in turns
        if turn.differs_deg < _BEGINS_DEG
        and turn.angle_deg > _BEGINS_ANGLE_DEG
        and turn.ahead < _BEGINS_AHEAD
        and not turn.flat
    ]
    good.sort(key=lambda turn: (-turn.matches, turn.first, turn.second))
    return [(turn.first, turn.second) for turn in good[:_BEGINNINGS]]
