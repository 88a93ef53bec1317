"""Which point belongs to which stem: the ``TreeID`` of the LAZ that ``fsinfer trees`` writes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fsinfer.io.cloud import cloud_of_columns, storable
from fsinfer.io.las import NORMAL_NAMES
from fsinfer.io.las_writing import copy_las, las_writer
from fsinfer.trees.points.surface import OUTSIDE_SIGMAS

if TYPE_CHECKING:
    from fsinfer.io.chunks import ChunkedCloud
    from fsinfer.trees import PlotResult

#: Bark and moss need some room in any case, metres. Source: not recorded.
LEAST_REACH_M = 0.03
#: Metres above what was fitted that are labelled; farther up the stem bends away from its axis. Source: not recorded.
ABOVE_SUPPORT_M = 0.5


def label_points(points: NDArray[np.float64], result: PlotResult) -> NDArray[np.int32]:
    """TreeID (N,) of points (N, 3) in the cloud's frame: stem points get their tree's id, all others 0.

    Stems are labelled from the ground to half a metre above what was seen of them (2.5 m at most): crowns are not told
    apart.
    """
    labels = np.zeros(len(points), dtype=np.int32)
    best = np.full(len(points), np.inf)
    order = np.argsort(points[:, 0], kind="stable")
    x_sorted = points[order, 0]
    for tree, section in zip(result.trees, result.sections, strict=True):
        radius = float(section.circle_m[2])
        noise = section.residual_m if np.isfinite(section.residual_m) else 0.0
        reach = max(OUTSIDE_SIGMAS * noise, LEAST_REACH_M)
        lean = float(np.abs(section.slope).max()) * max(section.top_m, tree.bh_m)
        wide = radius + reach + lean
        first, last = np.searchsorted(x_sorted, [tree.x_m - wide, tree.x_m + wide])
        near = order[first:last]
        near = near[np.abs(points[near, 1] - tree.y_m) <= wide]
        height = points[near, 2] - tree.z_ground_m
        centre = np.array([tree.x_m, tree.y_m]) + section.slope * (height - tree.bh_m)[:, None]
        distance = np.abs(np.hypot(*(points[near, :2] - centre).T) - radius - section.taper * (height - tree.bh_m))
        own = (distance <= reach) & (distance < best[near]) & (height >= 0.0)
        own &= height <= section.top_m + ABOVE_SUPPORT_M
        best[near[own]] = distance[own]
        labels[near[own]] = tree.tree_id
    return labels


def write_labelled(source: ChunkedCloud, path: Path, result: PlotResult) -> None:
    """Write ``path`` (LAZ): the points of a large cloud file with their ``TreeID``, read and written piece by piece."""
    if source.table is None:
        copy_las(
            source.path,
            path,
            "TreeID",
            lambda xyz: label_points(xyz, result),
            chunk_points=source.settings.chunk_points,
            factor=source.factor,
        )
        return
    sample = source.sample()
    first = cloud_of_columns(source.path, next(source.columns()))
    kinds: dict[str, np.dtype[Any]] = {name: storable(name, values).dtype for name, values in first.extra.items()}
    if first.normals is not None:
        kinds |= dict.fromkeys(NORMAL_NAMES, np.dtype(np.float32))
    kinds["TreeID"] = np.dtype(np.int32)
    low, high = sample.min(axis=0), sample.max(axis=0)
    with las_writer(path, low, high, colour=first.rgb is not None, kinds=kinds) as append:
        for columns in source.columns():
            cloud = cloud_of_columns(source.path, columns)
            finite: NDArray[np.bool_] = np.asarray(np.isfinite(cloud.xyz).all(axis=1))
            cloud = cloud.select(finite)
            xyz = cloud.xyz * source.factor
            extra = {name: storable(name, values) for name, values in cloud.extra.items()}
            if cloud.normals is not None:
                extra |= dict(zip(NORMAL_NAMES, cloud.normals.T, strict=True))
            append(xyz, cloud.rgb, extra | {"TreeID": label_points(xyz, result)})
