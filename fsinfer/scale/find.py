"""From what the user asked for to the scale of a scene, with what is doubtful about it."""

from __future__ import annotations

import logging
from collections import Counter
from dataclasses import dataclass, replace

from fsinfer.errors import ScaleError
from fsinfer.notices.capture import CaptureCode
from fsinfer.notices.notice import Notice, notice
from fsinfer.progress import Progress, silent
from fsinfer.scale.aruco import scale_from_aruco
from fsinfer.scale.clicks.sizes import fit_clicks, picture_sizes
from fsinfer.scale.doubts import boards_at_two_places, contradicts_given, doubt_boards
from fsinfer.scale.marker_search import SeenMarkers, are_known, look_for_markers
from fsinfer.scale.printed_boards import DICTIONARY, board_lengths
from fsinfer.scale.request import ClickedLength, ScaleRequest
from fsinfer.scale.scale import UNKNOWN, Scale, scale_from_factor
from fsinfer.scale.square_fit import MarkerSettings
from fsinfer.scale.two_ends import scale_from_clicks, scale_from_endpoints
from fsinfer.scene import Scene

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class FoundScale:
    """The scale of a scene, unknown where nothing gave one, with warnings.

    ``others`` are the boards that are seen where the scale comes from elsewhere, whatever their length
    (:func:`seen_boards`).
    """

    scale: Scale
    warnings: tuple[Notice, ...] = ()
    others: Scale = UNKNOWN

    @property
    def boards(self) -> Scale:
        """What is known of the boards in the photographs, whether they gave the scale or not."""
        return self.scale if self.scale.markers else self.others


def find_scale(
    request: ScaleRequest,
    *,
    scene: Scene | None,
    settings: MarkerSettings | None = None,
    progress: Progress = silent,
) -> FoundScale:
    """Turn the request into a scale.

    Markers that were asked for and not found are a warning, not an error: everything computed so far stays useful in
    model units, and the next run with another source of scale takes seconds. Where the scale comes from elsewhere, and
    it is known where the markers are in the images, the boards check it.

    Raises
    ------
    ScaleError
        ArUco markers were asked for where there are no photographs to look for them in.
    """
    found = _by_request(request, scene, settings, progress)
    m_per_unit, dictionary = found.scale.m_per_unit, request.aruco_dictionary
    if scene is None or m_per_unit is None or found.scale.markers or not are_known(scene, dictionary, settings):
        return found
    seen = look_for_markers(scene, dictionary=dictionary, settings=settings, progress=progress)
    boards = seen_boards(scene, seen, m_per_unit=m_per_unit, settings=settings)
    printed = scale_from_printed_boards(scene, seen, settings=settings) if dictionary == DICTIONARY else None
    doubts = () if printed is None else contradicts_given(found.scale, printed)
    told = (*found.warnings, *doubts, *boards_at_two_places(boards, m_per_unit))
    return replace(found, others=boards, warnings=told)


def _by_request(
    request: ScaleRequest, scene: Scene | None, settings: MarkerSettings | None, progress: Progress
) -> FoundScale:
    """The scale by the source that was asked for."""
    if request.factor is not None:
        return FoundScale(scale=scale_from_factor(request.factor))
    if request.endpoints is not None and request.length_m is not None:
        return FoundScale(scale=scale_from_endpoints(*request.endpoints, request.length_m, settings=settings))
    if request.clicks is not None and scene is not None:
        return _by_clicks(request, request.clicks, scene, settings, progress)
    if request.aruco_length_m is None:
        if scene is None or not request.printed_boards:
            return FoundScale(scale=UNKNOWN, warnings=(notice(CaptureCode.no_scale_given),))
        seen = look_for_markers(scene, dictionary=DICTIONARY, settings=settings, progress=progress)
        boards = scale_from_printed_boards(scene, seen, settings=settings)
        if boards is not None:
            return FoundScale(scale=boards, warnings=(*doubt_boards(boards), *_twice(boards)))
        return FoundScale(scale=UNKNOWN, warnings=(_of_unknown_length(request, scene, seen, settings, progress),))
    if scene is None:
        msg = (
            "--aruco-length-m looks for the markers in the photographs, and there is no scene here; use it with "
            "fsinfer run, or give --scale or --endpoints with --length-m"
        )
        raise ScaleError(msg)
    try:
        scale = scale_from_aruco(
            scene, request.aruco_length_m, dictionary=request.aruco_dictionary, settings=settings, progress=progress
        )
    except ScaleError as error:
        return FoundScale(scale=UNKNOWN, warnings=(notice(CaptureCode.no_scale_from_markers, error=str(error)),))
    return FoundScale(scale=scale, warnings=(*doubt_boards(scale), *_twice(scale)))


