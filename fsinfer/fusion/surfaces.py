"""The surface around the pixels of one depth map: flying pixels and normals.

Both ask which neighbours of a pixel lie on the same surface: those whose depth differs by no more than a surface as
steep as :data:`MAX_SLOPE` would, plus noise.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from fsinfer.depth.maps import DepthMap

#: Depth change from pixel to pixel, in pixel footprints (z / f), still taken for one surface: the tangent of the angle
#: between ray and normal. Source: judgement; 80 degrees.
MAX_SLOPE = 5.7
#: Neighbours for normals: a square ring at distance 1 and one at distance 2 around the pixel. Source: numerics.
_RING = tuple((du, dv) for r in (1, 2) for du in (-r, 0, r) for dv in (-r, 0, r) if (du, dv) != (0, 0))
_REACH = max(abs(du) for du, _ in _RING)
#: Sums whose determinant is less have no plane; lengths that stand for none. Source: numerics.
_LEAST_DETERMINANT, _LEAST_LENGTH = 1e-9, 1e-30


def smooth_pixels(reference: DepthMap, *, min_neighbours: int, noise: float) -> NDArray[np.bool_]:
    """(h, w) bool: enough of the 8 neighbours lie on the same surface as the pixel (others are flying pixels).

    Parameters
    ----------
    min_neighbours: of 8.
    noise: relative depth difference of neighbours that is noise.
    """
    inverse = reference.inverse_depth
    height, width = inverse.shape
    padded = np.pad(inverse, 1)
    slope = MAX_SLOPE / reference.intrinsic[0, 0]
    count = np.zeros((height, width), dtype=np.uint8)
    for du in (-1, 0, 1):
        for dv in (-1, 0, 1):
            if du == 0 and dv == 0:
                continue
            other = padded[1 + dv : 1 + dv + height, 1 + du : 1 + du + width]
            # |z' - z| <= limit * z with q = 1/z becomes |q - q'| <= limit * q': no division, and q' = 0 never passes.
            limit = np.float32(slope * np.hypot(du, dv) + noise)
            count += (np.abs(inverse - other) <= limit * np.minimum(other, inverse)) & (other > 0)
    # Outside the image there is nothing to compare with: the border needs as large a part of what it has.
    present = (
        cv2.filter2D(np.ones((height, width), np.uint8), -1, np.ones((3, 3)), borderType=cv2.BORDER_CONSTANT).astype(
            np.int16
        )
        - 1
    )
    return np.asarray(8 * count.astype(np.int16) >= min_neighbours * present)


def ring_sums(reference: DepthMap, noise: float) -> NDArray[np.float32]:
    """(5, h, w) sums over the neighbours of each pixel on its surface: x^2, x y, y^2, x q and y q.

    x and y are the way there in pixels, q is the difference of 1/z; a neighbour outside of the map is the nearest one
    in it. All pixels at once, whether they are asked for or not: shifted pictures are read three times as fast as
    pixels one by one.
    """
    inverse = reference.inverse_depth
    height, width = inverse.shape
    slope = MAX_SLOPE / reference.intrinsic[0, 0]
    padded = np.pad(inverse, _REACH, mode="edge")
    rows, columns = np.arange(height), np.arange(width)
    sums = np.zeros((5, height, width), np.float32)
    for du, dv in _RING:
        there = padded[_REACH + dv : _REACH + dv + height, _REACH + du : _REACH + du + width]
        x = (np.clip(columns + du, 0, width - 1) - columns).astype(np.float32)
        y = (np.clip(rows + dv, 0, height - 1) - rows).astype(np.float32)[:, None]
        difference = there - inverse
        limit = np.float32(slope * np.hypot(du, dv) + noise)
        # Where the pixel itself has no depth the least of both is 0, and no difference is less.
        same = ((np.abs(difference) <= limit * np.minimum(there, inverse)) & (there > 0)).astype(np.float32)
        difference *= same
        if du:
            sums[0] += x * x * same
            sums[3] += x * difference
        if dv:
            sums[2] += y * y * same
            sums[4] += y * difference
        if du and dv:
            sums[1] += (x * y) * same
    return sums


def pixel_normals(
    reference: DepthMap,
    rows: NDArray[np.intp],
    columns: NDArray[np.intp],
    *,
    noise: float,
) -> NDArray[np.float32]:
    """(N, 3) unit normals in camera coordinates, towards the camera, from the depths around N pixels.

    On a plane n.X = h, 1/z = (n/h)^T K^-1 (u, v, 1) is affine in the pixel; with its coefficients (a, b, c) from a
    least-squares fit to the neighbours on the same surface, n is parallel to K^T (a, b, c).
    """
    if not len(rows):
        return np.empty((0, 3), np.float32)
    # By the numbers of the pixels, which takes a third of what rows and columns take.
    pixel = np.ravel_multi_index((rows, columns), reference.inverse_depth.shape)
    here = reference.inverse_depth.take(pixel).astype(np.float64)
    xx, xy, yy, xq, yq = (plane.take(pixel).astype(np.float64) for plane in ring_sums(reference, noise))
    determinant = xx * yy - xy * xy
    solvable = determinant > _LEAST_DETERMINANT
    determinant = np.where(solvable, determinant, 1)
    a = np.where(solvable, (yy * xq - xy * yq) / determinant, 0)
    b = np.where(solvable, (xx * yq - xy * xq) / determinant, 0)
    c = here - a * columns - b * rows
    # n points along +z (away) with h > 0, so the normal towards the camera is its opposite.
    normals = -np.stack([a, b, c], axis=1) @ reference.intrinsic
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(normals / np.maximum(lengths, _LEAST_LENGTH), dtype=np.float32)
