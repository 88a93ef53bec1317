"""Boards as ties: the corners of a marker are the same four points wherever they are seen.

They need no texture, do not move in the wind, and are known by their number: they close loops, join parts of a walk
that share no matches, and hold the scale of the model even.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fsinfer.io.images import read_image
from fsinfer.progress import Progress
from fsinfer.scale.detection import detect_markers, make_detector
from fsinfer.scale.square_fit import FittedMarker, MarkerSettings, Sighting, find_markers
from fsinfer.threads import in_order

#: COLMAP's pixel (0, 0) has its centre at (0.5, 0.5), ours at (0, 0). Source: COLMAP.
_HALF_PIXEL = 0.5
#: Sightings that fit a board this well are tied, pixels, or this share of the side of the square. Source: judgement;
#: the drift that ties are to take out may be some pixels.
_GATE_PX, _GATE_SHARE = 6.0, 0.15


@dataclass(frozen=True, kw_only=True)
class BoardSighting:
    """One detection in a photo: its file, the marker's number, (4, 2) corners in COLMAP's pixels, in printed order."""

    file: str
    number: int
    corners_px: NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Board:
    """A square found in a model: its number, (4, 3) corners in the model's frame, and where it was seen.

    ``sightings`` are (image id, corners in COLMAP's pixels).
    """

    number: int
    corners: NDArray[np.float64]
    sightings: tuple[tuple[int, NDArray[np.float64]], ...]

    @property
    def side(self) -> float:
        """Mean side in model units."""
        return float(np.linalg.norm(self.corners - np.roll(self.corners, 1, axis=0), axis=1).mean())


def find_boards(
    images: Path, files: Sequence[str], *, dictionary: str, longest_px: int, progress: Progress, threads: int
) -> list[BoardSighting]:
    """Look for markers in all photos, made smaller to ``longest_px`` where they are larger; in the order of files."""

    def look(file: str) -> list[BoardSighting]:
        pixels = read_image(images / file)
        factor = max(1.0, max(pixels.shape[:2]) / longest_px)
        if factor > 1.0:
            size = (round(pixels.shape[1] / factor), round(pixels.shape[0] / factor))
            pixels = np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), np.uint8)
        # OpenCV does not say that a detector may be shared between threads; making one takes no time.
        return [
            BoardSighting(file=file, number=number, corners_px=(corners + _HALF_PIXEL) * factor)
            for number, corners in detect_markers(pixels, make_detector(dictionary))
        ]

    found: list[BoardSighting] = []
    progress(0, len(files), "looking for boards")
    for done, seen in enumerate(in_order(look, files, threads), 1):
        found += seen
        progress(done, len(files), "looking for boards")
    return found


def corners_of_pixels(sighting: BoardSighting) -> NDArray[np.float64]:
    """Its corners (4, 2) with the centres of pixels at whole numbers."""
    return sighting.corners_px - _HALF_PIXEL


def boards_in(model: Any, sightings: Sequence[BoardSighting]) -> list[Board]:
    """The boards that the placed photos of a ``pycolmap.Reconstruction`` see, each face of a two-faced one apart."""
    by_name = {model.images[i].name: i for i in model.reg_image_ids()}
    image_ids = sorted({by_name[s.file] for s in sightings if s.file in by_name})
    index = {image_id: k for k, image_id in enumerate(image_ids)}
    projections, centers = [], []
    for image_id in image_ids:
        image = model.images[image_id]
        focal = model.cameras[image.camera_id].mean_focal_length()
        # Corners are straightened to a pinhole whose principal point is (0, 0).
        projections.append(np.diag([focal, focal, 1.0]) @ image.cam_from_world().matrix())
        centers.append(image.projection_center())
    seen: dict[int, list[Sighting]] = {}
    original: dict[int, NDArray[np.float64]] = {}
    for sighting in sightings:
        if sighting.file not in by_name:
            continue
        image_id = by_name[sighting.file]
        camera = model.cameras[model.images[image_id].camera_id]
        plane = np.asarray(camera.cam_from_img(sighting.corners_px), np.float64).reshape(4, 2)
        straight = Sighting(
            marker_id=sighting.number, view=index[image_id], corners_px=plane * camera.mean_focal_length()
        )
        seen.setdefault(sighting.number, []).append(straight)
        original[id(straight)] = sighting.corners_px
    settings = MarkerSettings(gate_px=_GATE_PX, gate_side_share=_GATE_SHARE)
    boards = []
    for number in sorted(seen):
        found: list[FittedMarker] = find_markers(seen[number], projections, np.array(centers), settings)[0]
        for square in found:
            own = tuple((image_ids[s.view], original[id(s)]) for s in square.sightings)
            boards.append(Board(number=number, corners=square.corners, sightings=own))
    return boards


def tie_boards(model: Any, boards: Sequence[Board]) -> int:
    """Give the model the corners of the boards as points seen in all their photos; returns how many were added."""
    import pycolmap

    added = 0
    for board in boards:
        for corner in range(4):
            track = pycolmap.Track()
            for image_id, corners_px in board.sightings:
                points = model.images[image_id].points2D
                points.append(pycolmap.Point2D(corners_px[corner]))
                track.add_element(image_id, len(points) - 1)
            model.add_point3D(board.corners[corner], track, np.zeros(3, np.uint8))
            added += 1
    return added


def by_number(boards: Sequence[Board]) -> Mapping[int, list[Board]]:
    """The boards of each number."""
    numbers: dict[int, list[Board]] = {}
    for board in boards:
        numbers.setdefault(board.number, []).append(board)
    return numbers
