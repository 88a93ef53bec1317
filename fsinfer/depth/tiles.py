"""Depth in tiles: what does not fit into memory as a whole, computed part by part to the same result.

Each tile is a cut of the reference view with a halo, as wide as the network sees; cut so, its principal point moves and
nothing else changes. Only the squeeze-and-excitation of the regularizer looks at the whole volume. Where it is that of
the packed regularizer, the means of its three levels are found first, one after the other, because each depends on the
one before; where it is that of the volume itself, as in the paper, its mean is summed up first. The volume of the
packed regularizer is an eighth of what that takes at its peak: where it fits it is kept whole, else that of every tile
is made anew each time.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fsinfer.depth.cost_volume import Features
from fsinfer.depth.model import DepthEstimate, DepthModel
from fsinfer.depth.precision import INT8
from fsinfer.depth.session import load_graph, run_for
from fsinfer.depth.view_group import ViewFeatures, ViewGroup
from fsinfer.errors import ModelError
from fsinfer.threads import one_blas_thread

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Span:
    """Rows or columns of the volume: ``inner`` is the tile's own part of what is computed."""

    outer_start: int
    outer_stop: int
    inner_start: int
    inner_stop: int

    @property
    def outer(self) -> slice:
        """All that is computed of the tile, in the whole."""
        return slice(self.outer_start, self.outer_stop)

    def own(self, stride: int) -> slice:
        """The tile's own part in what is computed of it, at so many pixels of the volume a pixel."""
        start = (self.inner_start - self.outer_start) // stride
        return slice(start, start + -(-self.inner_stop // stride) - self.inner_start // stride)

    def of_whole(self, finer: int, length: int) -> slice:
        """The tile's own part in a map of so many pixels to one of the volume and ``length`` in all."""
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


class TiledDepth:
    """A depth model whose maps are computed in tiles; it gives what the model gives, for less memory.

    Parameters
    ----------
    model: in float32, with a graph for tiles.
    size: of a tile's own part, pixels of the volume.
    keeps_volume: the cost volume is there as a whole; without it tiles take less memory and much more time.

    Raises
    ------
    ModelError
        The model has no graph for tiles, or it cannot be loaded.
    """

    def __init__(self, model: DepthModel, size: int, *, keeps_volume: bool = True) -> None:
        graph = model.manifest.tiles
        if graph is None or model.precision == INT8:
            msg = f"model {model.manifest.name} has no tiles in {model.precision}; give a larger --memory-gb"
            raise ModelError(msg)
        self._model, self._size, self._keeps_volume, self._graph = model, size, keeps_volume, graph
        self._session = load_graph(model.manifest.folder / graph.regularizer, model.threads, model.providers)
        shapes = {item.name: item.shape for item in self._session.get_inputs()}
        self._channels = [int(shapes[f"mean{level}"][0]) for level in range(len(graph.level_halos))]
        self._volume_channels = int(shapes["volume_mean"][0]) if graph.volume_mean else 0

    @one_blas_thread()
    def predict_from_features(
        self,
        features: Sequence[ViewFeatures],
        intrinsics: Float64,
        cam_from_world: Float64,
        depth_range: tuple[float, float],
    ) -> DepthEstimate:
        """Depth of the first view; see :meth:`DepthModel.predict_from_features`."""
        model, group = self._model, ViewGroup.of(features, intrinsics, cam_from_world, depth_range)
        wide = model.manifest.wide_stride
        # Of the volume, whose pixels the tiles are counted in; it holds every second of the features where it is at 8.
        height, width = (-(-length // (wide // 4)) for length in features[0].quarter.shape)
        whole = model.cost_volume(group) if self._keeps_volume else None

        def tiles(halo: int) -> Iterator[tuple[Span, Span, Float32, Float32 | None]]:
            """Rows, columns, volume and weights of each tile."""
            for rows in cut(height, size=self._size, halo=halo, align=self._graph.align):
                for columns in cut(width, size=self._size, halo=halo, align=self._graph.align):
                    if whole is None:
                        yield rows, columns, *model.cost_volume(cropped(group, rows, columns, wide))
                    else:
                        own = (..., rows.outer, columns.outer)
                        weights = None if whole[1] is None else whole[1][own]
                        yield rows, columns, np.ascontiguousarray(whole[0][own]), weights

        means = {f"mean{level}": np.zeros(channels, np.float32) for level, channels in enumerate(self._channels)}
        for level, halo in enumerate(self._graph.level_halos):
            step = 2 ** (level + 1)
            total = np.zeros(self._channels[level])
            for rows, columns, volume, _ in tiles(halo):
                (found,) = self._regularize(volume, means, f"level{level}")
                total += found[:, rows.own(step), columns.own(step)].sum(axis=(1, 2), dtype=np.float64)
            means[f"mean{level}"] = (total / (-(-height // step) * -(-width // step))).astype(np.float32)
        if self._volume_channels:
            total = np.zeros(self._volume_channels)
            for _, _, volume, _ in tiles(0):
                total += volume[0].sum(axis=3, dtype=np.float64).sum(axis=(1, 2))
            means["volume_mean"] = (total / (model.manifest.planes * height * width)).astype(np.float32)
        half = features[0].half
        shape, stride = (features[0].quarter.shape, 4) if half is None else (half.shape, 2)
        depth, confidence = np.empty(shape, np.float32), np.empty(shape, np.float32)
        surface = None if model.manifest.surface is None else np.empty(shape, np.float32)
        for rows, columns, volume, weights in tiles(self._graph.halo):
            index, certainty = self._regularize(volume, means, "index", "confidence")
            estimate = model.finish(cropped(group, rows, columns, wide), index, certainty, weights)
            finer = wide // stride
            there = rows.of_whole(finer, shape[0]), columns.of_whole(finer, shape[1])
            own = rows.of_tile(finer, shape[0]), columns.of_tile(finer, shape[1])
            depth[there], confidence[there] = estimate.depth[own], estimate.confidence[own]
            if surface is not None and estimate.surface is not None:
                surface[there] = estimate.surface[own]
        return DepthEstimate(depth=depth, confidence=confidence, stride=stride, surface=surface)

    def _regularize(self, volume: Float32, means: Mapping[str, Float32], *wanted: str) -> list[Float32]:
        """Outputs of the graph for a part of the volume, and the means over the whole as far as they are known."""
        return run_for(self._session, wanted, {"volume": volume, **means})


def cropped(group: ViewGroup, rows: Span, columns: Span, wide_stride: int) -> ViewGroup:
    """The views with the reference cut to a tile, and its principal point moved.

    ``wide_stride``: pixels of the image to one of the volume, in which the tile is counted.
    """
    reference = group.features[0]
    half = reference.half
    cut_reference = ViewFeatures(
        quarter=_part(reference.quarter, rows, columns, wide_stride // 4),
        half=None if half is None else _part(half, rows, columns, wide_stride // 2),
    )
    moved = group.intrinsics.copy()
    # Pixel i of the volume lies at image pixel wide_stride i.
    moved[0, :2, 2] -= float(wide_stride) * np.array([columns.outer_start, rows.outer_start])
    return replace(group, features=[cut_reference, *group.features[1:]], intrinsics=moved)


def _part(features: Features, rows: Span, columns: Span, finer: int) -> Features:
    part = (
        slice(finer * rows.outer_start, finer * rows.outer_stop),
        slice(finer * columns.outer_start, finer * columns.outer_stop),
    )
    return Features(groups=tuple(np.ascontiguousarray(group[part]) for group in features.groups))
