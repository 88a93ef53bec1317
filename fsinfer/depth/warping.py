"""Homography warping of feature maps, without autograd: the plain NumPy reference and the fast OpenCV path.

A reference pixel p on the plane at depth d lies in the source view at ``K_s (R K_r^-1 p d + t)``; divided by d this
is affine in 1/d, ``a(p) + b / d`` (Yao et al. 2018, MVSNet, eq. 1), so that the maps of all planes cost one
multiply-add each. Feature pixel i of a map with stride s lies at image pixel ``s * i``.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]

#: OpenCV addresses a remap target with 16-bit coordinates. Source: format.
MAX_REMAP_ROWS = 32_000
#: Coordinate given to hypotheses behind the source view: outside every image. Source: numerics.
OUTSIDE = np.float32(-1e4)
#: Nearer than this to the plane of the camera counts as behind it, scene units. Source: numerics.
_BEHIND = 1e-6


@dataclass(frozen=True, kw_only=True)
class Projection:
    """From reference feature pixels to source feature pixels: ``matrix @ (u, v, 1) + offset / d``.

    matrix: (3, 3) float64; offset: (3,) float64.
    """

    matrix: NDArray[np.float64]
    offset: NDArray[np.float64]


def relative_projection(
    reference_intrinsic: NDArray[np.float64],
    reference_cam_from_world: NDArray[np.float64],
    source_intrinsic: NDArray[np.float64],
    source_cam_from_world: NDArray[np.float64],
    stride: float,
    reference_stride: float | None = None,
) -> Projection:
    """Projection between two views at a feature stride. Intrinsics (3, 3) in image pixels, poses (4, 4).

    The reference's pixels are at ``reference_stride`` where that is another one.
    """
    source, reference = (
        np.diag([1 / step, 1 / step, 1.0]) @ intrinsic
        for step, intrinsic in ((stride, source_intrinsic), (reference_stride or stride, reference_intrinsic))
    )
    relative = source_cam_from_world @ np.linalg.inv(reference_cam_from_world)
    return Projection(matrix=source @ relative[:3, :3] @ np.linalg.inv(reference), offset=source @ relative[:3, 3])


def source_coordinates(
    projection: Projection,
    inverse_depth_dhw: Float32,
    row_start: int = 0,
    width: int | None = None,
    height: int | None = None,
) -> tuple[Float32, Float32]:
    """Source pixel (x, y) of every hypothesis, two (D, h, w) float32 arrays.

    Parameters
    ----------
    inverse_depth_dhw: (D, 1, 1) or (D, h, w), 1/depth.
    row_start: first reference row of the block; height, width: its size, where the hypotheses do not tell.
    """
    planes = inverse_depth_dhw.shape[0]
    height = inverse_depth_dhw.shape[1] if height is None else height
    width = inverse_depth_dhw.shape[2] if width is None else width
    u = np.arange(width, dtype=np.float64)
    v = np.arange(row_start, row_start + height, dtype=np.float64)[:, None]
    m, t = projection.matrix, projection.offset
    # Computed in float64 once for a plane, in float32 for the volume: coordinates stay exact to 1e-3 px.
    far = [(m[i, 0] * u + m[i, 1] * v + m[i, 2]).astype(np.float32) for i in range(3)]
    x = np.empty((planes, height, width), np.float32)
    y = np.empty_like(x)
    z = np.empty_like(x)
    for i, out in ((2, z), (0, x), (1, y)):
        np.multiply(inverse_depth_dhw, np.float32(t[i]), out=out)
        out += far[i]
    # Also where a hypothesis is no number.
    behind = z < _BEHIND if not z.min() >= _BEHIND else None
    if behind is not None:
        z[behind] = 1.0
    np.divide(np.float32(1), z, out=z)
    x *= z
    y *= z
    if behind is not None:
        x[behind] = OUTSIDE
        y[behind] = OUTSIDE
    return x, y


def pixel_coordinates(
    projection: Projection,
    inverse_depth_d: Float32,
    u: NDArray[np.float64],
    v: NDArray[np.float64],
    *,
    behind: np.float32 = OUTSIDE,
) -> tuple[Float32, Float32]:
    """As :func:`source_coordinates` for N reference pixels: (N, D) float32, the planes of a pixel side by side.

    ``u``, ``v`` (N,) are columns and rows, ``inverse_depth_d`` is (D,); ``behind`` the coordinate of hypotheses behind
    the source view.
    """
    m, t = projection.matrix, projection.offset
    far = [(m[i, 0] * u + m[i, 1] * v + m[i, 2]).astype(np.float32)[:, None] for i in range(3)]
    shift = [np.float32(t[i]) * inverse_depth_d for i in range(3)]
    z = far[2] + shift[2]
    hidden = z < _BEHIND
    some_hidden = bool(hidden.any())
    if some_hidden:
        z[hidden] = 1.0
    np.divide(np.float32(1), z, out=z)
    found = []
    for i in (0, 1):
        place = far[i] + shift[i]
        place *= z
        if some_hidden:
            place[hidden] = behind
        found.append(place)
    return found[0], found[1]


def sample_reference(features_hwc: Float32, x_dhw: Float32, y_dhw: Float32) -> Float32:
    """Bilinear sampling in plain NumPy, zeros outside: (D, h, w, C). The reference of :func:`sample`."""
    height, width, _ = features_hwc.shape
    x0, y0 = np.floor(x_dhw), np.floor(y_dhw)
    result = np.zeros((*x_dhw.shape, features_hwc.shape[2]), np.float32)
    for dx in (0, 1):
        for dy in (0, 1):
            column, row = x0 + dx, y0 + dy
            weight = (1 - np.abs(x_dhw - column)) * (1 - np.abs(y_dhw - row))
            inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
            values = features_hwc[
                np.clip(row, 0, height - 1).astype(np.intp), np.clip(column, 0, width - 1).astype(np.intp)
            ]
            result += np.where(inside, weight, 0)[..., None].astype(np.float32) * values
    return result


def sample(features_hw4: Float32, x_dhw: Float32, y_dhw: Float32, *, out: Float32 | None = None) -> Float32:
    """Bilinear sampling of a four-channel map with ``cv2.remap``, zeros outside: (D, h, w, 4), contiguous ``out``.

    Float maps and at most four channels are the one combination that OpenCV 5 samples exactly; with more
    channels, with fixed-point maps or in OpenCV 4 the coordinates are silently rounded to 1/32 pixel.
    """
    planes, height, width = x_dhw.shape
    group = max(1, MAX_REMAP_ROWS // height)
    result = np.empty((planes, height, width, features_hw4.shape[2]), np.float32) if out is None else out
    for start in range(0, planes, group):
        part = slice(start, min(start + group, planes))
        rows = (part.stop - part.start) * height
        cv2.remap(
            features_hw4,
            x_dhw[part].reshape(rows, width),
            y_dhw[part].reshape(rows, width),
            cv2.INTER_LINEAR,
            dst=result[part].reshape(rows, width, features_hw4.shape[2]),
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=(0, 0, 0, 0),
        )
    return result