def _by_clicks(
    request: ScaleRequest, clicked: ClickedLength, scene: Scene, settings: MarkerSettings | None, progress: Progress
) -> FoundScale:
    """By the clicks; where they do not fit the scene, which may have been registered anew, as if there were none."""
    try:
        fitted = fit_clicks(clicked, picture_sizes(scene))
        return FoundScale(scale=scale_from_clicks(scene, fitted.by_view, fitted.length_m, settings=settings))
    except ScaleError as error:
        told = notice(CaptureCode.clicks_do_not_fit, error=str(error))
        other = _by_request(replace(request, clicks=None), scene, settings, progress)
        return replace(other, warnings=(told, *other.warnings))


def seen_boards(scene: Scene, seen: SeenMarkers, *, m_per_unit: float, settings: MarkerSettings | None = None) -> Scale:
    """The boards among the markers ``seen``, whatever their length, in a scene of ``m_per_unit``.

    Lengths, residuals and verdicts of its markers mean nothing. :data:`fsinfer.scale.scale.UNKNOWN` where none can be
    used.
    """
    try:
        boards = scale_from_aruco(scene, 1.0, dictionary=seen.dictionary, settings=settings, seen=seen)
    except ScaleError as error:
        _log.info("no boards: %s", error)
        return UNKNOWN
    return replace(UNKNOWN, m_per_unit=m_per_unit, details=boards.details)


def scale_from_printed_boards(
    scene: Scene, seen: SeenMarkers, *, settings: MarkerSettings | None = None
) -> Scale | None:
    """The scale by boards that tell their length among the markers ``seen``, None where no such board can be used."""
    try:
        return scale_from_aruco(scene, board_lengths(), dictionary=DICTIONARY, settings=settings, seen=seen)
    except ScaleError as error:
        # No board, or none that is seen well enough: nobody asked for boards, so that this is no warning of its own.
        _log.info("no scale from printed boards: %s", error)
        return None


def _of_unknown_length(
    request: ScaleRequest, scene: Scene, looked: SeenMarkers, settings: MarkerSettings | None, progress: Progress
) -> Notice:
    """What to say without a scale: the numbers of markers where some are seen that do not tell their length."""
    try:
        # Which ones are seen does not depend on the length.
        seen = scale_from_aruco(
            scene, 1.0, dictionary=request.aruco_dictionary, settings=settings, progress=progress, seen=looked
        )
    except ScaleError as error:
        # Who put boards up is told why they do not do, not to put boards up.
        if _shows_printed_board(looked):
            return notice(CaptureCode.no_scale_from_markers, error=str(error))
        return notice(CaptureCode.no_scale_given)
    numbers = tuple(str(marker.id) for marker in seen.markers)
    return notice(CaptureCode.markers_of_unknown_length, numbers=numbers)


def _shows_printed_board(seen: SeenMarkers) -> bool:
    """Whether one of our boards is in two photographs: in one alone, bark and twigs are taken for a marker too."""
    own = board_lengths()
    views = Counter(number for number, _ in {(one.marker_id, one.view) for one in seen.sightings} if number in own)
    return seen.dictionary == DICTIONARY and max(views.values(), default=0) > 1


def _twice(scale: Scale) -> tuple[Notice, ...]:
    return boards_at_two_places(scale, scale.m_per_unit or 1.0)
