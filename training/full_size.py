"""Depth maps at the size of the photographs, to be held against a truth at any size."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fsinfer.depth.cost_volume import upsample_twice

Float32 = NDArray[np.float32]

#: Neighbouring places of a depth map whose inverse depths differ by more lie on two surfaces. Source: numerics; a
#: surface seen at 85 degrees changes by 0.02 a pixel at a focal length of 600.
SILHOUETTE = np.float32(0.02)


def on_truth_grid(values: Float32, truth_shape: tuple[int, int]) -> Float32:
    """Nearest estimate at each pixel of a truth map that is the image reduced by some factor (1, 2, 4, …).

    ``values`` (H, W) are at the image's own size.
    """
    indices = []
    for size, full in zip(truth_shape, values.shape, strict=True):
        pixel = (np.arange(size) + 0.5) * full / size - 0.5
        indices.append(np.clip(np.rint(pixel), 0, full - 1).astype(np.intp))
    return values[np.ix_(*indices)]


def at_full_size(depth: Float32, stride: int, image_shape: tuple[int, int]) -> Float32:
    """Depth at the image's own size: inverse depths between those of one surface, steps between two surfaces.

    Without it a map at half size would be blamed for half a pixel of every slope at three of four pixels.
    """
    inverse = np.divide(1.0, depth, out=np.zeros_like(depth), where=depth > 0)
    full = enlarged_surfaces(inverse, stride, image_shape)
    return np.divide(1.0, full, out=np.zeros_like(full), where=full > 0)


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
