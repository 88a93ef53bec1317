"""Group correlation over planes that are the same for all pixels: pixel by pixel, the planes side by side in memory.

The definition is that of :func:`fsinfer.depth.cost_volume.correlation_volume_reference`. In the other volumes the
planes of a block lie behind each other, and what was sampled is multiplied by the reference's features and then summed
over the four channels of a group. Here the samples of one pixel on all planes are a matrix (D, 4), whose
product with the pixel's own four features is both in one, and planes that leave the source's picture are left out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from fsinfer.depth.blocks import over_blocks
from fsinfer.depth.cost_volume import LEAST_WEIGHT, Features
from fsinfer.depth.warping import Projection, pixel_coordinates
from fsinfer.threads import blas_architecture

Float32 = NDArray[np.float32]

#: Rows and columns of a tile, whose samples of one group and 192 planes take two megabytes. Source: numerics
#: (docs/trials-speed.md); the more square a tile, the more planes leave the source's picture for all of it.
TILE_ROWS, TILE_COLUMNS = 16, 80
#: Kernels of OpenBLAS that multiply a matrix of four columns by a vector in a third of the time of the others, which
#: are the faster the more columns there are. Source: numerics; 75 instead of 218 us for 640 pixels of 192 planes, and
#: 169 us for four planes at a time with either.
_FAST_VECTORS = frozenset({"SkylakeX", "Cooperlake", "Sapphirerapids"})
#: Planes multiplied at a time by the other kernels. Source: numerics; four is where their product pays, as above.
_PLANES_TOGETHER = 4


@dataclass(frozen=True, kw_only=True)
class Tile:
    """Rows and columns of the reference that are computed together."""

    rows: slice
    columns: slice


def plane_correlation_volume(
    reference: Features,
    sources: Sequence[Features],
    projections: Sequence[Projection],
    inverse_depth_d: Float32,
    *,
    threads: int = 1,
) -> tuple[Float32, Float32]:
    """Group correlation (Guo et al. 2019) of four channels each, averaged over the sources.

    The weight of a source at a pixel is the peak of the softmax over depth of its summed correlation.

    Parameters
    ----------
    inverse_depth_d: (D,) 1/depth of the planes, scene units.

    Returns
    -------
    volume: (D, G, h, w) float32. weights: (S, h, w) float32, in (0, 1].
    """
    height, width = reference.shape
    planes, groups = len(inverse_depth_d), len(reference.groups)
    together = math.gcd(planes, _planes_together())
    volume = np.empty((planes, groups, height, width), np.float32)
    weights = np.empty((len(sources), height, width), np.float32)
    tiles = [
        Tile(rows=slice(top, min(top + TILE_ROWS, height)), columns=slice(left, min(left + TILE_COLUMNS, width)))
        for top in range(0, height, TILE_ROWS)
        for left in range(0, width, TILE_COLUMNS)
    ]
    inside = [
        planes_inside(projection, inverse_depth_d, tiles, source.shape, together)
        for source, projection in zip(sources, projections, strict=True)
    ]

    def fill(number: int) -> None:
        rows, columns = tiles[number].rows, tiles[number].columns
        shape = (rows.stop - rows.start, columns.stop - columns.start)
        pixels = shape[0] * shape[1]
        v = np.arange(rows.start, rows.stop, dtype=np.float64).repeat(shape[1])
        u = np.tile(np.arange(columns.start, columns.stop, dtype=np.float64), shape[0])
        own = [_diagonal(feature[rows, columns].reshape(pixels, 4), together) for feature in reference.groups]
        total = np.zeros((groups, pixels, planes), np.float32)
        one = np.empty_like(total)
        samples = np.empty(pixels * planes * 4, np.float32)
        weight_sum = np.full(pixels, LEAST_WEIGHT, np.float32)
        for i, (source, projection) in enumerate(zip(sources, projections, strict=True)):
            first, last = inside[i][number]
            one[:, :, :first] = 0
            one[:, :, last:] = 0
            if first < last:
                x, y = pixel_coordinates(projection, inverse_depth_d[first:last], u, v)
                sampled = samples[: x.size * 4].reshape(pixels, last - first, 4)
                by_product = sampled.reshape(pixels, -1, 4 * together)
                for g, target in enumerate(source.groups):
                    cv2.remap(
                        target,
                        x,
                        y,
                        cv2.INTER_LINEAR,
                        dst=sampled,
                        borderMode=cv2.BORDER_CONSTANT,
                        borderValue=(0, 0, 0, 0),
                    )
                    out = one[g].reshape(pixels, -1, together)[:, first // together : last // together]
                    np.matmul(by_product, own[g], out=out)
            score = one.sum(axis=0)
            score -= score.max(axis=1, keepdims=True)
            weight = 1 / cv2.reduce(cv2.exp(score, dst=score), 1, cv2.REDUCE_SUM).ravel()
            weights[i, rows, columns] = weight.reshape(shape)
            weight_sum += weight
            # Of each plane: OpenCV multiplies and adds in one step, what NumPy does in two takes four times as long.
            of_planes = weight.repeat(planes).reshape(pixels, planes)
            for sum_of_group, of_group in zip(total, one, strict=True):
                cv2.accumulateProduct(of_group, of_planes, sum_of_group)
        for g in range(groups):
            total[g] /= weight_sum[:, None]
            # OpenCV turns a matrix in blocks that stay in the cache, a third of NumPy's time.
            volume[:, g, rows, columns] = cv2.transpose(total[g]).reshape(planes, *shape)

    over_blocks(fill, len(tiles), 1, threads)
    return volume, weights


@cache
def _planes_together() -> int:
    return 1 if blas_architecture() in _FAST_VECTORS else _PLANES_TOGETHER


def _diagonal(features_n4: Float32, together: int) -> Float32:
    """(n, 4 k, k): a quarter of each pixel's four features on the block diagonal, for the means of k planes at once."""
    result = np.zeros((len(features_n4), together, 4, together), np.float32)
    np.einsum("nkck->nkc", result)[:] = features_n4[:, None] * np.float32(0.25)
    return result.reshape(-1, 4 * together, together)


