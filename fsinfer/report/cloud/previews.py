"""Small pictures of what the stages made: colour-mapped depth maps and views of the cloud."""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from fsinfer.io.cloud import PointCloud

Direction = Literal["top", "side"]

#: Grey for "no depth". Source: layout; the colour map has no grey, so it cannot be taken for a distance.
NO_DEPTH_RGB = (60, 60, 60)
#: Source: layout.
BACKGROUND_RGB = (250, 250, 248)
#: Points of a view at most. Source: layout; 1000 pixels show no more.
MAX_VIEW_POINTS = 800_000
#: Image axes of each view: right, up, towards the viewer (signed axis numbers of x, y, z). Source: layout.
_AXES: dict[str, tuple[tuple[int, int], tuple[int, int], tuple[int, int]]] = {
    "top": ((0, 1), (1, 1), (2, 1)),
    "side": ((0, 1), (2, 1), (1, -1)),
}


def depth_preview(
    depth: NDArray[np.float32], *, near: float | None = None, far: float | None = None
) -> NDArray[np.uint8]:
    """Colour a depth map: red is near, blue is far, grey has no depth.

    Parameters
    ----------
    depth: (h, w), scene units; 0 or NaN = none.
    near, far: ends of the colour scale; by default the 2nd and 98th percentile. The scale is even in 1 / depth,
        because that is how precisely depth is known.

    Returns
    -------
    (h, w, 3) uint8 RGB.
    """
    valid = np.isfinite(depth) & (depth > 0)
    inverse = np.divide(1.0, depth, out=np.zeros(depth.shape), where=valid)
    if not valid.any():
        return np.full((*depth.shape, 3), NO_DEPTH_RGB, dtype=np.uint8)
    low = np.percentile(inverse[valid], 2) if far is None else 1 / far
    high = np.percentile(inverse[valid], 98) if near is None else 1 / near
    scaled = np.clip((inverse - low) / max(float(high - low), 1e-12), 0, 1)
    coloured = cv2.applyColorMap(np.rint(255 * scaled).astype(np.uint8), cv2.COLORMAP_TURBO)[..., ::-1]
    return np.where(valid[..., None], coloured, np.array(NO_DEPTH_RGB)).astype(np.uint8)


def cloud_view(cloud: PointCloud, direction: Direction = "top", *, size_px: int = 900) -> NDArray[np.uint8]:
    """Draw the cloud in parallel projection, nearer points in front (a z-buffer of square splats).

    Parameters
    ----------
    cloud: z up. Without colours the height is coloured.
    direction: ``top`` (x right, y up) or ``side`` (x right, z up, seen from -y).
    size_px: longer side of the picture, within a pixel.

    Returns
    -------
    (h, w, 3) uint8 RGB. The 1 % of points farthest out on each side may be cut off.
    """
    if len(cloud) > MAX_VIEW_POINTS:
        chosen = np.random.default_rng(0).choice(len(cloud), MAX_VIEW_POINTS, replace=False)
        cloud = cloud.select(chosen)
    right, up, front = (sign * cloud.xyz[:, axis] for axis, sign in _AXES[direction])
    (left, end), (bottom, top) = _range(right), _range(up)
    per_px = max(end - left, top - bottom) / size_px
    # One more than fits, for the points exactly on the far border.
    width, height = int((end - left) / per_px) + 1, int((top - bottom) / per_px) + 1
    colours = _height_colours(cloud.xyz[:, 2]) if cloud.rgb is None else cloud.rgb
    # Splats as large as leaves few holes when the points were spread evenly over the picture.
    splat = int(np.clip(round(1.2 * np.sqrt(width * height / max(len(cloud), 1))), 1, 4))
    columns, rows = np.floor((right - left) / per_px).astype(np.int64), np.floor((top - up) / per_px).astype(np.int64)
    shifts = [(dx, dy) for dx in range(splat) for dy in range(splat)]
    all_columns = np.concatenate([columns + dx for dx, _ in shifts])
    all_rows = np.concatenate([rows + dy for _, dy in shifts])
    which = np.tile(np.arange(len(cloud)), len(shifts))
    inside = (all_columns >= 0) & (all_columns < width) & (all_rows >= 0) & (all_rows < height)
    pixels, which = (all_rows * width + all_columns)[inside], which[inside]
    # Sorted by pixel, then nearness: the last of each pixel is the one in front.
    order = np.lexsort((front[which], pixels))
    pixels, which = pixels[order], which[order]
    last = np.append(pixels[1:] != pixels[:-1], True) if len(pixels) else np.empty(0, dtype=bool)
    picture = np.full((height * width, 3), BACKGROUND_RGB, dtype=np.uint8)
    picture[pixels[last]] = colours[which[last]]
    return picture.reshape(height, width, 3)


def _range(values: NDArray[np.float64]) -> tuple[float, float]:
    low, high = np.percentile(values, [0.5, 99.5])
    margin = 0.03 * (high - low) + 1e-9
    return float(max(low - margin, values.min())), float(min(high + margin, values.max()) + 1e-9)


def _height_colours(z: NDArray[np.float64]) -> NDArray[np.uint8]:
    low, high = np.percentile(z, [1, 99])
    scaled = np.clip(255 * (z - low) / max(high - low, 1e-12), 0, 255).astype(np.uint8)
    return np.asarray(cv2.applyColorMap(scaled[:, None], cv2.COLORMAP_VIRIDIS)[:, 0, ::-1], dtype=np.uint8)
