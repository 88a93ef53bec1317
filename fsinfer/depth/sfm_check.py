"""How well depth maps agree with the sparse points of structure from motion."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fsinfer.poses.sparse import LONG_TRACK, SparseModel
from fsinfer.scene import Camera, Scene

if TYPE_CHECKING:
    from fsinfer.depth.maps import PixelGrid

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class SfmCheckSettings:
    """Which points depth maps are compared with.

    Attributes
    ----------
    min_track, max_error_px: points seen in so many photos with so small an error are as good as truth. Source:
        judgement; the median difference to them is what a run reports.
    min_points: with fewer such points in the whole scene, weaker points are taken. Source: judgement.
    """

    min_track: int = 4
    max_error_px: float = 0.5
    min_points: int = 50


#: Neighbouring pixels of one surface differ by less than this factor: a slope; more is the edge of a stem. Source:
#: judgement.
_ONE_SURFACE = 1.05


@dataclass(frozen=True, kw_only=True)
class DepthCheck:
    """Depth maps against sparse points.

    Attributes
    ----------
    median_rel: median of ``|depth - z| / z`` over all views, or None where nothing could be compared.
    per_view_rel: the same for each view that has compared points.
    compared, asked: observations with a depth, and observations altogether.
    relaxed: the strict choice of points left too few, and weaker points were taken.
    """

    median_rel: float | None
    per_view_rel: dict[str, float]
    compared: int
    asked: int
    relaxed: bool


def check_depth(
    scene: Scene, sparse: SparseModel, depth_folder: Path | str, *, settings: SfmCheckSettings | None = None
) -> DepthCheck:
    """Compare the depth maps in ``depth_folder`` (holds ``depth/``) with the sparse points of the scene.

    Raises
    ------
    SceneError
        There are no depth maps, or they cannot be read.
    """
    from fsinfer.depth.maps import DepthMaps

    settings = settings or SfmCheckSettings()
    good = (sparse.track_lengths >= settings.min_track) & (sparse.errors_px < settings.max_error_px)
    relaxed = int(good.sum()) < settings.min_points
    if relaxed:
        _log.warning(
            "only %d sparse points with track >= %d and error < %.1f px; depth is checked with weaker points",
            int(good.sum()),
            settings.min_track,
            settings.max_error_px,
        )
        good = sparse.track_lengths >= LONG_TRACK
    maps = DepthMaps(scene, Path(depth_folder), cache_maps=2)
    differences, per_view, asked = [], {}, 0
    for index in maps.available:
        view = scene.views[index]
        seen = sparse.observations.get(view.name, np.zeros(0, np.int64))
        seen = seen[good[seen]]
        depth_map = maps.get(index)
        relative = compare_depth(depth_map.inverse_depth, view.camera, depth_map.grid, sparse.points[seen])
        asked += len(seen)
        relative = relative[np.isfinite(relative)]
        if len(relative):
            differences.append(relative)
            per_view[view.name] = float(np.median(relative))
    together = np.concatenate(differences) if differences else np.zeros(0)
    return DepthCheck(
        median_rel=float(np.median(together)) if len(together) else None,
        per_view_rel=per_view,
        compared=len(together),
        asked=asked,
        relaxed=relaxed,
    )


def compare_depth(
    inverse_depth: NDArray[np.float32], camera: Camera, grid: PixelGrid, points: NDArray[np.float64]
) -> NDArray[np.float64]:
    """``|depth - z| / z`` for each point, NaN where it falls outside the map or on a pixel without depth.

    Bilinear in inverse depth (exact on planes) where the four pixels round the point lie on one surface, else the
    nearest pixel.

    Parameters
    ----------
    inverse_depth: (h, w) float32, 1 / z depth, 0 where there is none.
    camera: of the full scene image.
    grid: where the pixels of the map lie in the image.
    points: (N, 3) float64, scene units.
    """
    height, width = inverse_depth.shape
    in_camera = points @ camera.cam_from_world[:3, :3].T + camera.cam_from_world[:3, 3]
    front = in_camera[:, 2] > 0
    z = np.where(front, in_camera[:, 2], 1.0)
    pixels = (in_camera / z[:, None]) @ grid.intrinsic(camera.intrinsic).T
    x, y = pixels[:, 0], pixels[:, 1]
    inside = front & (x > -0.5) & (y > -0.5) & (x < width - 0.5) & (y < height - 0.5)
    x, y = np.where(inside, x, 0.0), np.where(inside, y, 0.0)
    x0 = np.clip(np.floor(x).astype(np.int64), 0, max(width - 2, 0))
    y0 = np.clip(np.floor(y).astype(np.int64), 0, max(height - 2, 0))
    x1, y1 = np.minimum(x0 + 1, width - 1), np.minimum(y0 + 1, height - 1)
    corners = np.stack([inverse_depth[y0, x0], inverse_depth[y0, x1], inverse_depth[y1, x0], inverse_depth[y1, x1]])
    fx, fy = np.clip(x - x0, 0, 1), np.clip(y - y0, 0, 1)
    weights = np.stack([(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy])
    nearest = inverse_depth[
        np.clip(np.rint(y).astype(np.int64), 0, height - 1), np.clip(np.rint(x).astype(np.int64), 0, width - 1)
    ]
    one_surface = (corners.min(axis=0) > 0) & (corners.max(axis=0) < _ONE_SURFACE * corners.min(axis=0))
    sampled = np.where(one_surface, (weights * corners).sum(axis=0), nearest)
    valid = inside & (sampled > 0)
    depth = 1.0 / np.where(valid, sampled, 1.0)
    return np.where(valid, np.abs(depth - z) / z, np.nan)
