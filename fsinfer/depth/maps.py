"""The depth and confidence maps of a scene as they lie on the disk, read on demand and kept within a bound."""

from __future__ import annotations

import logging
import math
import threading
from collections import OrderedDict
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import SceneError
from fsinfer.io.digest import file_digest
from fsinfer.io.files import is_by_system
from fsinfer.io.json_text import read_json
from fsinfer.io.pfm import read_pfm, read_pfm_size
from fsinfer.scene import Camera, Scene, project

_log = logging.getLogger(__name__)

#: Pixels of a photograph to one of its depth map. Source: judgement; ours take eight at most.
_MOST_STEP = 10_000
#: Maps kept in memory where nobody says how many. Source: numerics.
CACHED_MAPS = 24


@dataclass(frozen=True, kw_only=True)
class PixelGrid:
    """Pixel (u, v) of a depth map lies at image pixel (u * step_x + offset_x_px, v * step_y + offset_y_px)."""

    step_x: float
    step_y: float
    offset_x_px: float = 0.0
    offset_y_px: float = 0.0

    @property
    def reduced(self) -> float:
        """Pixels of the image to one of the picture that the map was computed from; that is no larger than the image.

        The map's first pixel is the picture's first, whose centre is the middle of the pixels that it was made of.
        """
        return max(1.0, 1.0 + 2.0 * self.offset_x_px)

    def intrinsic(self, image_intrinsic: NDArray[np.float64]) -> NDArray[np.float64]:
        """(3, 3) intrinsics of the depth map from those of the image."""
        map_from_image = np.array(
            [
                [1 / self.step_x, 0, -self.offset_x_px / self.step_x],
                [0, 1 / self.step_y, -self.offset_y_px / self.step_y],
                [0, 0, 1],
            ]
        )
        return np.asarray(map_from_image @ image_intrinsic)


@dataclass(frozen=True, kw_only=True)
class DepthMap:
    """The depth map of one view with its own intrinsics.

    Attributes
    ----------
    inverse_depth: (h, w) float32, 1 / z depth in scene units; 0 where there is no depth.
    confidence: (h, w) float32 in [0, 1].
    intrinsic: (3, 3) float64 of the depth map (not of the photograph), pixels.
    cam_from_world: (4, 4) float64.
    grid: where its pixels lie in the scene image.
    """

    inverse_depth: NDArray[np.float32]
    confidence: NDArray[np.float32]
    intrinsic: NDArray[np.float64]
    cam_from_world: NDArray[np.float64]
    grid: PixelGrid

    @property
    def center(self) -> NDArray[np.float64]:
        """(3,) camera centre in world coordinates."""
        return np.asarray(-self.cam_from_world[:3, :3].T @ self.cam_from_world[:3, 3])

    @cached_property
    def nearest_around(self) -> NDArray[np.float32]:
        """(h, w) float32: greatest inverse depth of each pixel and the eight round it, infinite beside one of none.

        Kept, since each map is asked by a dozen others.
        """
        closed = np.where(self.inverse_depth > 0, self.inverse_depth, np.float32(np.inf))
        return np.asarray(cv2.dilate(closed, np.ones((3, 3), np.uint8)), dtype=np.float32)


