"""Where a scale can hardly be right, or its error is not known."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fsinfer.notices.capture import CaptureCode
from fsinfer.notices.notice import Notice, notice
from fsinfer.scale.request import Point, ScaleRequest
from fsinfer.scale.scale import CAMERA_HEIGHT_M, MarkerScale, Scale

#: Nobody holds a phone lower or higher than this all through a plot: kneeling, or on a stick. Source: human bodies.
LIKELY_HEIGHTS_M = (0.4, 3.5)
#: Cosine between the directions that the two faces of one board look in, at most. Source: judgement; boards are flat.
_FACING_AWAY = -0.8


@dataclass(frozen=True, kw_only=True)
class EarlierScale:
    """What an earlier run into the same folder knew of its scale; the camera height is in units of its cloud."""

    m_per_unit: float | None = None
    endpoints: tuple[Point, Point] | None = None
    camera_height: float | None = None


def doubt_endpoints(request: ScaleRequest, earlier: EarlierScale) -> tuple[Notice, ...]:
    """Warn where end points may have been read off a cloud that was in metres already."""
    m_per_unit = earlier.m_per_unit
    if request.endpoints is None or request.length_m is None or not m_per_unit:
        return ()
    if earlier.endpoints == request.endpoints:
        return ()
    stretch = request.length_m / math.dist(*request.endpoints)
    height_m = earlier.camera_height
    if height_m and height_m > 0:
        # Which of the two has the photos taken nearer to the height at which people hold a phone?
        metric, units = height_m * stretch, height_m / m_per_unit * stretch
        if not _likely(metric) or _oddness(units) < _oddness(metric):
            return ()
    return (notice(CaptureCode.endpoints_of_metric_cloud, factor=m_per_unit * stretch),)


def _oddness(camera_height_m: float) -> float:
    return abs(math.log(camera_height_m / CAMERA_HEIGHT_M))


def _likely(camera_height_m: float) -> bool:
    low, high = LIKELY_HEIGHTS_M
    return low <= camera_height_m <= high


def doubt_height(camera_height_m: float | None) -> tuple[Notice, ...]:
    """Warn where the scale would have the photographs taken from a height at which nobody holds a camera."""
    if camera_height_m is None or _likely(camera_height_m):
        return ()
    centimetres = _likely(camera_height_m / 100)
    return (
        notice(
            CaptureCode.unlikely_camera_height,
            height_m=camera_height_m,
            usual_m=CAMERA_HEIGHT_M,
            centimetres=centimetres,
        ),
    )


def unknown_error(scale: Scale) -> tuple[Notice, ...]:
    """Say that the intervals do not contain the error of a scale of which none is known."""
    if scale.source != "factor" or scale.rel_std is not None:
        return ()
    return (notice(CaptureCode.scale_error_unknown),)


def _back_to_back(one: MarkerScale, other: MarkerScale) -> bool:
    """Whether two places of one number are the two faces of one board: nearer than its side, facing away."""
    if one.normal is None or other.normal is None:
        return False
    apart = float(np.linalg.norm(np.subtract(one.center, other.center)))
    return apart < max(one.side_units, other.side_units) and float(np.dot(one.normal, other.normal)) < _FACING_AWAY


def boards_at_two_places(boards: Scale, m_per_unit: float) -> tuple[Notice, ...]:
    """One notice for each board number found at several places: the sign of photos that were placed wrongly.

    ``m_per_unit`` are metres per unit of the scene, guessed where the scale is not known.
    """
    found = []
    for number in sorted({marker.id for marker in boards.markers}):
        places = sorted((m for m in boards.markers if m.id == number), key=lambda marker: -len(marker.views))
        for other in places[1:]:
            if any(_back_to_back(place, other) for place in places if place is not other):
                continue
            apart_m = m_per_unit * float(np.linalg.norm(np.subtract(other.center, places[0].center)))
            views = sorted(other.views)
            found.append(
                notice(CaptureCode.board_at_two_places, number=number, apart_m=apart_m, first=views[0], last=views[-1])
            )
    return tuple(found)
