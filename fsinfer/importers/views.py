"""Source views and depth ranges of a scene without tie points, from where its cameras stand and look.

Each camera's picture is filled with places in front of it, at the distances that matter; places that two cameras see
stand for the points that they share. Nothing hides anything here, so that stems between two cameras are overlooked.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fsinfer.errors import SceneError
from fsinfer.importers.foreign import Floats
from fsinfer.poses.view_selection import score_pairs
from fsinfer.scene import Camera, project

#: Cameras nearer to each other than this share of the scene stand at one place. Source: numerics.
_SAME_PLACE = 1e-6


@dataclass(frozen=True, kw_only=True)
class GeometricSettings:
    """What is taken to be in front of cameras where nothing tells.

    Attributes
    ----------
    near_m, far_m: depth range where the unit is the metre. Source: judgement; the ground before a phone held at breast
        height, and the last stem that has some pixels.
    near_steps, far_steps: the same where it is not, in medians of the way from a photo to its nearest one. Source:
        judgement; photographs are taken a step or two apart, 0.6 to 1.2 m.
    least_part, most_part: distances at which places count for the choice of sources, as a factor of the near end and
        as a share of the far one. Source: judgement; 2 to 6 m, where stems are measured.
    columns, rows, layers: places in each picture. Source: numerics.
    most_shared: places that two views share, over all pairs; above it a part of the places stands for all. Source:
        numerics; some ten seconds. Of 1,500 views over one plot it is exceeded twenty times.
    seed: of the draw of those places. Source: numerics.
    """

    near_m: float = 0.5
    far_m: float = 30.0
    near_steps: float = 0.5
    far_steps: float = 30.0
    least_part: float = 4.0
    most_part: float = 1 / 5
    columns: int = 4
    rows: int = 3
    layers: int = 4
    most_shared: int = 100_000_000
    seed: int = 0


def range_without_points(
    centers: Floats, *, metric: bool, settings: GeometricSettings | None = None
) -> tuple[float, float]:
    """Near and far depth for all views, from the camera centres (N, 3).

    Raises
    ------
    SceneError
        All cameras stand at one place: nothing can be seen from two sides.
    """
    settings = settings or GeometricSettings()
    extent = float(np.ptp(centers, axis=0).max())
    nearest, _ = cKDTree(centers).query(centers, k=2)
    steps = nearest[:, 1][nearest[:, 1] > _SAME_PLACE * extent]
    if not len(steps) or extent <= _SAME_PLACE * float(np.abs(centers).max()):
        msg = "all cameras of the scene stand at one place; depth needs photographs from different places"
        raise SceneError(msg)
    if metric:
        return settings.near_m, settings.far_m
    step = float(np.median(steps))
    return settings.near_steps * step, settings.far_steps * step


def scores_without_points(
    cameras: Sequence[Camera], sizes: Sequence[tuple[int, int]], settings: GeometricSettings | None = None
) -> Floats:
    """(V, V) scores of pairs of views, as :func:`fsinfer.poses.view_selection.score_pairs` gives them for tie points.

    ``sizes`` are width and height of the views' images.
    """
    settings = settings or GeometricSettings()
    places = np.concatenate([_places(camera, size, settings) for camera, size in zip(cameras, sizes, strict=True)])
    seen = []
    for camera, (width, height) in zip(cameras, sizes, strict=True):
        pixels, depth = project(places, camera)
        inside = (depth > camera.depth_min) & (depth < camera.depth_max)
        inside &= (pixels >= 0).all(axis=1) & (pixels[:, 0] <= width - 1) & (pixels[:, 1] <= height - 1)
        seen.append(np.flatnonzero(inside))
    drawn = _drawn(seen, len(places), settings)
    seen = [numbers[drawn[numbers]] for numbers in seen]
    return score_pairs(places, np.array([camera.center for camera in cameras]), seen)


def _drawn(seen: Sequence[NDArray[np.int64]], count: int, settings: GeometricSettings) -> NDArray[np.bool_]:
    """Which of ``count`` places stand for all, of numbers (N,) of those that each view sees.

    Of a dense walk every place is seen by a share of all views: the pairs' shares grow with the third power of these.
    """
    seen_by = np.bincount(np.concatenate([*seen, np.zeros(0, np.int64)]), minlength=count).astype(np.float64)
    pairs = 0.5 * seen_by * (seen_by - 1.0)
    shared = float(pairs.sum())
    if shared <= settings.most_shared:
        return np.ones(count, dtype=bool)
    drawn = np.random.default_rng(settings.seed).random(count) < settings.most_shared / shared
    # Views aside of the dense part share little with few: next to nothing of it is drawn, less than a layer of their
    # own. What they see is kept, the places of the fewest pairs first, as far as it shares no more than the draw.
    least = settings.columns * settings.rows
    aside = np.zeros(count, dtype=bool)
    for numbers in seen:
        if np.count_nonzero(drawn[numbers]) < least:
            aside[numbers] = True
    cheapest = np.flatnonzero(aside)[np.argsort(pairs[aside], kind="stable")]
    drawn[cheapest[np.cumsum(pairs[cheapest]) <= settings.most_shared]] = True
    return drawn


def _places(camera: Camera, size: tuple[int, int], settings: GeometricSettings) -> Floats:
    depths = np.geomspace(
        settings.least_part * camera.depth_min, settings.most_part * camera.depth_max, settings.layers
    )
    u = (np.arange(settings.columns) + 0.5) / settings.columns * size[0] - 0.5
    v = (np.arange(settings.rows) + 0.5) / settings.rows * size[1] - 0.5
    columns, rows, layers = (grid.ravel() for grid in np.meshgrid(u, v, depths))
    rays = np.stack([columns, rows, np.ones_like(rows)], axis=1) @ np.linalg.inv(camera.intrinsic).T
    world_from_cam = np.linalg.inv(camera.cam_from_world)
    return np.asarray((rays * layers[:, None]) @ world_from_cam[:3, :3].T + world_from_cam[:3, 3])
