"""The 192-plane cost volume in NumPy: variance over views, or group correlation weighted by view.

Built in blocks of rows, so that the planes of a block stay in the cache, and source by source, so that memory grows
with the volume and not with the number of views. Blocks are independent: threads share them out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from fsinfer.depth.blocks import over_blocks
from fsinfer.depth.warping import Projection, sample, sample_reference, source_coordinates

Float32 = NDArray[np.float32]

#: A block's samples of one group of four channels. Source: numerics; in larger ones they leave the cache, in smaller
#: ones threads wait for each other, see docs/trials-speed.md.
BLOCK_BYTES = 3_000_000
#: Sums over four channels are taken for so many pixels by one small matrix product: 1.4 times faster than one by one.
#: Source: numerics.
_PIXELS_PER_PRODUCT = 8
#: Weight that all sources together have at least. Source: numerics.
LEAST_WEIGHT = 1e-6


@dataclass(frozen=True, kw_only=True)
class Features:
    """Feature map of one view cut into groups of four channels: each (H, W, 4) float32, contiguous."""

    groups: tuple[Float32, ...]

    @classmethod
    def from_chw(cls, features_chw: Float32) -> Features:
        """Cut (C, H, W), C a multiple of 4."""
        maps = np.ascontiguousarray(features_chw)
        return cls(groups=tuple(cv2.merge(list(maps[i : i + 4])) for i in range(0, len(maps), 4)))

    def to_chw(self) -> Float32:
        """The (C, H, W) array that it was cut from."""
        result = np.empty((4 * len(self.groups), *self.shape), np.float32)
        for i, group in enumerate(self.groups):
            cv2.split(group, list(result[4 * i : 4 * i + 4]))
        return result

    def every(self, step: int) -> Features:
        """Those of every ``step``-th row and column."""
        if step == 1:
            return self
        return Features(groups=tuple(np.ascontiguousarray(group[::step, ::step]) for group in self.groups))

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        height, width = self.groups[0].shape[:2]
        return height, width


def plane_inverse_depths(depth_min: float, depth_max: float, planes: int, *, inverse: bool) -> Float32:
    """(D,) 1/depth of the planes: uniform in 1/depth from far to near, or uniform in depth from near to far."""
    if inverse:
        return np.linspace(1 / depth_max, 1 / depth_min, planes).astype(np.float32)
    return (1 / np.linspace(depth_min, depth_max, planes)).astype(np.float32)


def weighted_correlation_volume(
    reference: Features,
    sources: Sequence[Features],
    projections: Sequence[Projection],
    planes: int,
    inverse_depth_of: Callable[[slice], Float32],
    weights: Float32,
    *,
    threads: int = 1,
) -> Float32:
    """Group correlation (Guo et al. 2019), averaged over the sources with ``weights`` (S, h, w) that are known.

    ``inverse_depth_of`` gives the hypotheses (``planes``, n, w) of the n rows of a block, each pixel's own. The result
    is (D, G, h, w) float32.
    """
    height, width = reference.shape
    groups = len(reference.groups)
    volume = np.empty((planes, groups, height, width), np.float32)
    block_rows = _block_rows(planes, width)

    def fill(start: int) -> None:
        rows = slice(start, min(start + block_rows, height))
        inverse = inverse_depth_of(rows)
        shares = weights[:, rows] / (weights[:, rows].sum(axis=0) + np.float32(LEAST_WEIGHT))
        # Each for itself: memory of such a size is used again, that of all together would be new for each block.
        *totals, one = (np.empty((*inverse.shape, 4), np.float32) for _ in range(groups + 1))
        for i, (source, projection) in enumerate(zip(sources, projections, strict=True)):
            x, y = source_coordinates(projection, inverse, rows.start)
            share = shares[i, ..., None]
            for target, feature, total in zip(source.groups, reference.groups, totals, strict=True):
                # A source's share goes with the reference's features, of which there are fewer than of anything else.
                own = feature[rows] * share
                if i == 0:
                    sample(target, x, y, out=total)
                    total *= own
                    continue
                sample(target, x, y, out=one)
                # OpenCV multiplies and adds in one step.
                for of_plane, sum_of_plane in zip(one, total, strict=True):
                    cv2.accumulateProduct(of_plane, own, sum_of_plane)
        mean = np.empty_like(inverse)
        for g, total in enumerate(totals):  # of all sources at once
            mean_of_four(total, out=mean)
            volume[:, g, rows] = mean

    over_blocks(fill, height, block_rows, threads)
    return volume


def mean_of_four(values_dhw4: Float32, *, out: Float32) -> None:
    """Mean over the last axis of (D, h, w, 4) into ``out`` (D, h, w), both contiguous."""
    together = math.gcd(out.size, _PIXELS_PER_PRODUCT)
    np.matmul(values_dhw4.reshape(-1, 4 * together), _quarters(together), out=out.reshape(-1, together))


@cache
def _quarters(together: int) -> Float32:
    """(4 n, n): means of four for n pixels at once."""
    return np.asarray(np.kron(np.eye(together), np.full((4, 1), 0.25)), np.float32)


def variance_volume(
    reference: Features,
    sources: Sequence[Features],
    projections: Sequence[Projection],
    inverse_depth_dhw: Float32,
    *,
    threads: int = 1,
) -> Float32:
    """Variance of the features over the N views (MVSNet, eq. 2): (C, D, h, w) float32."""
    height, width = reference.shape
    planes, channels = inverse_depth_dhw.shape[0], 4 * len(reference.groups)
    volume = np.empty((channels, planes, height, width), np.float32)
    views = np.float32(len(sources) + 1)
    block_rows = _block_rows(planes, width)

    def fill(start: int) -> None:
        rows = slice(start, min(start + block_rows, height))
        count = rows.stop - rows.start
        coordinates = [source_coordinates(p, inverse_depth_dhw, rows.start, width, count) for p in projections]
        for g, feature in enumerate(reference.groups):
            total = np.broadcast_to(feature[rows], (planes, count, width, 4)).copy()
            squares = total * total
            for source, (x, y) in zip(sources, coordinates, strict=True):
                warped = sample(source.groups[g], x, y)
                total += warped
                squares += warped * warped
            total /= views
            variance = squares / views - total * total
            volume[4 * g : 4 * g + 4, :, rows] = variance.transpose(3, 0, 1, 2)

    over_blocks(fill, height, block_rows, threads)
    return volume


def correlation_volume_reference(
    reference_hwc: Float32,
    sources_hwc: Sequence[Float32],
    projections: Sequence[Projection],
    inverse_depth_dhw: Float32,
) -> tuple[Float32, Float32]:
    """Group correlation straight from its definition: the volume (D, G, h, w), and the sources' weights (S, h, w).

    One group is four channels. The weight of a source at a pixel is the peak of the softmax over depth of its summed
    correlation. The reference of :func:`weighted_correlation_volume` and of :mod:`fsinfer.depth.plane_volume`.
    """
    height, width, channels = reference_hwc.shape
    summed = np.zeros((inverse_depth_dhw.shape[0], channels // 4, height, width), np.float32)
    weight_sum = np.full((height, width), LEAST_WEIGHT, np.float32)
    weights = np.empty((len(sources_hwc), height, width), np.float32)
    for i, (source, projection) in enumerate(zip(sources_hwc, projections, strict=True)):
        x, y = source_coordinates(projection, inverse_depth_dhw, 0, width, height)
        product = sample_reference(source, x, y) * reference_hwc
        corr = product.reshape(*x.shape, channels // 4, 4).mean(axis=-1).transpose(0, 3, 1, 2)
        score = np.exp(corr.sum(axis=1) - corr.sum(axis=1).max(axis=0))
        weight = weights[i] = (score / score.sum(axis=0)).max(axis=0)
        summed += corr * weight
        weight_sum += weight
    return np.asarray(summed / weight_sum, np.float32), weights


def upsample_twice(values_hw: Float32, height: int, width: int) -> Float32:
    """Bilinear upsampling (..., h, w) → (..., height, width) with pixel i of the input at pixel 2i of the output.

    The last row and column repeat; ``height`` is 2h or 2h - 1, ``width`` likewise.
    """
    h, w = values_hw.shape[-2:]
    rows = np.empty((*values_hw.shape[:-2], 2 * h, w), np.float32)
    rows[..., ::2, :] = values_hw
    rows[..., 1:-1:2, :] = (values_hw[..., :-1, :] + values_hw[..., 1:, :]) * np.float32(0.5)
    rows[..., -1, :] = values_hw[..., -1, :]
    result = np.empty((*values_hw.shape[:-2], 2 * h, 2 * w), np.float32)
    result[..., ::2] = rows
    result[..., 1:-1:2] = (rows[..., :-1] + rows[..., 1:]) * np.float32(0.5)
    result[..., -1] = rows[..., -1]
    return result[..., :height, :width]


def upsample_index(index_hw: Float32, height: int, width: int) -> Float32:
    """Plane index at twice the resolution: bilinear, but the nearest value where the two differ by over one plane.

    Between two surfaces the bilinear value lies on neither of them.
    """
    bilinear = upsample_twice(index_hw, height, width)
    nearest = index_hw.repeat(2, axis=0).repeat(2, axis=1)[:height, :width]
    return np.where(np.abs(bilinear - nearest) > 1, nearest, bilinear)


def _block_rows(planes: int, width: int) -> int:
    """Rows of a block whose samples fill ``BLOCK_BYTES``, at least 2."""
    return max(2, BLOCK_BYTES // (planes * width * 16))