def look_up(
    points: NDArray[np.float64], camera: Camera, depth_map: DepthMap
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Z depth of points (N, 3), the inverse depth that the map has there, and whether they lie in the picture.

    Each is (N,). The inverse depth is 0 outside of the picture and where the map knows none.
    """
    pixels, depth = project(points, camera, depth_map.intrinsic)
    cell = np.rint(np.where(depth[:, None] > 0, pixels, -1.0)).astype(np.int64)
    rows, columns = depth_map.inverse_depth.shape
    inside = (cell >= 0).all(axis=1) & (cell[:, 0] < columns) & (cell[:, 1] < rows)
    inverse = np.zeros(len(depth))
    inverse[inside] = depth_map.inverse_depth[cell[inside, 1], cell[inside, 0]]
    return depth, inverse, inside


def seen_and_hidden(
    points: NDArray[np.float64],
    tolerance: NDArray[np.float64],
    camera: Camera,
    depth_map: DepthMap,
    *,
    units_per_scene_unit: float = 1.0,
) -> tuple[float, float]:
    """Shares of points (N, 3) that the depth map shows where they are, and that something nearer hides.

    ``tolerance`` (N,) is how far map and point may differ in z depth. Points, tolerance and the camera's pose are in
    one unit; ``units_per_scene_unit`` of it make one of the depth map's. Points outside of the picture are neither.
    What is nearer than the nearest plane, the camera's ``depth_min``, no map can show, whatever it has there: such a
    point counts as shown, for only what is nearer still could hide it.
    """
    depth, inverse, shown = look_up(points, camera, depth_map)
    known = inverse > 0
    found = np.divide(units_per_scene_unit, inverse, out=np.zeros_like(inverse), where=known)
    too_near = shown & (depth < camera.depth_min)
    seen = too_near | (known & (np.abs(found - depth) <= tolerance))
    hidden = known & (found < depth - tolerance)
    return float(seen.mean()), float(hidden.mean())


class DepthMaps:
    """Reads maps by view index; the ``cache_maps`` used last stay in memory. Threads may share one.

    Parameters
    ----------
    folder: holds ``depth/NAME.pfm``, ``depth/depth.json`` and ``confidence/NAME.pfm`` (without it all count as sure).

    Raises
    ------
    SceneError
        No view of the scene has a depth map, or ``depth.json`` does not say where their pixels lie.
    """

    def __init__(self, scene: Scene, folder: Path, *, cache_maps: int = CACHED_MAPS) -> None:
        self.scene = scene
        self.folder = folder
        self._cache: OrderedDict[int, DepthMap] = OrderedDict()
        self._lock = threading.Lock()
        self._cache_maps = max(2, cache_maps)
        # Maps without an entry are left over from another run, and nobody knows where their pixels lie.
        self._grids = _read_grids(folder / "depth" / "depth.json", [view.name for view in scene.views])
        self.available = tuple(
            i for i, view in enumerate(scene.views) if view.name in self._grids and self._depth_path(i).is_file()
        )
        if not self.available:
            msg = f"{folder / 'depth'} holds no depth map of {scene.folder}; make them with: fsinfer depth"
            raise SceneError(msg)
        missing = len(scene.views) - len(self.available)
        if missing:
            _log.warning("%d of %d views have no depth map and are left out", missing, len(scene.views))

    def __reduce__(self) -> tuple[type[DepthMaps], tuple[Scene, Path]]:
        """For another process, which reads the maps itself."""
        return DepthMaps, (self.scene, self.folder)

    def keep(self, cache_maps: int) -> None:
        """Keep so many maps from now on, at least two."""
        self._cache_maps = max(2, cache_maps)

    def focal_px(self) -> float:
        """Median focal length of the maps, in pixels of the maps (not of the photographs)."""
        views = [self.scene.views[index] for index in self.available]
        return float(np.median([self._grids[view.name].intrinsic(view.camera.intrinsic)[0, 0] for view in views]))

    def picture_focals_px(self) -> NDArray[np.float64]:
        """Focal lengths of the ``available`` views in pixels of the pictures that their maps were computed from.

        A photograph that is larger than what the network is given was reduced to that.
        """
        views = [self.scene.views[index] for index in self.available]
        return np.array([view.camera.intrinsic[0, 0] / self._grids[view.name].reduced for view in views])

    def most_pixels(self) -> int:
        """Pixels of the largest map; :class:`SceneError` where the size of one cannot be read."""
        return max(math.prod(read_pfm_size(self._depth_path(index))) for index in self.available)

    def most_photo_pixels(self) -> int:
        """Pixels of the largest photograph that has a map, as far as that reaches; errors as :meth:`most_pixels`."""
        most = 0.0
        for index in self.available:
            grid = self._grids[self.scene.views[index].name]
            most = max(most, math.prod(read_pfm_size(self._depth_path(index))) * grid.step_x * grid.step_y)
        return math.ceil(most)

    def get(self, index: int) -> DepthMap:
        """Return the map of view ``index``; :class:`SceneError` where it cannot be read."""
        with self._lock:
            if index in self._cache:
                self._cache.move_to_end(index)
                return self._cache[index]
        view = self.scene.views[index]
        depth = read_pfm(self._depth_path(index))
        confidence_path = self.folder / "confidence" / f"{view.name}.pfm"
        confidence = read_pfm(confidence_path) if confidence_path.is_file() else np.ones_like(depth)
        if confidence.shape != depth.shape:
            msg = f"{confidence_path} and {self._depth_path(index)} differ in size; delete both and run: fsinfer depth"
            raise SceneError(msg)
        valid = np.isfinite(depth) & (depth > 0)
        grid = self._grids[view.name]
        found = DepthMap(
            inverse_depth=np.divide(1.0, depth, out=np.zeros_like(depth), where=valid),
            confidence=np.where(valid, np.nan_to_num(confidence), 0).astype(np.float32),
            intrinsic=grid.intrinsic(view.camera.intrinsic),
            cam_from_world=view.camera.cam_from_world,
            grid=grid,
        )
        with self._lock:
            self._cache[index] = found
            while len(self._cache) > self._cache_maps:
                self._cache.popitem(last=False)
        return found

    def _depth_path(self, index: int) -> Path:
        return self.folder / "depth" / f"{self.scene.views[index].name}.pfm"


def _read_grids(path: Path, names: list[str]) -> dict[str, PixelGrid]:
    """Grids by view name: from ``views`` where ``depth.json`` has it, else one grid for all from its top level."""
    try:
        saved = read_json(path)
        entries = saved.get("views") or dict.fromkeys(names, saved)
        grids = {name: _read_grid(entries[name]) for name in names if name in entries}
    except FileNotFoundError as error:
        msg = f"{path} is missing; make the depth maps with: fsinfer depth"
        raise SceneError(msg) from error
    except (OSError, ValueError, TypeError, AttributeError, KeyError, OverflowError) as error:
        msg = f"{path} does not say where the pixels of the depth maps lie ({error!r}); run again: fsinfer depth"
        raise SceneError(msg) from error
    return grids


def _read_grid(entry: dict[str, float]) -> PixelGrid:
    step = entry.get("pixel_step")
    grid = PixelGrid(
        step_x=float(entry.get("pixel_step_x", step)),  # type: ignore[arg-type]  # None is a TypeError, told above
        step_y=float(entry.get("pixel_step_y", step)),  # type: ignore[arg-type]
        offset_x_px=float(entry.get("offset_x_px", 0.0)),
        offset_y_px=float(entry.get("offset_y_px", 0.0)),
    )
    sound = np.isfinite([grid.step_x, grid.step_y, grid.offset_x_px, grid.offset_y_px]).all()
    if not (sound and 0 < grid.step_x <= _MOST_STEP and 0 < grid.step_y <= _MOST_STEP):
        msg = f"pixel steps must be positive and no larger than a photograph, not {grid.step_x}, {grid.step_y}"
        raise ValueError(msg)
    return grid


def maps_digest(depth_folder: Path) -> list[list[str]]:
    """What tells the depth and confidence maps of a folder from others: [part, digest] of each file in it."""
    files = [path for part in ("depth", "confidence") for path in sorted((depth_folder / part).glob("*"))]
    # Looking into the folder leaves files there, and changes no map.
    return [[path.parent.name, file_digest(path)] for path in files if path.is_file() and not is_by_system(path.name)]


def read_depth_index(depth_folder: Path) -> dict[str, Any]:
    """``depth/depth.json`` of a folder that the stage wrote; :class:`SceneError` where there is none."""
    path = depth_folder / "depth" / "depth.json"
    try:
        index = read_json(path)
        if not isinstance(index["views"], dict):
            raise TypeError
    except (OSError, ValueError, KeyError, TypeError) as error:
        msg = f"{depth_folder} holds no finished depth maps ({path} is missing or damaged); run: fsinfer depth"
        raise SceneError(msg) from error
    return dict(index)
