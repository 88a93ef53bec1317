"""Where the user says the metric scale comes from: a factor, a known length between two points, or ArUco markers."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass

from fsinfer.errors import InputError
from fsinfer.scale.printed_boards import DICTIONARY

_log = logging.getLogger(__name__)

Point = tuple[float, float, float]
Pixel = tuple[float, float]
#: Width and height of a picture, pixels.
Size = tuple[int, int]
#: Larger squares than this are a length in centimetres or millimetres. Source: format; no printer makes them.
LONGEST_BOARD_M = 2.0


@dataclass(frozen=True, kw_only=True)
class ClickedEnds:
    """Both ends of a known length in one photograph: pixels (u, v) of the scene image, top left centre (0, 0).

    ``size`` is that of the picture they were clicked in, which may have another size by now; None where nothing says.
    """

    view: str
    first: Pixel
    second: Pixel
    size: Size | None = None


@dataclass(frozen=True, kw_only=True)
class ClickedLength:
    """A known length, its ends clicked in photographs; ``length_m`` is its real distance."""

    views: tuple[ClickedEnds, ...]
    length_m: float

    @property
    def by_view(self) -> dict[str, tuple[Pixel, Pixel]]:
        """The ends by the name of the view."""
        return {ends.view: (ends.first, ends.second) for ends in self.views}


@dataclass(frozen=True, kw_only=True)
class ScaleRequest:
    """At most one source of scale; with none, boards that tell their length are looked for.

    Attributes
    ----------
    factor: metres per unit of the cloud or scene. Source: option.
    aruco_length_m: side of the black square of every ArUco marker in the photographs, metres. Source: option.
    aruco_dictionary: name of the marker dictionary, as printed on the markers; kept in capitals and without OpenCV's
        ``DICT_``. Source: option.
    endpoints: two points, in the units of the cloud without a scale; only their distance matters. Source:
        option.
    length_m: the true distance of the two points, metres. Source: option.
    clicks: the two ends clicked in photographs (``fsinfer scale --click``), where no option names a source. Source:
        option.
    printed_boards: without another source, look for boards printed by ``fsinfer marker``, whose numbers tell their
        length (:mod:`fsinfer.scale.printed_boards`); the result is in model units where there are none. Source:
        option.

    Raises
    ------
    InputError
        More than one source, half a source, a length that is not positive, or an unknown dictionary.
    """

    factor: float | None = None
    aruco_length_m: float | None = None
    aruco_dictionary: str = DICTIONARY
    endpoints: tuple[Point, Point] | None = None
    length_m: float | None = None
    clicks: ClickedLength | None = None
    printed_boards: bool = True

    def __post_init__(self) -> None:
        given = [
            option
            for option, value in (
                ("--scale", self.factor),
                ("--aruco-length-m", self.aruco_length_m),
                ("--endpoints", self.endpoints),
                ("clicks", self.clicks),
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
        if self.aruco_length_m is not None and self.aruco_length_m > LONGEST_BOARD_M:
            centimetres = self.aruco_length_m / 100
            msg = (
                f"--aruco-length-m {self.aruco_length_m:g}: no marker is so large; the side of the black square is "
                f"given in metres ({self.aruco_length_m:g} cm are {centimetres:g})"
            )
            raise InputError(msg)
        # Stages whose settings differ run again, which another way to write the same name must not cause.
        object.__setattr__(self, "aruco_dictionary", _known_dictionary(self.aruco_dictionary))
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


def _known_dictionary(name: str) -> str:
    """The name without OpenCV's prefix, in capitals, as ``DICTIONARY`` is written."""
    plain = name.upper().removeprefix("DICT_")
    if plain == DICTIONARY:
        return plain
    # A misspelt name must not show after an hour of structure from motion.
    from fsinfer.scale.detection import dictionary_names

    known = dictionary_names()
    if plain not in known:
        msg = f"--aruco-dictionary {name} is unknown; it is one of {', '.join(known)}"
        raise InputError(msg)
    return plain
