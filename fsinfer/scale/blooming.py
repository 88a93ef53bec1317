"""By how much a camera draws the edges between black and white beside where they are, told by the markers themselves.

A lens blurs light, and the camera's tone curve brightens the dark side of what was blurred: at the half level of the
picture white has grown by up to half a pixel, and a black square of 36 pixels comes out up to 3 per cent too small.
Sharpening and tone mapping may do the opposite. A marker holds the measure of it: from the outer edge of its black
border to the white cells within it is one cell, and at both edges black gives way to white.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

#: Cells of fewer pixels blur into each other. Source: simulated markers of 24 to 50 pixels, blurred by 0.5 to 1.1.
_LEAST_CELL_PX = 5.0
#: Bright over dark, levels of 255. Source: judgement; twice what the corners need.
_MIN_CONTRAST = 40.0
#: Distance of the samples across an edge, pixels, and lines of samples along a cell, within its middle half. Source:
#: numerics.
_STEP_PX, _LINES, _MIDDLE = 0.25, 5, (0.25, 0.75)
#: White is looked for so far outside, from and to, in cells; so far into the white cell; black so far into the border.
#: Source: the cells; blur reaches a third of a cell.
_OUTSIDE, _INSIDE, _BORDER = (-0.7, -0.3), (1.35, 1.65), (0.4, 0.6)
#: Edges of one marker that tell. Source: judgement.
_FEWEST_EDGES = 3
#: What is left of the border's excess for each edge: both ends of it move, and the side that it is measured by as well.
#: Source: a border of one cell in a square of n grows by 2 (1 - 1 / n) of the shift of one edge.
_ENDS = 2.0
#: Standard deviation over median absolute deviation of a normal distribution. Source: numerics.
_STD_OVER_MAD = 1.4826


@dataclass(frozen=True, kw_only=True)
class Blooming:
    """``shift_px``: how far black edges stand outwards of where they are; ``std_px`` its standard deviation."""

    shift_px: float
    std_px: float


def bloom_of(
    grey: NDArray[np.uint8], corners_px: NDArray[np.float64], number: int, dictionary: cv2.aruco.Dictionary
) -> float | None:
    """How far the edges of one marker stand outwards, pixels; None where it is too small or too unclear to tell.

    Parameters
    ----------
    grey: (H, W). corners_px: (4, 2), clockwise in printed order. number: of the marker in ``dictionary``.
    """
    count = dictionary.markerSize + 2
    side_px = float(np.linalg.norm(corners_px - np.roll(corners_px, 1, axis=0), axis=1).mean())
    if side_px < count * _LEAST_CELL_PX:
        return None
    white = _cells(number, dictionary) > 0
    from_square = cv2.getPerspectiveTransform(
        np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32), corners_px.astype(np.float32)
    )
    step = _STEP_PX / side_px
    inwards = np.arange(_OUTSIDE[0] / count, (1 + _INSIDE[1]) / count, step)
    excess = []
    for edge in range(4):
        # The print turned so that this edge is at its top, and its columns run along the edge.
        for column in range(1, count - 1):
            if not np.rot90(white, edge)[1, column]:
                continue
            along = (column + np.linspace(*_MIDDLE, _LINES)) / count
            x, y = np.meshgrid(along, inwards)
            points = _turned_back(np.stack([x, y], axis=-1).reshape(-1, 2), edge)
            pixels = cv2.perspectiveTransform(points[None], from_square)[0].reshape(*x.shape, 2)
            width = _border_width(grey, pixels, inwards * count)
            if width is not None:
                px_per_cell = float(np.linalg.norm(pixels[-1] - pixels[0], axis=1).mean()) / (
                    (inwards[-1] - inwards[0]) * count
                )
                excess.append((width - 1.0) * px_per_cell)
    if len(excess) < _FEWEST_EDGES:
        return None
    return float(np.median(excess)) / (_ENDS * (1.0 - 1.0 / count))


def common_blooming(
    shifts_px: Sequence[float | None], *, fewest: int, least_std_px: float, varies: float
) -> Blooming | None:
    """What all sightings say together; None where fewer than ``fewest`` tell.

    Parameters
    ----------
    least_std_px: it is known no better. varies: share of the shift by which near and far sightings differ.
    """
    told = np.array([shift for shift in shifts_px if shift is not None])
    if len(told) < fewest:
        return None
    shift = float(np.median(told))
    spread = _STD_OVER_MAD * float(np.median(np.abs(told - shift)))
    # A median scatters by sqrt(pi / 2) more than a mean.
    error = spread * np.sqrt(np.pi / 2 / len(told))
    return Blooming(shift_px=shift, std_px=float(np.sqrt(least_std_px**2 + error**2 + (varies * shift) ** 2)))


def without_blooming(corners_px: NDArray[np.float64], shift_px: float) -> NDArray[np.float64]:
    """The corners (4, 2), clockwise, of a square whose edges are moved inwards by ``shift_px``."""
    lines = []
    for start, end in zip(corners_px, np.roll(corners_px, -1, axis=0), strict=True):
        along = (end - start) / np.linalg.norm(end - start)
        inwards = np.array([-along[1], along[0]]) * shift_px  # clockwise with y down: inside is to the right
        lines.append(np.cross([*(start + inwards), 1.0], [*(end + inwards), 1.0]))
    met = np.array([np.cross(lines[corner - 1], lines[corner]) for corner in range(4)])
    return np.asarray(met[:, :2] / met[:, 2:])


def _cells(number: int, dictionary: cv2.aruco.Dictionary) -> NDArray[np.uint8]:
    """Cells of a marker with its border, (n, n) uint8, white 255."""
    side = dictionary.markerSize + 2
    return np.asarray(cv2.aruco.generateImageMarker(dictionary, number, side, borderBits=1), np.uint8)


def _turned_back(points: NDArray[np.float64], edge: int) -> NDArray[np.float64]:
    """Points (N, 2) of the unit square as they lie in the print, which ``np.rot90`` had turned ``edge`` times."""
    for _ in range(edge):
        points = np.column_stack([1.0 - points[:, 1], points[:, 0]])
    return points


def _border_width(grey: NDArray[np.uint8], pixels: NDArray[np.float64], inwards: NDArray[np.float64]) -> float | None:
    """Width of the black border, in cells, along a strip of samples; None where it is not clear.

    Parameters
    ----------
    pixels: (S, L, 2), S samples across the border, on L lines. inwards: (S,), cells from the outer edge.
    """
    height, width = grey.shape
    if pixels.min() < 0 or (pixels.max(axis=(0, 1)) > [width - 1, height - 1]).any():
        return None
    left, top = np.floor(pixels.min(axis=(0, 1))).astype(int)
    right, bottom = np.ceil(pixels.max(axis=(0, 1))).astype(int) + 1
    patch = grey[top:bottom, left:right].astype(np.float32)
    local = (pixels - [left, top]).astype(np.float32)
    sampled = cv2.remap(patch, local[..., 0], local[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    profile = sampled.mean(axis=1)
    outside, inside, border = (
        profile[(inwards > first) & (inwards < last)] for first, last in (_OUTSIDE, _INSIDE, _BORDER)
    )
    dark = float(border.mean())
    if min(outside.mean(), inside.mean()) - dark < _MIN_CONTRAST:
        return None
    middle = int(np.abs(inwards - 0.5).argmin())
    falls = _crossing(inwards[: middle + 1], profile[: middle + 1], (float(outside.mean()) + dark) / 2, rising=False)
    rises = _crossing(inwards[middle:], profile[middle:], (float(inside.mean()) + dark) / 2, rising=True)
    return None if falls is None or rises is None else rises - falls


def _crossing(at: NDArray[np.float64], profile: NDArray[np.float32], level: float, *, rising: bool) -> float | None:
    """Where a profile passes a level, once."""
    above = profile >= level
    changes = np.flatnonzero(above[1:] != above[:-1])
    if len(changes) != 1 or bool(above[-1]) is not rising:
        return None
    index = int(changes[0])
    share = (level - profile[index]) / (profile[index + 1] - profile[index])
    return float(at[index] + share * (at[index + 1] - at[index]))
