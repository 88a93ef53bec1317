"""The arrays of an adjustment: what was observed, what is unknown, and both taken from a COLMAP model."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsinfer.poses.adjustment.projection import (
    DRIFT,
    FOCAL,
    LENS,
    OWN,
    PRINCIPAL,
    TURN,
    Floats,
    project,
    project_with_jacobians,
    read_at,
)
from fsinfer.poses.order import in_order_of_walking

Ints = NDArray[np.int64]

#: Places of COLMAP's parameters in our twelve, and which may change together, by its lens models. Source: format.
_PLACES: dict[str, Sequence[Sequence[int]]] = {
    "SIMPLE_PINHOLE": [(0, 1), (2,), (3,)],
    "PINHOLE": [(0,), (1,), (2,), (3,)],
    "SIMPLE_RADIAL": [(0, 1), (2,), (3,), (4,)],
    "RADIAL": [(0, 1), (2,), (3,), (4,), (5,)],
    "OPENCV": [(0,), (1,), (2,), (3,), (4,), (5,), (6,), (7,)],
    "FULL_OPENCV": [(i,) for i in range(LENS)],
}
#: Of the twelve, the shared principal point stays: each photo's turning takes it up. Source: COLMAP's adjustment.
_FIXED = (2, 3)
#: Observations looked at together: their derivatives stay in a core's cache. Source: numerics; of 450,000 they take 0.4
#: instead of 0.9 s to 1.2 s all at once.
_TOGETHER = 8192


class Group(Enum):
    """Unknowns of each photo's own that are kept or left together; the value is their place."""

    turn = TURN
    drift = DRIFT
    focal = FOCAL
    principal = PRINCIPAL


@dataclass(frozen=True, kw_only=True)
class Observations:
    """Points seen in photos, sorted by photo.

    Attributes
    ----------
    photo, point: (n,) int64, their numbers.
    xy: (n, 2) float64, pixels with COLMAP's origin. tau: (n,) when its row was read, -1/2 to 1/2.
    weight: (n,) what errors are multiplied with, so that all are those of the surest kind of observation.
    camera: (N,) int64, which lens each photo has.
    """

    photo: Ints
    point: Ints
    xy: Floats
    tau: Floats
    weight: Floats
    camera: Ints

    def of(self, rows: slice | NDArray[np.bool_] | Ints) -> Observations:
        """Some of them."""
        return replace(
            self,
            photo=self.photo[rows],
            point=self.point[rows],
            xy=self.xy[rows],
            tau=self.tau[rows],
            weight=self.weight[rows],
        )

    def parts(self) -> Iterator[tuple[slice, Observations]]:
        """All of them, some thousands at a time, and which they are."""
        for first in range(0, len(self.photo), _TOGETHER):
            part = slice(first, first + _TOGETHER)
            yield part, self.of(part)

    def of_points_seen(self, points: int) -> tuple[Observations, Ints]:
        """All of them, the points that are seen numbered anew; and the old numbers of these points."""
        return self.of_points(np.bincount(self.point, minlength=points) > 0)

    def of_points(self, chosen: NDArray[np.bool_]) -> tuple[Observations, Ints]:
        """Those of the points that a (P,) mask chooses, numbered anew; and the old numbers of these points."""
        kept = np.flatnonzero(chosen)
        number = np.cumsum(chosen) - 1
        seen = self.of(chosen[self.point])
        return replace(seen, point=number[seen.point]), kept


