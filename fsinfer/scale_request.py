"""Where the user says the metric scale comes from: a factor, a known length between two points, or ArUco markers."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from fsinfer.board_places import boards_at_two_places
from fsinfer.errors import InputError, ScaleError
from fsinfer.progress import Progress, silent

if TYPE_CHECKING:
    from fsinfer.scale import Scale
    from fsinfer.scene import Scene

_log = logging.getLogger(__name__)

Point = tuple[float, float, float]
# Larger squares than this are a length in centimetres or millimetres.
LONGEST_BOARD_M = 2.0
NO_SCALE = (
    "no scale was given: the cloud is in model units and no DBH is measured; photograph boards printed by fsinfer "
    "marker, or ArUco markers of your own and give --aruco-length-m, or give --endpoints with --length-m (two points "
    "read off cloud.ply), or --scale"
)


@dataclass(frozen=True, kw_only=True)
class ScaleRequest:
    """At most one source of scale; with none, boards that tell their length are looked for.

    Attributes
    ----------
    factor: metres per unit of the cloud or scene.
    aruco_length_m: side of the black square of every ArUco marker in the photographs, metres.
    aruco_dictionary: name of the marker dictionary, as printed on the markers.
    endpoints: two points, in the units of the cloud without a scale; only their distance matters.
    length_m: the true distance of the two points, metres.
    printed_boards: without another source, look for boards printed by ``fsinfer marker``, whose numbers tell their
        length (:mod:`fsinfer.printed_boards`); the result is in model units where there are none.

    Raises
    ------
    InputError
        More than one source, half a source, or a length that is not positive.
    """

    factor: float | None = None
    aruco_length_m: float | None = None
    aruco_dictionary: str = "4X4_50"
    endpoints: tuple[Point, Point] | None = None
    length_m: float | None = None
    printed_boards: bool = True

    def __post_init__(self) -> None:
        given = [
            option
            for option, value in (
                ("--scale", self.factor),
                ("--aruco-length-m", self.aruco_length_m),
                ("--endpoints", self.endpoints),
            )
            if value is not None
        ]
        if len(given) > 1:
            msg = f"{' and '.join(given)} were given together; give one source of scale"
            raise InputError(msg)
        if (self.endpoints is None) != (self.length_m is None):
            there, missing = ("--endpoints", "--length-m") if self.length_m is None else ("--length-m", "--endpoints")
            msg = f"{there} was given without {missing}; give the two points and the distance between them in metres"
            raise InputError(msg)
        for option, length in (
            ("--scale", self.factor),
            ("--aruco-length-m", self.aruco_length_m),
            ("--length-m", self.length_m),
        ):
            if length is not None and not (math.isfinite(length) and length > 0):
                msg = f"{option} is {length}; it must be a number above 0"
                raise InputError(msg)
        if self.aruco_length_m is not None:
            if self.aruco_length_m > LONGEST_BOARD_M:
                centimetres = self.aruco_length_m / 100
                msg = (
                    f"--aruco-length-m {self.aruco_length_m:g}: no marker is so large; the side of the black square is "
                    f"given in metres ({self.aruco_length_m:g} cm are {centimetres:g})"
                )
                raise InputError(msg)
            _check_dictionary(self.aruco_dictionary)
        if self.endpoints is not None:
            distance = math.dist(*self.endpoints)
            if not math.isfinite(distance) or distance == 0:
                msg = f"--endpoints {self.endpoints[0]} and {self.endpoints[1]} need finite, different points"
                raise InputError(msg)

    @property
    def given(self) -> bool:
        """Whether the user named a source at all."""
        return self.factor is not None or self.aruco_length_m is not None or self.endpoints is not None


def parse_point(text: str) -> Point:
    """Read ``"X,Y,Z"``; raise :class:`InputError` for anything else."""
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) != 3:
        msg = f"--endpoints: {text!r} is not a point; write three numbers with commas and no spaces, like 1.2,-0.5,0.8"
        raise InputError(msg)
    return values[0], values[1], values[2]


def _check_dictionary(name: str) -> None:
    # A misspelt name must not show after an hour of structure from motion.
    from fsinfer.markers import dictionary_names

    known = dictionary_names()
    if name.upper().removeprefix("DICT_") not in known:
        msg = f"--aruco-dictionary {name} is unknown; it is one of {', '.join(known)}"
        raise InputError(msg)


def find_scale(
    request: ScaleRequest, *, scene: Scene | None, progress: Progress = silent
) -> tuple[Scale, tuple[str, ...]]:
    """Turn the request into a :class:`fsinfer.scale.Scale`, with warnings.

    Markers that were asked for and not found are a warning, not an error: everything computed so far stays useful in
    model units, and the next run with another source of scale takes seconds.

    Raises
    ------
    ScaleError
        ArUco markers were asked for where there are no photographs to look for them in.
    """
    from fsinfer.scale import Scale, scale_from_aruco, scale_from_endpoints, scale_from_factor

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
    from fsinfer.printed_boards import DICTIONARY, board_lengths
    from fsinfer.scale import scale_from_aruco

    try:
        return scale_from_aruco(scene, board_lengths(), dictionary=DICTIONARY, progress=progress)
    except ScaleError as error:
        # No board, or none that is seen well enough: nobody asked for boards, so that this is no warning of its own.
        _log.info("no scale from printed boards: %s", error)
        return None


def _of_unknown_length(request: ScaleRequest, scene: Scene, progress: Progress) -> str:
    """What to say where markers are seen whose numbers do not tell their length; empty where there are none."""
    from fsinfer.scale import scale_from_aruco

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
