"""Sightings in a part's photos of boards whose places the rest knows: places of the part, and how well they fit.

A board that the part saw once or twice, or only while walking towards it, has no place in the part. Yet each photo of
it tells where that photo stands to the board (four corners of a known square), and two photos where the part lies.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fsinfer.geometry.rotation import turn_deg
from fsinfer.geometry.similarity import Floats, apply
from fsinfer.poses.boards import Board, BoardSighting, by_number

#: A sighting agrees where its corners lie within so many thousandths of a focal length of where the board should be, or
#: within this share of the side that it shows. Source: judgement; a part has drifted a little since.
_REACH, _REACH_SHARE = 0.010, 0.35
#: Photos that places are tried from, spread over all that see a known board. Source: numerics.
_MOST_PHOTOS = 14
#: Two photos tell a place where the turns that they give agree within so many degrees. Source: judgement; the turn of a
#: small square is known within some degrees.
_TURNS_AGREE_DEG = 20.0


class KnownBoards:
    """The sightings in a part's photos of boards of the model; or the other way round, with ``back``.

    Places are always those of the part in the model.

    Attributes
    ----------
    number: (N,), of the board of each sighting. photo: (N,), id of the photo.
    """

    def __init__(
        self, boards: Sequence[Board], part: Any, sightings: Sequence[BoardSighting], *, back: bool = False
    ) -> None:
        self._back = back
        by_name = {part.images[i].name: i for i in part.reg_image_ids()}
        faces = by_number(boards)
        known = [s for s in sightings if s.file in by_name and s.number in faces]
        self.number = np.array([s.number for s in known], np.intp)
        self.photo = np.array([by_name[s.file] for s in known], np.intp)
        self._count = np.array([len(faces[s.number]) for s in known], np.intp)
        # (N, most faces, 4, 3); a board of fewer has its last one again, which changes no smallest error.
        most = int(self._count.max(initial=1))
        padded = [[*faces[s.number], *[faces[s.number][-1]] * (most - len(faces[s.number]))] for s in known]
        self._faces = np.array([[face.corners for face in own] for own in padded], np.float64).reshape(-1, most, 4, 3)
        rays, poses = [], []
        for sighting, photo in zip(known, self.photo, strict=True):
            image = part.images[photo]
            rays.append(part.cameras[image.camera_id].cam_from_img(sighting.corners_px))
            poses.append(image.cam_from_world().matrix())
        self._rays = np.array(rays, np.float64).reshape(-1, 4, 2)
        self._poses = np.array(poses, np.float64).reshape(-1, 3, 4)
        size = np.linalg.norm(self._rays - np.roll(self._rays, 1, axis=1), axis=2).mean(axis=1)
        self._reach = np.maximum(_REACH, _REACH_SHARE * size)

    def __len__(self) -> int:
        return len(self.number)

    def residuals(self, place: Floats) -> Floats:
        """Of the corners where the model has them and as they were seen, (N, 4, 2), in focal lengths.

        Of a number with several boards it is the one that fits best. Infinite behind the photo.
        """
        there = place if self._back else np.asarray(np.linalg.inv(place), np.float64)
        turned = self._poses[:, None, :, :3].swapaxes(2, 3)
        at = apply(there, self._faces) @ turned + self._poses[:, None, None, :, 3]
        ahead = np.asarray(at[..., 2:] > 0, np.bool_)
        seen = at[..., :2] / np.where(ahead, at[..., 2:], 1.0)
        away = np.where(ahead.all(axis=2, keepdims=True), seen - self._rays[:, None], np.inf)
        best = np.abs(away).max(axis=(2, 3)).argmin(axis=1)
        return np.asarray(away[np.arange(len(self)), best], np.float64)

    def agrees(self, place: Floats, times: float = 1.0) -> NDArray[np.bool_]:
        """Whether each sighting fits within so many times the usual reach, (N,)."""
        if not len(self):
            return np.zeros(0, np.bool_)
        return np.asarray(np.linalg.norm(self.residuals(place), axis=2).max(axis=1) < times * self._reach)

    def places(self) -> Iterator[Floats]:
        """Similarities (4, 4) from the part to the model that two photos of boards give."""
        chosen = np.unique(np.linspace(0, len(self) - 1, min(len(self), _MOST_PHOTOS)).round().astype(int))
        posed = {int(k): list(self._photo_poses(int(k))) for k in chosen} if len(self) else {}
        for one, other in combinations(posed, 2):
            if self.photo[one] == self.photo[other]:
                continue
            for first in posed[one]:
                for second in posed[other]:
                    found = _from_two((self._poses[one], first), (self._poses[other], second))
                    if found is not None:
                        yield np.asarray(np.linalg.inv(found), np.float64) if self._back else found

    def _photo_poses(self, k: int) -> Iterator[Floats]:
        """Poses (3, 4), camera from model, that the four corners of a sighting allow."""
        for corners in self._faces[k, : self._count[k]]:
            found, turns, shifts, _ = cv2.solvePnPGeneric(
                corners, self._rays[k], np.eye(3), None, flags=cv2.SOLVEPNP_IPPE
            )
            for turn, shift in zip(turns, shifts, strict=True) if found else ():
                # Of a board seen from its edge OpenCV makes no numbers.
                if np.isfinite(turn).all() and np.isfinite(shift).all():
                    yield np.column_stack([cv2.Rodrigues(turn)[0], np.ravel(shift)])


def _from_two(one: tuple[Floats, Floats], other: tuple[Floats, Floats]) -> Floats | None:
    """The similarity by which two photos, (pose in the part, pose in the model) each, lie at their places in both."""
    turns = [ours[:, :3].T @ theirs[:, :3] for theirs, ours in (one, other)]
    if turn_deg(turns[0], turns[1]) > _TURNS_AGREE_DEG:
        return None
    turn = Rotation.from_matrix(np.array(turns)).mean().as_matrix()
    part, model = (np.array([-pose[i][:, :3].T @ pose[i][:, 3] for pose in (one, other)]) for i in (0, 1))
    apart = float(np.linalg.norm(part[1] - part[0]))
    if apart <= 0:
        return None
    scale = float(np.linalg.norm(model[1] - model[0])) / apart
    if scale <= 0:
        return None
    place = np.eye(4)
    place[:3, :3] = scale * turn
    place[:3, 3] = model.mean(axis=0) - scale * turn @ part.mean(axis=0)
    return place
