"""Points that no feature tells of: corners of every part of a photo, found in others by the patch about each.

Where features are few (undergrowth, dark soil, smooth bark) the fifteen unknowns of a photo hang on some hundred
points. Cameras that patches have placed are good enough to look for more: how far off a corner is tells a sweep
(:mod:`fsinfer.poses.adjustment.sweep`), where exactly others show it least-squares matching.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fsinfer.io.images import luminance, read_image
from fsinfer.poses.adjustment.fit import with_points_fitted
from fsinfer.poses.adjustment.problem import Ints, Observations, Unknowns
from fsinfer.poses.adjustment.projection import Floats, read_at_of
from fsinfer.poses.adjustment.rematch import Photos, matched, pairs_to_look_for, shared_by
from fsinfer.poses.adjustment.settings import AdjustmentSettings
from fsinfer.poses.adjustment.sweep import Bytes, Sweep, corners, small_picture
from fsinfer.threads import in_order

_log = logging.getLogger(__name__)


def with_new_points(
    seen: Observations, at: Unknowns, photos: Photos, settings: AdjustmentSettings, *, threads: int = 1
) -> tuple[Observations, Floats]:
    """Observations and points (P, 3) given, and those of corners that three photos or more show.

    Parameters
    ----------
    seen, at: observations of all points of ``at``; cameras placed to a pixel.
    threads: photos worked on at a time.
    """
    corner_of, points = _swept(seen, at, photos, settings, threads)
    if len(points) == 0:
        return seen, at.points
    rematch = replace(settings.rematch, most_photos=settings.new_points.most_photos)
    near = shared_by(seen, len(at.points)) >= rematch.min_shared
    there = replace(at, points=points)
    reference = np.arange(len(points))
    pairs = pairs_to_look_for(corner_of, there, reference, near, photos, rematch)
    good, xy = matched(corner_of, reference, pairs, photos, rematch, threads=threads)
    found = _in_order_of_photos(
        np.concatenate([pairs.photo[good], corner_of.photo]),
        np.concatenate([pairs.point[good], corner_of.point]),
        np.concatenate([xy[good], corner_of.xy]),
        np.ones(int(good.sum()) + len(points)),
        photos,
        seen.camera,
    )
    there = with_points_fitted(found, there, settings.rematch.loss_px * photos.step_px)
    kept = np.bincount(found.point, minlength=len(points)) >= settings.new_points.min_photos
    kept &= _widest_angle(found, corner_of.photo, there) > np.radians(settings.new_points.min_angle_deg)
    kept &= there.in_cameras(corner_of)[:, 2] > 0
    found, numbers = found.of_points(kept)
    _log.info("%d of %d corners are points, seen %d times", kept.sum(), len(kept), len(found.photo))
    together = _in_order_of_photos(
        np.concatenate([seen.photo, found.photo]),
        np.concatenate([seen.point, found.point + len(at.points)]),
        np.concatenate([seen.xy, found.xy]),
        np.concatenate([seen.weight, found.weight]),
        photos,
        seen.camera,
    )
    return together, np.concatenate([at.points, there.points[numbers]])


def _swept(
    seen: Observations, at: Unknowns, photos: Photos, settings: AdjustmentSettings, threads: int
) -> tuple[Observations, Floats]:
    """Corners whose depth was found, one observation each in the order of photos; and where they are, (n, 3) world."""
    new, count = settings.new_points, len(at.rotations)
    per_photo = min(new.per_photo, new.most // count)
    depths = at.in_cameras(seen)[:, 2]
    neighbours = _neighbours(seen, at, depths, settings)

    def picture(photo: int) -> Bytes:
        return small_picture(luminance(read_image(photos.files[photo])), photos.step_px)

    sweep = Sweep(
        pictures=list(in_order(picture, range(count), threads)), sizes=photos.sizes, camera=seen.camera, at=at
    )

    def of(photo: int) -> tuple[Floats, Floats]:
        own = depths[(seen.photo == photo) & (depths > 0)]
        if per_photo < 1 or len(own) == 0 or len(neighbours[photo]) == 0:
            return np.empty((0, 2)), np.empty((0, 3))
        near, far = np.percentile(own, [1, 99]) * (new.nearer, new.farther)
        xy = corners(sweep.pictures[photo], per_photo) * sweep.scale(photo)
        swept = sweep.of(photo, xy, near, far, neighbours[photo])
        alike = swept.likeness > new.min_likeness
        return xy[alike], swept.points[alike]

    places, points = zip(*in_order(of, range(count), threads), strict=True)
    photo = np.repeat(np.arange(count), [len(part) for part in places])
    xy = np.concatenate(places)
    corner_of = Observations(
        photo=photo,
        point=np.arange(len(photo)),
        xy=xy,
        tau=read_at_of(xy, photos.sizes[photo]),
        weight=np.ones(len(photo)),
        camera=seen.camera,
    )
    return corner_of, np.concatenate(points)


def _neighbours(seen: Observations, at: Unknowns, depths: Floats, settings: AdjustmentSettings) -> Sequence[Ints]:
    """For each photo those that a corner of it is laid over: far enough off to tell a depth, and sharing the most."""
    count, new = len(at.rotations), settings.new_points
    shared, centers = shared_by(seen, len(at.points)), at.centers
    found = []
    for photo in range(count):
        own = depths[seen.photo == photo]
        base = np.linalg.norm(centers - centers[photo], axis=1)
        usual = float(np.median(own)) if len(own) else 0.0
        fit = (base > new.min_base * usual) & (base < new.max_base * usual)
        fit &= shared[photo] >= settings.rematch.min_shared
        order = np.argsort(-shared[photo], kind="stable")
        found.append(order[fit[order]][: new.neighbours])
    return found


def _widest_angle(seen: Observations, own: Ints, at: Unknowns) -> Floats:
    """(P,) radians between the lines of sight of each point's own photo and another, the widest."""
    lines = at.centers[seen.photo] - at.points[seen.point]
    own_lines = (at.centers[own] - at.points)[seen.point]
    across = np.linalg.norm(np.cross(lines, own_lines), axis=1)
    angles = np.arctan2(across, (lines * own_lines).sum(1))
    widest = np.zeros(len(own))
    np.maximum.at(widest, seen.point, angles)
    return widest


def _in_order_of_photos(
    photo: Ints, point: Ints, xy: Floats, weight: Floats, photos: Photos, camera: Ints
) -> Observations:
    order = np.lexsort((point, photo))
    photo, xy = photo[order], xy[order]
    return Observations(
        photo=photo,
        point=point[order],
        xy=xy,
        tau=read_at_of(xy, photos.sizes[photo]),
        weight=weight[order],
        camera=camera,
    )
