"""ArUco markers in one photograph: dictionaries, detector, corners."""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import ScaleError
from fsinfer.io.images import luminance
from fsinfer.scale.corners import refine_corners
from fsinfer.scale.square_fit import MarkerSettings

_PREFIX = "DICT_"


def dictionary_names() -> list[str]:
    """The names that ``--aruco-dictionary`` takes."""
    return sorted(name.removeprefix(_PREFIX) for name in dir(cv2.aruco) if name.startswith(_PREFIX))


def predefined_dictionary(dictionary: str) -> cv2.aruco.Dictionary:
    """OpenCV's dictionary of that name; :class:`ScaleError` where there is none."""
    name = dictionary.upper().removeprefix(_PREFIX)
    if name not in dictionary_names():
        msg = f"there is no ArUco dictionary {dictionary!r}; choose one of {', '.join(dictionary_names())}"
        raise ScaleError(msg)
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, _PREFIX + name))


def make_detector(dictionary: str) -> cv2.aruco.ArucoDetector:
    """An OpenCV detector with sub-pixel corners; :class:`ScaleError` for an unknown dictionary."""
    parameters = cv2.aruco.DetectorParameters()
    # A start for our own refinement, which is not biased.
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    return cv2.aruco.ArucoDetector(predefined_dictionary(dictionary), parameters)


def detect_markers(
    image: NDArray[np.uint8], detector: cv2.aruco.ArucoDetector, *, min_side_px: float = MarkerSettings.min_side_px
) -> list[tuple[int, NDArray[np.float64]]]:
    """Find markers in an (H, W, 3) RGB uint8 image: (number, (4, 2) float64 corners in pixels, clockwise)."""
    grey = luminance(image)
    corners, numbers, _ = detector.detectMarkers(grey)
    # OpenCV gives None for the numbers where there is no marker.
    named = zip(() if not corners else np.asarray(numbers).ravel(), corners, strict=True)
    places = [(int(number), np.asarray(quad, dtype=np.float64).reshape(4, 2)) for number, quad in named]
    return at_their_edges(grey, places, min_side_px=min_side_px)


def at_their_edges(
    grey: NDArray[np.uint8], places: Iterable[tuple[int, NDArray[np.float64]]], *, min_side_px: float
) -> list[tuple[int, NDArray[np.float64]]]:
    """Markers (number, (4, 2) corners within about a pixel) of an (H, W) image, with corners where their edges meet.

    Those with a side shorter than ``min_side_px`` are left out.
    """
    found = []
    for number, corners_px in places:
        sides = np.linalg.norm(corners_px - np.roll(corners_px, 1, axis=0), axis=1)
        if sides.min() >= min_side_px:
            found.append((number, refine_corners(grey, corners_px)))
    return found