@dataclass(frozen=True, kw_only=True)
class Unknowns:
    """What is adjusted.

    Attributes
    ----------
    rotations: (N, 3, 3), translations: (N, 3): camera from world, at the time of the middle row.
    own: (N, 9), each photo's own, see :mod:`fsinfer.poses.adjustment.projection`.
    lenses: (K, 12). points: (P, 3), world.
    """

    rotations: Floats
    translations: Floats
    own: Floats
    lenses: Floats
    points: Floats

    @property
    def centers(self) -> Floats:
        """(N, 3) camera centres."""
        return np.asarray(-np.einsum("nji,nj->ni", self.rotations, self.translations))

    def in_cameras(self, seen: Observations) -> Floats:
        """(n, 3) observed points in the camera of the middle row."""
        turned = self.rotations[seen.photo] @ self.points[seen.point][:, :, None]
        return np.asarray(turned[:, :, 0] + self.translations[seen.photo])

    def residuals(self, seen: Observations) -> Floats:
        """(n, 2) pixels, predicted less observed, times their weight."""
        found = np.empty((len(seen.photo), 2))
        for rows, part in seen.parts():
            lens, own = self.lenses[part.camera[part.photo]], self.own[part.photo]
            found[rows] = (project(self.in_cameras(part), part.tau, lens, own) - part.xy) * part.weight[:, None]
        return found

    def derivatives(self, seen: Observations, inside: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """:meth:`residuals`, and :func:`~fsinfer.poses.adjustment.projection.project_with_jacobians` of them.

        ``inside`` are :meth:`in_cameras`.
        """
        lens, own = self.lenses[seen.camera[seen.photo]], self.own[seen.photo]
        pixels, *jacobians = project_with_jacobians(inside, seen.tau, lens, own)
        weight = seen.weight[:, None, None]
        by_point, by_own, by_lens = (jacobian * weight for jacobian in jacobians)
        return (pixels - seen.xy) * seen.weight[:, None], by_point, by_own, by_lens


@dataclass(frozen=True, kw_only=True)
class Numbers:
    """Which rows of the arrays are which of COLMAP's images, cameras and points."""

    images: Sequence[int]
    cameras: Sequence[int]
    points: Sequence[int]
    features: Ints
    """(n,) int64, the number of each observation among its photo's points2D."""


def from_model(model: Any) -> tuple[Observations, Unknowns, Numbers]:
    """Take the arrays out of a ``pycolmap.Reconstruction``; points seen by two or more photos."""
    images = in_order_of_walking(model)
    cameras = sorted({model.images[i].camera_id for i in images})
    points = sorted(i for i, point in model.points3D.items() if point.track.length() > 1)
    rank = {number: index for index, number in enumerate(points)}
    photo: list[int] = []
    point: list[int] = []
    feature: list[int] = []
    xy: list[Floats] = []
    tau: list[Floats] = []
    for index, image_id in enumerate(images):
        image = model.images[image_id]
        size = (int(model.cameras[image.camera_id].width), int(model.cameras[image.camera_id].height))
        before = len(xy)
        numbers = image.get_observation_point2D_idxs()
        for number, observed in zip(numbers, image.get_observation_points2D(), strict=True):
            if observed.point3D_id in rank:
                photo.append(index)
                point.append(rank[observed.point3D_id])
                feature.append(number)
                xy.append(observed.xy)
        tau.append(read_at(np.array(xy[before:], np.float64).reshape(-1, 2), *size))
    poses = np.array([model.images[i].cam_from_world().matrix() for i in images]).reshape(-1, 3, 4)
    seen = Observations(
        photo=np.array(photo, np.int64),
        point=np.array(point, np.int64),
        xy=np.array(xy, np.float64).reshape(-1, 2),
        tau=np.concatenate(tau) if tau else np.empty(0),
        weight=np.ones(len(photo)),
        camera=np.array([cameras.index(model.images[i].camera_id) for i in images], np.int64),
    )
    unknowns = Unknowns(
        rotations=np.ascontiguousarray(poses[:, :, :3]),
        translations=np.ascontiguousarray(poses[:, :, 3]),
        own=np.zeros((len(images), OWN)),
        lenses=np.array([lens_of(model.cameras[i]) for i in cameras]).reshape(-1, LENS),
        points=np.array([model.points3D[i].xyz for i in points], np.float64).reshape(-1, 3),
    )
    return seen, unknowns, Numbers(images=images, cameras=cameras, points=points, features=np.array(feature, np.int64))


def is_known(camera: Any) -> bool:
    """Whether a ``pycolmap.Camera`` has a lens that this adjustment knows."""
    return camera.model.name in _PLACES


def lens_of(camera: Any) -> Floats:
    """(12,) of a ``pycolmap.Camera`` that :func:`is_known`."""
    lens = np.zeros(LENS)
    for value, places in zip(camera.params, _PLACES[camera.model.name], strict=True):
        lens[list(places)] = value
    return lens


def params_of(camera: Any, lens: Floats) -> list[float]:
    """COLMAP's parameters of a lens, in the model that ``camera`` has."""
    return [float(lens[places[0]]) for places in _PLACES[camera.model.name]]


def free_directions(camera: Any) -> Floats:
    """(12, p) directions in which a lens may change; those of the principal point are not among them."""
    places = [group for group in _PLACES[camera.model.name] if group[0] not in _FIXED]
    free = np.zeros((LENS, len(places)))
    for column, group in enumerate(places):
        free[list(group), column] = 1
    return free
