"""Sub-pixel corners of a black square on white: lines through the half-level crossings of its four edges.

``cv2.cornerSubPix`` pulls the corner of a blurred square inwards: on renders of 35-pixel markers the sides came out
0.7 % short, and with them every diameter 0.7 % long. The half level of a symmetric blur is where the edge is.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

#: Part of a side that is not used at each end: ends are rounded by blur. Source: judgement.
_ENDS = 0.12
#: Bright over dark, levels of 255. Source: judgement.
_MIN_CONTRAST = 20.0
#: Distance of the samples across an edge, pixels; and of samples along it, at least and at most so many. Source:
#: numerics.
_STEP_PX, _FEWEST_SAMPLES, _MOST_SAMPLES = 0.25, 8, 64
#: How far edges are looked for to both sides, share of the side, at least and at most so many pixels. Source: the black
#: border is a sixth of the side of a 4x4 marker, and the white rim may be as narrow.
_REACH_SHARE, _LEAST_REACH_PX, _MOST_REACH_PX = 0.11, 1.5, 5.0
#: How far a corner may move, share of the side, or the least reach where that is more. Source: judgement.
_MAX_MOVE_SHARE = 0.08
#: A crossing farther off the line than this, pixels, or so many robust standard deviations, is none. Source: judgement.
_MISFIT_PX, _MISFIT_STDS = 0.15, 3
#: Crossings that a line needs, of half of the samples at least. Source: numerics.
_FEWEST_CROSSINGS = 4
#: Standard deviation over median absolute deviation of a normal distribution. Source: numerics.
_STD_OVER_MAD = 1.4826
#: Lengths that stand for none. Source: numerics.
_LEAST = 1e-9


def refine_corners(grey: NDArray[np.uint8], corners_px: NDArray[np.float64]) -> NDArray[np.float64]:
    """Move the corners of a dark square to where the lines along its edges meet.

    Parameters
    ----------
    grey: (H, W) uint8.
    corners_px: (4, 2) float64, clockwise in the image, within about a pixel.

    Returns
    -------
    (4, 2) float64; a corner stays where it was when one of its edges cannot be followed (shade, a leaf, the border).
    """
    corners = corners_px
    for _ in range(2):
        lines = [_edge_line(grey, corners[side], corners[(side + 1) % 4]) for side in range(4)]
        moved = corners.copy()
        for corner in range(4):
            before, after = lines[corner - 1], lines[corner]
            if before is not None and after is not None:
                met = np.cross(before, after)
                if abs(met[2]) > _LEAST:
                    moved[corner] = met[:2] / met[2]
        side_px = float(np.linalg.norm(corners_px - np.roll(corners_px, 1, axis=0), axis=1).mean())
        far = np.linalg.norm(moved - corners_px, axis=1) > max(_LEAST_REACH_PX, _MAX_MOVE_SHARE * side_px)
        corners = np.where(far[:, None], corners_px, moved)
    return corners


def _edge_line(
    grey: NDArray[np.uint8], start: NDArray[np.float64], end: NDArray[np.float64]
) -> NDArray[np.float64] | None:
    """The homogeneous line (3,) along the edge from ``start`` to ``end``, dark on its right."""
    length = float(np.linalg.norm(end - start))
    along = (end - start) / max(length, _LEAST)
    # Clockwise with y down: the outside is to the left of the direction of travel.
    outward = np.array([along[1], -along[0]])
    reach = float(np.clip(_REACH_SHARE * length, _LEAST_REACH_PX, _MOST_REACH_PX))
    shares = np.linspace(_ENDS, 1 - _ENDS, int(np.clip(length, _FEWEST_SAMPLES, _MOST_SAMPLES)))
    offsets = np.arange(-reach, reach + _LEAST, _STEP_PX)
    points = start + shares[:, None, None] * (end - start) + offsets[None, :, None] * outward
    height, width = grey.shape
    if points.min() < 0 or (points.max(axis=(0, 1)) > [width - 1, height - 1]).any():
        return None
    left, top = np.floor(points.min(axis=(0, 1))).astype(int)
    right, bottom = np.ceil(points.max(axis=(0, 1))).astype(int) + 1
    patch = grey[top:bottom, left:right].astype(np.float32)
    local = (points - [left, top]).astype(np.float32)
    # remap takes at most 32767 columns, far more than the offsets here.
    profiles = cv2.remap(patch, local[..., 0], local[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    crossings = np.array([_crossing(profile, offsets) for profile in profiles])
    valid = np.isfinite(crossings)
    if valid.sum() < max(_FEWEST_CROSSINGS, len(shares) // 2):
        return None
    for _ in range(2):
        slope, middle = np.polyfit(shares[valid], crossings[valid], 1)
        misfit = np.abs(crossings - (slope * shares + middle))
        limit = max(_MISFIT_PX, _MISFIT_STDS * _STD_OVER_MAD * float(np.median(misfit[valid])))
        kept = valid & (misfit <= limit)
        if kept.sum() < max(_FEWEST_CROSSINGS, len(shares) // 2):
            break
        valid = kept
    first, second = (start + share * (end - start) + (slope * share + middle) * outward for share in (0.0, 1.0))
    return np.asarray(np.cross([*first, 1.0], [*second, 1.0]))


def _crossing(profile: NDArray[np.float32], offsets: NDArray[np.float64]) -> float:
    """Offset at which a profile from dark to bright passes the level half way; NaN where it does not."""
    dark, bright = float(profile[:3].mean()), float(profile[-3:].mean())
    if bright - dark < _MIN_CONTRAST:
        return float("nan")
    above = profile >= (dark + bright) / 2
    rises = np.flatnonzero(above[1:] & ~above[:-1])
    if len(rises) != 1:
        return float("nan")
    index = int(rises[0])
    share = ((dark + bright) / 2 - profile[index]) / (profile[index + 1] - profile[index])
    return float(offsets[index] + share * (offsets[index + 1] - offsets[index]))
