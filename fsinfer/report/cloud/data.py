"""The point cloud for the viewer in the page: thinned at random, quantized, and written as base64."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsinfer.io.chunks import ChunkedCloud, open_chunks
from fsinfer.io.cloud import PointCloud, cloud_of_columns, read_cloud
from fsinfer.io.las import flagged, iterate_las

#: A cloud of more points than this is read in pieces, every n-th point of it. Source: numerics.
MAX_IN_MEMORY = 4_000_000
#: Points that are shown at most, 11 bytes each. Source: layout; what an ordinary phone draws at ten pictures a second.
MAX_POINTS = 600_000
#: Steps of a coordinate. Source: format; 16 bits.
STEPS = 65535
_COLUMNS = ("red", "green", "blue", "confidence", "TreeID")


@dataclass(frozen=True, kw_only=True)
class ViewerData:
    """What the viewer gets.

    Attributes
    ----------
    base64: little-endian arrays one after the other: uint16 positions (N, 3), then those of the optional parts that
        ``parts`` names: "tree" uint16 (N,), "rgb" uint8 (N, 3), "confidence" uint8 (N,).
    points: N. They are in random order, so that the first n are a thinned cloud.
    low, step: position = low + step * stored value; ``step`` is the same on all axes.
    """

    base64: str
    points: int
    low: tuple[float, float, float]
    step: float
    parts: tuple[str, ...]


def encode_cloud(cloud: PointCloud, *, max_points: int = MAX_POINTS, seed: int = 0) -> ViewerData:
    """Cut off far outliers, choose at most ``max_points`` evenly at random, and quantize.

    Of a plot of 30 m the step is half a millimetre, of a hectare 2 mm: finer than the noise.
    """
    low, high = np.percentile(cloud.xyz, [0.3, 99.7], axis=0)
    margin = 0.05 * float((high - low).max())
    near = np.flatnonzero(((cloud.xyz >= low - margin) & (cloud.xyz <= high + margin)).all(axis=1))
    order = np.random.default_rng(seed).permutation(near)[:max_points]
    xyz = cloud.xyz[order]
    low = xyz.min(axis=0)
    step = max(float((xyz.max(axis=0) - low).max()), 1e-9) / STEPS
    arrays: list[tuple[str, NDArray[Any]]] = [("", np.rint((xyz - low) / step).astype("<u2"))]
    tree_id = cloud.extra.get("TreeID")
    if tree_id is not None and tree_id.any():
        arrays.append(("tree", np.clip(tree_id[order], 0, STEPS).astype("<u2")))
    if cloud.rgb is not None:
        arrays.append(("rgb", cloud.rgb[order]))
    confidence = cloud.extra.get("confidence")
    if confidence is not None:
        arrays.append(("confidence", np.rint(255 * np.clip(confidence[order], 0, 1)).astype(np.uint8)))
    data = b"".join(np.ascontiguousarray(values).tobytes() for _, values in arrays)
    return ViewerData(
        base64=base64.b64encode(data).decode("ascii"),
        points=len(order),
        low=(float(low[0]), float(low[1]), float(low[2])),
        step=step,
        parts=tuple(name for name, _ in arrays if name),
    )


def read_some(path: Path) -> tuple[PointCloud, int]:
    """Read a cloud, every n-th point of a very large one; returns it with the number of points in the file.

    Raises :class:`fsinfer.errors.CloudError` where the file cannot be read.
    """
    chunked = open_chunks(path)
    if chunked is None or chunked.points <= MAX_IN_MEMORY:
        cloud = read_cloud(path)
        return cloud, len(cloud)
    every = -(-chunked.points // (2 * MAX_POINTS))
    pieces = list(_every(chunked, every))
    names = [name for name in pieces[0] if all(name in piece for piece in pieces)]
    return cloud_of_columns(path, {n: np.concatenate([p[n] for p in pieces]) for n in names}), chunked.points


def _every(chunked: ChunkedCloud, every: int) -> Any:
    size = chunked.settings.chunk_points
    if chunked.table is not None:
        for columns in chunked.columns():
            yield {name: values[::every] for name, values in columns.items() if name in (*"xyz", *_COLUMNS)}
        return
    for record in iterate_las(chunked.path, size):
        names, used = {*record.point_format.dimension_names}, ~flagged(record)
        columns = {axis: np.asarray(record[axis], dtype=np.float64)[used][::every] for axis in "xyz"}
        columns |= {name: np.asarray(record[name])[used][::every] for name in _COLUMNS if name in names}
        yield columns
