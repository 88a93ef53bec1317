"""The last tenth of a pixel: depth of the network set right by the photographs at their full size.

The network compares features at a quarter and at half of the resolution, and nobody looks at the full-size pixels
again. Here each pixel of the depth map keeps its surface as the network has it, and that is moved along the viewing
rays until the photographs round the pixel agree best: one or two Gauss-Newton steps of least squares matching (Gruen,
South African Journal of Photogrammetry, Remote Sensing and Cartography 14, 1985), with the shift along the epipolar
lines as the only unknown of a window and all sources in one system, as in multiphoto matching (Baltsavias, Multiphoto
geometrically constrained matching, ETH Zurich 1991). With the locally normalised grey values I of the reference and
I_s of a source, warped by the depth map,

    shift = sum_s w_s (dI_s / dshift) (I - I_s)  /  (sum_s w_s (dI_s / dshift)^2 + damping),

sums over a Gaussian window. Where there is no texture along the lines the damping leaves the depth as it is; sources
that do not show the same place (hidden, beyond the border) lose their weight by their correlation with the reference.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fsinfer.depth.blocks import over_blocks
from fsinfer.depth.cost_volume import upsample_twice
from fsinfer.depth.settings import SubpixelSettings
from fsinfer.depth.warping import Projection, relative_projection

Float16 = NDArray[np.float16]
Float32 = NDArray[np.float32]

#: Rows at a time: their arrays stay in a processor's cache. Source: numerics.
BLOCK_ROWS = 96
#: A Gaussian window ends at so many standard deviations. Source: numerics.
WINDOW_ENDS = 3.0
#: Neighbouring places of a depth map whose inverse depths differ by more lie on two surfaces. Source: numerics; a
#: surface seen at 85 degrees changes by 0.02 a pixel at a focal length of 600.
SILHOUETTE = np.float32(0.02)
#: Keeps divisions finite. Source: numerics.
_TINY = np.float32(1e-9)


def normalised(image: NDArray[np.uint8], settings: SubpixelSettings | None = None) -> Float16:
    """Grey values (H, W) of an (H, W, 3) RGB image less their local mean, over their local standard deviation.

    Exposure, glare and shade drop out; noise in flat places stays small (``least_contrast``). In half precision, for
    the stage keeps those of many views.
    """
    s = settings or SubpixelSettings()
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32)
    mean = cv2.GaussianBlur(grey, (0, 0), s.normalise_px)
    variance = cv2.GaussianBlur(grey * grey, (0, 0), s.normalise_px) - mean * mean
    return np.asarray((grey - mean) / np.sqrt(np.maximum(variance, 0) + np.float32(s.least_contrast**2)), np.float16)


def refine_depth(
    depth: Float32,
    confidence: Float32,
    greys: Sequence[Float16],
    intrinsics: NDArray[np.float64],
    cam_from_world: NDArray[np.float64],
    *,
    settings: SubpixelSettings | None = None,
    threads: int = 1,
) -> Float32:
    """Depth map (h, w) at a tenth of a pixel, in the units of the poses; 0 stays 0.

    Parameters
    ----------
    depth, confidence: (h, w) of the network, pixel (i, j) at image pixel (stride i, stride j), stride 1, 2 or 4.
    greys: N >= 2 maps (H, W) of :func:`normalised`; the first is the reference.
    intrinsics, cam_from_world: (N, 3, 3) pixels and (N, 4, 4).
    """
    s = settings or SubpixelSettings()
    images = [grey.astype(np.float32) for grey in greys]
    height, width = images[0].shape
    stride = round(width / depth.shape[1])
    projections = [
        relative_projection(intrinsics[0], cam_from_world[0], intrinsics[i], cam_from_world[i], 1.0)
        for i in range(1, len(images))
    ]
    known = depth > 0
    inverse = np.divide(1.0, depth, out=np.zeros_like(depth), where=known)
    inverse = enlarged_surfaces(inverse, stride, (height, width))
    weight = enlarged(np.where(known, confidence, 0).astype(np.float32), stride, (height, width))
    for _ in range(s.rounds):
        moved = inverse.copy()

        def fill(row: int, moved: Float32 = moved, inverse: Float32 = inverse) -> None:
            rows = slice(row, min(row + BLOCK_ROWS, height))
            moved[rows] = _step(inverse, weight, images, projections, rows, s)

        over_blocks(fill, height, BLOCK_ROWS, threads)
        inverse = np.asarray(cv2.medianBlur(moved, s.median_px), np.float32) if s.median_px else moved
    at_depth = inverse[::stride, ::stride]
    refined = np.divide(1.0, at_depth, out=np.zeros_like(depth), where=known & (at_depth > 0))
    return np.asarray(refined, np.float32)


def _step(
    inverse: Float32,
    weight: Float32,
    images: Sequence[Float32],
    projections: Sequence[Projection],
    rows: slice,
    s: SubpixelSettings,
) -> Float32:
    """One Gauss-Newton step for some rows: inverse depth (n, W) of them."""
    halo = 2 * int(np.ceil(WINDOW_ENDS * s.window_px))  # a window of what a window's correlation weighs
    height, width = inverse.shape
    first, last = max(0, rows.start - halo), min(height, rows.stop + halo)
    z, confidence, reference = inverse[first:last], weight[first:last], images[0][first:last]
    x = np.arange(width, dtype=np.float32)[None]
    y = np.arange(first, last, dtype=np.float32)[:, None]
    lines = [_epipolar(projection, x, y, z) for projection in projections]
    fastest = np.maximum(np.maximum.reduce([line[2] for line in lines]), _TINY)
    normal, right = np.zeros_like(z), np.zeros_like(z)
    for (u, v, speed, along_u, along_v), image in zip(lines, images[1:], strict=True):
        ahead, behind = (
            cv2.remap(
                image,
                u + side * along_u,
                v + side * along_v,
                cv2.INTER_LINEAR,
                borderMode=cv2.BORDER_CONSTANT,
                borderValue=float("nan"),
            )
            for side in (np.float32(s.difference_px), np.float32(-s.difference_px))
        )
        slope = (ahead - behind) * (speed / fastest) * np.float32(0.5 / s.difference_px)
        away = reference - np.float32(0.5) * (ahead + behind)
        seen = np.isfinite(away)
        np.copyto(slope, 0, where=~seen)
        np.copyto(away, 0, where=~seen)
        # Of two signals of variance 1 the mean squared difference is 2 - 2 r, r their correlation.
        correlation = 1 - np.float32(0.5) * _window(away * away, s) / (_window(seen.astype(np.float32), s) + _TINY)
        agrees = np.clip((correlation - s.least_correlation) / (s.full_correlation - s.least_correlation), 0, 1) ** 2
        robust = np.float32(s.outlier) / np.maximum(np.abs(away), np.float32(s.outlier))
        part = confidence * robust * agrees * slope
        normal += part * slope
        right += part * away
    shift = _window(right, s) / (_window(normal, s) + np.float32(s.damping) * _window(confidence, s) + _TINY)
    np.clip(shift, -s.most_px, s.most_px, out=shift)
    moved = z + shift / fastest
    # Nothing is moved beyond infinity, and what has no depth keeps none.
    moved = np.where((moved > 0) & (z > 0), moved, z)
    return np.asarray(moved[rows.start - first : rows.stop - first], np.float32)


def _epipolar(projection: Projection, x: Float32, y: Float32, z: Float32) -> tuple[Any, Any, Any, Any, Any]:
    """Place (u, v) in the source, its speed in pixels per unit of inverse depth, and the direction it moves in."""
    m, e = projection.matrix.astype(np.float32), projection.offset.astype(np.float32)
    behind = (m[2, 0] * x + m[2, 1] * y + m[2, 2]) + z * e[2]
    scale = np.divide(1, behind, out=np.full_like(z, np.nan), where=behind > _TINY)
    u = ((m[0, 0] * x + m[0, 1] * y + m[0, 2]) + z * e[0]) * scale
    v = ((m[1, 0] * x + m[1, 1] * y + m[1, 2]) + z * e[1]) * scale
    along_u, along_v = (e[0] - u * e[2]) * scale, (e[1] - v * e[2]) * scale
    speed = np.sqrt(along_u * along_u + along_v * along_v)
    np.nan_to_num(speed, copy=False, nan=0.0)
    unit = np.divide(1, speed, out=np.zeros_like(speed), where=speed > 0)
    return u, v, speed, along_u * unit, along_v * unit


def _window(values: Float32, s: SubpixelSettings) -> Float32:
    size = 2 * int(np.ceil(WINDOW_ENDS * s.window_px)) + 1
    return np.asarray(cv2.GaussianBlur(values, (size, size), s.window_px, borderType=cv2.BORDER_REPLICATE), np.float32)


def enlarged_surfaces(inverse: Float32, stride: int, shape: tuple[int, int]) -> Float32:
    """Inverse depth at the image's own size; across a silhouette it steps, or places between the surfaces would fly."""
    smooth = enlarged(inverse, stride, shape)
    height, width = shape
    step = inverse.repeat(stride, axis=0).repeat(stride, axis=1)[:height, :width]
    return np.where(np.abs(smooth - step) > SILHOUETTE * step, step, smooth)


def enlarged(values: Float32, stride: int, shape: tuple[int, int]) -> Float32:
    """Map at the image's own size; pixel (i, j) stays at (stride i, stride j), between them it is interpolated."""
    while stride > 1:
        stride //= 2
        height, width = (-(-length // stride) for length in shape)
        values = upsample_twice(values, height, width)
    return values
