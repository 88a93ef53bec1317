"""Where a scale can hardly be right, or its error is not known."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import ScaleError
from fsinfer.notices.capture import CaptureCode
from fsinfer.notices.notice import Notice, notice
from fsinfer.notices.stems import StemCode
from fsinfer.scale.agreement import back_to_back, markers_of_boards
from fsinfer.scale.printed_boards import DICTIONARY, board_lengths
from fsinfer.scale.request import Point, ScaleRequest
from fsinfer.scale.scale import CAMERA_HEIGHT_M, BoardVerdict, MarkerDetails, MarkerScale, Scale
from fsinfer.trees.points.sums import Z95

Floats = NDArray[np.float64]

#: Nobody holds a phone lower or higher than this all through a plot: kneeling, or on a stick. Source: human bodies.
LIKELY_HEIGHTS_M = (0.4, 3.5)
#: Two places of one number that are nearer to each other than this are one board, seen from both sides or a little
#: askew. Source: what boards are made of; cardboard to planks are up to three centimetres thick.
LEAST_APART_M = 0.03
#: Boards that stand so far apart speak of photos in a wrong place, and not of a walk that drifted a little; so many
#: numbers, and this share of all, must. Source: judgement; one number may be that of two boards, and of a rendered walk
#: that was put together wrongly all boards stood 3 to 13 m from themselves.
_WRONG_APART_M, _WRONG_NUMBERS, _WRONG_SHARE = 0.3, 2, 1 / 3
#: A given length that differs by more from the printed one is not that of a print which came out a little smaller, and
#: was measured. Source: judgement; the three sizes differ by a quarter and more.
_OTHER_LENGTH = 0.1
#: A scale from elsewhere that differs by less from that of the boards is not called in question. Source: judgement; one
#: per cent of the scale is one of every DBH, and rulers and factors are not rounded by more.
_GIVEN_APART = 0.01
#: An end of a pole may lie beside the cloud by this share of the cloud's size. Source: judgement; the top of a pole may
#: have no point, and a digit or a sign that is wrong leads farther.
_BESIDE_CLOUD = 0.1


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


def doubt_ends(request: ScaleRequest, points: Floats, per_unit: float = 1.0) -> tuple[Notice, ...]:
    """Warn where one end point lies in the cloud and the other far beside it.

    Both may: a viewer that keeps the units may have moved the cloud, and only the distance of the ends counts.

    Parameters
    ----------
    points: (N, 3) of the cloud. per_unit: of what they are in, to one of the units of the end points.

    Raises
    ------
    ScaleError
        The ends are farther from each other than any two points of the cloud.
    """
    if request.endpoints is None:
        return ()
    low, high = points.min(axis=0) / per_unit, points.max(axis=0) / per_unit
    size, apart = float(np.linalg.norm(high - low)), math.dist(*request.endpoints)
    if apart > size * (1 + 2 * _BESIDE_CLOUD):
        first, second = (",".join(f"{value:g}" for value in end) for end in request.endpoints)
        msg = (
            f"--endpoints {first} {second}: they are {apart:.4g} apart, and the whole cloud measures only {size:.4g} "
            "from corner to corner; read both ends off this cloud, and look for a wrong digit"
        )
        raise ScaleError(msg)
    outside = [end for end in request.endpoints if not _near_box(np.array(end), low, high, _BESIDE_CLOUD * size)]
    if len(outside) != 1:
        return ()
    return (notice(CaptureCode.end_beside_cloud, end=",".join(f"{value:g}" for value in outside[0])),)


def _near_box(point: Floats, low: Floats, high: Floats, margin: float) -> bool:
    return bool(((point >= low - margin) & (point <= high + margin)).all())


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


def _faces(one: MarkerScale, other: MarkerScale) -> bool:
    if one.normal is None or other.normal is None:
        return False
    centers, normals = (np.array(one.center), np.array(other.center)), (np.array(one.normal), np.array(other.normal))
    return back_to_back(centers, normals, max(one.side_units, other.side_units))


def number_of_boards(markers: Sequence[MarkerScale]) -> int:
    """Boards that these markers are on, each of which checks the others; with its two faces one is one."""
    return len(by_board(markers))


def by_board(markers: Sequence[MarkerScale]) -> list[list[MarkerScale]]:
    """The markers board by board, in their order: both faces of one, and places of it between which a walk drifted."""
    unknown = (np.nan, np.nan, np.nan)
    centers = np.array([marker.center for marker in markers]).reshape(-1, 3)
    normals = np.array([marker.normal or unknown for marker in markers]).reshape(-1, 3)
    sides = np.array([marker.side_units for marker in markers])
    groups = markers_of_boards([marker.id for marker in markers], centers, normals, sides)
    return [[markers[index] for index in group] for group in groups]


def doubt_boards(scale: Scale) -> tuple[Notice, ...]:
    """Warn where the scale rests on one board, or boards contradict each other or the length that was given."""
    details = scale.details
    if not isinstance(details, MarkerDetails):
        return ()
    found: list[Notice] = []
    if number_of_boards(scale.markers) == 1:
        only = scale.markers[0]
        given = details.length_m is not None
        found.append(notice(CaptureCode.one_board, number=only.id, length_m=only.length_m, given=given))
    outvoted = {marker.id: marker for marker in scale.markers if marker.verdict == BoardVerdict.outvoted}
    for number, marker in outvoted.items():
        places = [other for other in scale.markers if other.id == number and not _faces(marker, other)]
        if any(other.verdict != BoardVerdict.outvoted for other in places):
            continue  # right at another place: not its print is wrong but the place of photos, which is told apart
        found.append(notice(CaptureCode.board_outvoted, number=number, residual_rel=marker.residual_rel))
    torn = [marker for marker in scale.markers if marker.verdict == BoardVerdict.contradicted]
    if torn:
        low, high = (choose(torn, key=lambda marker: marker.m_per_unit) for choose in (min, max))
        apart_rel = high.m_per_unit / low.m_per_unit - 1
        found.append(notice(CaptureCode.boards_contradict, first=low.id, second=high.id, apart_rel=apart_rel))
    printed = board_lengths() if details.dictionary == DICTIONARY and details.length_m is not None else {}
    other = [m for m in scale.markers if m.id in printed and abs(printed[m.id] / m.length_m - 1) > _OTHER_LENGTH]
    if other:
        numbers = tuple(str(number) for number in sorted({marker.id for marker in other}))
        lengths = (other[0].length_m, printed[other[0].id])
        found.append(
            notice(CaptureCode.printed_length_differs, numbers=numbers, given_m=lengths[0], printed_m=lengths[1])
        )
    return tuple(found)


def contradicts_given(scale: Scale, boards: Scale) -> tuple[Notice, ...]:
    """Warn where boards that tell their length make the scene another size than a ``scale`` from elsewhere does."""
    if scale.m_per_unit is None or boards.m_per_unit is None:
        return ()
    apart_rel = scale.m_per_unit / boards.m_per_unit - 1
    # The 95 % intervals of the two do not meet; of a scale that was given as a number there is none.
    unsure = Z95 * ((scale.rel_std or 0.0) + (boards.rel_std or 0.0))
    if abs(apart_rel) <= max(unsure, _GIVEN_APART):
        return ()
    agreeing = {marker.id for marker in boards.markers if marker.verdict != BoardVerdict.outvoted}
    numbers = tuple(str(number) for number in sorted(agreeing))
    return (notice(CaptureCode.boards_contradict_scale, numbers=numbers, apart_rel=apart_rel),)


def boards_at_two_places(boards: Scale, m_per_unit: float) -> tuple[Notice, ...]:
    """One notice for each board number found at several places: the sign of photos that were placed wrongly.

    ``m_per_unit`` are metres per unit of the scene, guessed where the scale is not known.
    """
    found = []
    for number in sorted({marker.id for marker in boards.markers}):
        places = sorted((m for m in boards.markers if m.id == number), key=lambda marker: -len(marker.views))
        for other in places[1:]:
            if any(_faces(place, other) for place in places if place is not other):
                continue
            apart_m = m_per_unit * float(np.linalg.norm(np.subtract(other.center, places[0].center)))
            if apart_m < LEAST_APART_M:
                continue
            views = sorted(other.views)
            found.append(
                notice(CaptureCode.board_at_two_places, number=number, apart_m=apart_m, first=views[0], last=views[-1])
            )
    return tuple(found)


def doubt_about_all(boards: Scale) -> Notice | None:
    """Why no stem of the plot is sure, or None: several of its boards contradict the places of the photos."""
    if not boards.markers:
        return None
    m_per_unit = boards.m_per_unit or float(np.median([marker.m_per_unit for marker in boards.markers]))
    apart_m: dict[int, float] = {}
    for told in boards_at_two_places(boards, m_per_unit):
        number, apart = told.values["number"], told.values["apart_m"]
        if isinstance(number, int) and isinstance(apart, float) and apart >= _WRONG_APART_M:
            apart_m[number] = max(apart, apart_m.get(number, 0.0))
    if len(apart_m) < max(_WRONG_NUMBERS, _WRONG_SHARE * len({marker.id for marker in boards.markers})):
        return None
    named = ", ".join(str(number) for number in sorted(apart_m))
    return notice(StemCode.boards_elsewhere, boards=named, apart_m=max(apart_m.values()))
