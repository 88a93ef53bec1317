"""From what the user asked for to the scale of a scene, with what is doubtful about it."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

from fsinfer.errors import ScaleError
from fsinfer.progress import Progress, silent
from fsinfer.scale.doubts import boards_at_two_places
from fsinfer.scale.request import ScaleRequest

if TYPE_CHECKING:
    from fsinfer.scale.scale import Scale
    from fsinfer.scene import Scene

_log = logging.getLogger(__name__)
NO_SCALE = (
    "no scale was given: the cloud is in model units and no DBH is measured; photograph boards printed by fsinfer "
    "marker, or ArUco markers of your own and give --aruco-length-m, or give --endpoints with --length-m (two points "
    "read off cloud.ply), or --scale"
)


def find_scale(
    request: ScaleRequest, *, scene: Scene | None, progress: Progress = silent
) -> tuple[Scale, tuple[str, ...]]:
    """Turn the request into a :class:`fsinfer.scale.scale.Scale`, with warnings.

    Markers that were asked for and not found are a warning, not an error: everything computed so far stays useful in
    model units, and the next run with another source of scale takes seconds.

    Raises
    ------
    ScaleError
        ArUco markers were asked for where there are no photographs to look for them in.
    """
    from fsinfer.scale.aruco import scale_from_aruco
    from fsinfer.scale.scale import Scale, scale_from_endpoints, scale_from_factor

    nothing = Scale(m_per_unit=None, source="none", rel_std=None, details={})
    if request.factor is not None:
        return scale_from_factor(request.factor), ()
    if request.endpoints is not None and request.length_m is not None:
        return scale_from_endpoints(*request.endpoints, request.length_m), ()
    if request.aruco_length_m is None:
        if scene is None or not request.printed_boards:
            return nothing, (NO_SCALE,)
        boards = scale_from_printed_boards(scene, progress)
        if boards is not None:
            return boards, (*_few_boards(boards), *_twice(boards))
        return nothing, (_of_unknown_length(request, scene, progress) or NO_SCALE,)
    if scene is None:
        msg = (
            "--aruco-length-m looks for the markers in the photographs, and there is no scene here; use it with "
            "fsinfer run, or give --scale or --endpoints with --length-m"
        )
        raise ScaleError(msg)
    try:
        scale = scale_from_aruco(scene, request.aruco_length_m, dictionary=request.aruco_dictionary, progress=progress)
    except ScaleError as error:
        return nothing, (f"no scale from ArUco markers, the result is in model units and no DBH is measured: {error}",)
    return scale, _twice(scale)


def scale_from_printed_boards(scene: Scene, progress: Progress) -> Scale | None:
    """The scale by boards that tell their length, or None where no such board can be used."""
    from fsinfer.scale.aruco import scale_from_aruco
    from fsinfer.scale.printed_boards import DICTIONARY, board_lengths

    try:
        return scale_from_aruco(scene, board_lengths(), dictionary=DICTIONARY, progress=progress)
    except ScaleError as error:
        # No board, or none that is seen well enough: nobody asked for boards, so that this is no warning of its own.
        _log.info("no scale from printed boards: %s", error)
        return None


def _of_unknown_length(request: ScaleRequest, scene: Scene, progress: Progress) -> str:
    """What to say where markers are seen whose numbers do not tell their length; empty where there are none."""
    from fsinfer.scale.aruco import scale_from_aruco

    try:
        # Which ones are seen does not depend on the length.
        seen = scale_from_aruco(scene, 1.0, dictionary=request.aruco_dictionary, progress=progress)
    except ScaleError:
        return ""
    numbers = ", ".join(str(marker["id"]) for marker in seen.details["markers"])
    return (
        f"no scale was given, but ArUco markers are seen (number {numbers}) whose length is not known: measure the "
        "side of the black square and run again with --aruco-length-m, in metres; until then the cloud is in model "
        "units and no DBH is measured"
    )


def _twice(scale: Scale) -> tuple[str, ...]:
    return tuple(line.removesuffix(".") for line in boards_at_two_places(scale, scale.m_per_unit or 1.0))


def _few_boards(scale: Scale) -> tuple[str, ...]:
    found = scale.details["markers"]
    if len(found) > 1:
        return ()
    return (
        f"the scale rests on one board (number {found[0]['id']}, {found[0]['length_m']:g} m by its number); "
        "measure it with a ruler, and put up three or more next time",
    )
