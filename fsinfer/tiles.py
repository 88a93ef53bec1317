"""Depth in tiles: what does not fit into memory as a whole, computed part by part to the same result.

Each tile is a cut of the reference view with a halo, as wide as the network sees; cut so, its principal point moves and
nothing else changes. Only the squeeze-and-excitation of the regularizer looks at the whole volume: the means of its
three levels are found first, one after the other, because each depends on the one before. The volume itself is an
eighth of what the regularizer takes at its peak: where it fits it is kept whole, else that of every tile is made anew
each time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fsinfer.volume import Features

if TYPE_CHECKING:
    from fsinfer.depth_model import DepthEstimate, DepthModel, ViewFeatures

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
#: Volume (S, k*G, h, w), means (C_i,) of three levels, names of the outputs wanted → those outputs.
TileRegularizer = Callable[[Float32, Sequence[Float32], Sequence[str]], list[Float32]]


@dataclass(frozen=True, kw_only=True)
class Span:
    """Rows or columns at a quarter of the resolution: ``inner`` is the tile's own part of what is computed."""

    outer_start: int
    outer_stop: int
    inner_start: int
    inner_stop: int

    @property
    def outer(self) -> slice:
        """All that is computed of the tile, in the whole."""
        return slice(self.outer_start, self.outer_stop)

    def own(self, stride: int) -> slice:
        """The tile's own part in what is computed of it, at so many quarter pixels a pixel."""
        start = (self.inner_start - self.outer_start) // stride
        return slice(start, start + -(-self.inner_stop // stride) - self.inner_start // stride)

    def of_whole(self, finer: int, length: int) -> slice:
        """The tile's own part in a map of so many pixels a quarter pixel and ``length`` in all."""
        return slice(finer * self.inner_start, min(finer * self.inner_stop, length))

    def of_tile(self, finer: int, length: int) -> slice:
        """The same in the map of the tile."""
        there, before = self.of_whole(finer, length), finer * self.outer_start
        return slice(there.start - before, there.stop - before)


def cut(length: int, *, size: int, halo: int, align: int) -> list[Span]:
    """Cut ``length`` into spans of about ``size`` with a halo; all begin at multiples of ``align``.

    Raises
    ------
    ValueError
        ``size`` or ``halo`` is no multiple of ``align``.
    """
    if size % align or halo % align or size <= 0:
        msg = f"size {size} and halo {halo} must be multiples of {align}"
        raise ValueError(msg)
    # Spans of the same size, as far as the alignment allows: the last one is no sliver.
    count = -(-length // size)
    even = -(-length // (count * align)) * align
    return [
        Span(
            outer_start=max(start - halo, 0),
            outer_stop=min(start + even + halo, length),
            inner_start=start,
            inner_stop=min(start + even, length),
        )
        for start in range(0, length, even)
    ]


@dataclass(frozen=True, kw_only=True)
class Tiling:
    """How depth is cut into tiles; lengths in pixels at a quarter of the resolution.

    Attributes
    ----------
    size: of a tile's own part; a multiple of ``align``, which is where tiles may begin.
    halo: round it, for the result; level_halos: for the levels whose means are found first.
    keeps_volume: the cost volume is there as a whole.
    """

    size: int
    halo: int
    level_halos: tuple[int, ...]
    align: int
    keeps_volume: bool


def predict_in_tiles(
    model: DepthModel,
    regularizer: TileRegularizer,
    features: Sequence[ViewFeatures],
    intrinsics: Float64,
    cam_from_world: Float64,
    depth_range: tuple[float, float],
    *,
    tiling: Tiling,
) -> DepthEstimate:
    """Depth of the first view, as :meth:`DepthModel.predict_from_features`, in tiles.

    Parameters
    ----------
    regularizer: of a part of the volume, see :data:`TileRegularizer`.
    """
    from fsinfer.depth_model import DepthEstimate

    height, width = features[0].quarter.shape
    whole = model.cost_volume(features, intrinsics, cam_from_world, depth_range) if tiling.keeps_volume else None

    def tiles(halo: int) -> Iterator[tuple[Span, Span, Float32, Float32 | None]]:
        """Rows, columns, volume and weights of each tile."""
        for rows in cut(height, size=tiling.size, halo=halo, align=tiling.align):
            for columns in cut(width, size=tiling.size, halo=halo, align=tiling.align):
                if whole is None:
                    part = cropped(features, intrinsics, rows, columns)
                    yield rows, columns, *model.cost_volume(*part, cam_from_world, depth_range)
                else:
                    own = (..., rows.outer, columns.outer)
                    weights = None if whole[1] is None else whole[1][own]
                    yield rows, columns, np.ascontiguousarray(whole[0][own]), weights

    means = [np.zeros(channels, np.float32) for channels in model.tile_channels]
    for level, halo in enumerate(tiling.level_halos):
        stride = 2 ** (level + 1)
        total = np.zeros(len(means[level]))
        for rows, columns, volume, _ in tiles(halo):
            (found,) = regularizer(volume, means, [f"level{level}"])
            total += found[:, rows.own(stride), columns.own(stride)].sum(axis=(1, 2), dtype=np.float64)
        means[level] = (total / (-(-height // stride) * -(-width // stride))).astype(np.float32)
    depth = confidence = np.empty((0, 0), np.float32)
    stride = 4
    for rows, columns, volume, weights in tiles(tiling.halo):
        index, certainty = regularizer(volume, means, ["index", "confidence"])
        part = cropped(features, intrinsics, rows, columns)
        estimate = model.finish(*part, cam_from_world, depth_range, index, certainty, weights)
        if not depth.size:
            stride = estimate.stride
            half = features[0].half
            shape = (height, width) if stride == 4 or half is None else half.shape
            depth, confidence = np.empty(shape, np.float32), np.empty(shape, np.float32)
        finer = 4 // stride
        there = rows.of_whole(finer, shape[0]), columns.of_whole(finer, shape[1])
        own = rows.of_tile(finer, shape[0]), columns.of_tile(finer, shape[1])
        depth[there], confidence[there] = estimate.depth[own], estimate.confidence[own]
    return DepthEstimate(depth=depth, confidence=confidence, stride=stride)


def cropped(
    features: Sequence[ViewFeatures], intrinsics: Float64, rows: Span, columns: Span
) -> tuple[list[ViewFeatures], Float64]:
    """The views with the reference cut to a tile, and their (N, 3, 3) intrinsics with its principal point moved."""
    from fsinfer.depth_model import ViewFeatures

    reference = features[0]
    half = reference.half
    cut_reference = ViewFeatures(
        quarter=_part(reference.quarter, rows, columns, 1), half=None if half is None else _part(half, rows, columns, 2)
    )
    moved = np.array(intrinsics, dtype=np.float64)
    # Feature pixel i of stride 4 lies at image pixel 4 i.
    moved[0, :2, 2] -= 4.0 * np.array([columns.outer_start, rows.outer_start])
    return [cut_reference, *features[1:]], moved


def _part(features: Features, rows: Span, columns: Span, finer: int) -> Features:
    part = (
        slice(finer * rows.outer_start, finer * rows.outer_stop),
        slice(finer * columns.outer_start, finer * columns.outer_stop),
    )
    return Features(groups=tuple(np.ascontiguousarray(group[part]) for group in features.groups))