def planes_inside(
    projection: Projection,
    inverse_depth_d: Float32,
    tiles: Sequence[Tile],
    source_shape: tuple[int, int],
    together: int,
) -> list[tuple[int, int]]:
    """Of each tile the first plane on which it may lie in the source, and that behind the last; both whole steps.

    A tile on a plane is a quadrangle in the source: where all its corners lie beyond one side of the picture, all of
    it does. Where some of them are behind the source it might be anywhere. ``together``: planes of a step, which
    divides their number.
    """
    rows = np.array([[t.rows.start, t.rows.start, t.rows.stop - 1, t.rows.stop - 1] for t in tiles], np.float64)
    columns = np.array(
        [[t.columns.start, t.columns.stop - 1, t.columns.start, t.columns.stop - 1] for t in tiles], np.float64
    )
    found = pixel_coordinates(projection, inverse_depth_d, columns.ravel(), rows.ravel(), behind=np.float32(np.nan))
    x, y = (part.reshape(len(tiles), 4, -1) for part in found)
    height, width = source_shape
    behind = np.isnan(x)
    # What is nearer than a pixel to the border still has a share of it.
    beyond = [(side | behind).all(axis=1) for side in (x <= -1, x >= width, y <= -1, y >= height)]
    outside = np.logical_or.reduce(beyond) & (behind.all(axis=1) | ~behind.any(axis=1))
    ranges = []
    for of_tile in ~outside:
        seen = np.flatnonzero(of_tile)
        whole = (seen[0] // together * together, (seen[-1] // together + 1) * together) if len(seen) else (0, 0)
        ranges.append((int(whole[0]), int(whole[1])))
    return ranges
