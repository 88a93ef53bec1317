"""How much of a plot was really seen: ground in the cloud, and sight lines from the cameras that no stem blocks.

A stem can only be found where two photographs look. What is said of a hectare must not rest on the shadow behind a stem
or on a corner where nobody walked.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsinfer.geometry.similarity import apply
from fsinfer.plot_border.border import Border
from fsinfer.scene import Scene, View, in_picture, project, view_image_size
from fsinfer.trees.ground.ground import Ground
from fsinfer.trees.points.cells import rows
from fsinfer.trees.stand import CELL_M, near_ground, seen_cells

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]
#: Photographs that must look at a place: depth needs two. Source: geometry.
LEAST_VIEWS = 2
#: Heights over the ground of which one must be in the picture, metres. Source: where stems are looked for.
LOOKED_AT_M = (0.7, 1.3, 2.0)
#: Cells of a plot at most: larger plots get larger cells. Source: numerics.
MOST_CELLS = 40_000.0
#: Bearings are compared with so much to spare, radians; the distance across decides. Source: numerics.
_BEARING_MARGIN = 1e-6
BY_GROUND = "ground in the cloud, gaps of up to 2 m closed"
BY_SIGHT = f"{BY_GROUND}, without what fewer than {LEAST_VIEWS} photos see past the stems"


@dataclass(frozen=True, kw_only=True)
class Cameras:
    """The photographs: their scene, and the (4, 4) similarity from it to the cloud."""

    scene: Scene
    cloud_from_scene: Floats

    @property
    def places(self) -> Floats:
        """(V, 3) in the frame of the cloud."""
        centers = np.array([view.camera.center for view in self.scene.views]).reshape(-1, 3)
        return apply(self.cloud_from_scene, centers)


@dataclass(frozen=True, kw_only=True)
class SeenShare:
    """The part of a plot's area that was seen.

    Attributes
    ----------
    share: of the area, 0 to 1. method: how that was judged.
    stems: (T,) which stems stand where a stem would have been seen; None where only the share is known: all are then
        taken to stand there.
    """

    share: float
    method: str
    stems: Bools | None = None
    ground_share: float = 1.0


def seen_share(
    border: Border, points: Floats, ground: Ground, stems: Floats, *, cameras: Sequence[Cameras] = ()
) -> SeenShare:
    """Share of the area within ``border`` where a stem would have been seen, and which stems stand there.

    Parameters
    ----------
    points: (N, 3) cloud, metres, z up.
    stems: (T, 3) x, y and radius at breast height; they hide what is behind them.
    cameras: of each part of the walk; without any the ground in the cloud speaks alone.
    """
    cells = plot_cells(border)
    if len(cells) == 0:
        return SeenShare(share=0.0, method=BY_GROUND, stems=np.zeros(len(stems), dtype=bool))
    # Stems are asked about as the cells are: of both a hectare's figure is made.
    places = np.concatenate([cells, stems[:, :2]])
    near = np.abs(points[:, :2] - cells.mean(axis=0)).max(axis=1) <= np.ptp(cells, axis=0).max()
    around = rows(points, near)
    seen = seen_cells(near_ground(around, ground.height_at(around[:, :2]))).at(places)
    ground_share = float(seen[: len(cells)].mean())
    if cameras:
        height_m = ground.height_at(places)
        seen &= np.sum([views_of(places, height_m, stems, part) for part in cameras], axis=0) >= LEAST_VIEWS
    method = BY_SIGHT if cameras else BY_GROUND
    share = float(seen[: len(cells)].mean())
    return SeenShare(share=share, method=method, stems=seen[len(cells) :], ground_share=ground_share)


def plot_cells(border: Border) -> Floats:
    """Centres (C, 2) of the square cells within the border."""
    size_m = max(CELL_M, float(np.sqrt(border.area_m2 / MOST_CELLS)))
    low, high = border.outline.min(axis=0), border.outline.max(axis=0)
    x, y = (np.arange(low[axis] + 0.5 * size_m, high[axis], size_m) for axis in range(2))
    centers = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    return np.asarray(centers[border.inside_m(centers) > 0])


def views_of(cells: Floats, ground_m: Floats, stems: Floats, cameras: Cameras) -> NDArray[np.int64]:
    """How many photographs see each of cells (C, 2), with the ground at ``ground_m`` (C,), past stems (T, 3).

    A cell is seen where one of ``LOOKED_AT_M`` is in the picture, within the depths that the view looks for, and no
    stem stands in the line of sight in plan.
    """
    scene_from_cloud = np.linalg.inv(cameras.cloud_from_scene)
    heights = [np.column_stack([cells, ground_m + height]) for height in LOOKED_AT_M]
    columns = apply(np.asarray(scene_from_cloud, dtype=np.float64), np.array(heights, dtype=np.float64))
    count = np.zeros(len(cells), dtype=np.int64)
    for view, place in zip(cameras.scene.views, cameras.places, strict=True):
        looked_at = _in_picture(columns, view)
        looked_at[looked_at] = ~_hidden(place[:2], cells[looked_at], stems)
        count += looked_at
    return count


def _in_picture(columns: Floats, view: View) -> Bools:
    """Which of the columns (H, C, 3) of scene points are in the picture at one of their heights: (C,)."""
    pixels, depth = project(columns, view.camera)
    inside = in_picture(pixels, depth, view_image_size(view))
    return np.asarray((inside & (depth <= view.camera.depth_max)).any(axis=0))


def _hidden(eye: Floats, cells: Floats, stems: Floats) -> Bools:
    """Which of cells (C, 2) a stem hides from ``eye`` (2,); the cell that a stem stands in is not hidden by it."""
    result = np.zeros(len(cells), dtype=bool)
    ray = cells - eye
    length = np.maximum(np.hypot(*ray.T), 1e-9)
    direction = ray / length[:, None]
    offset = stems[:, :2] - eye
    cell, stem = _same_bearing(ray, offset, stems[:, 2])
    along = (direction[cell] * offset[stem]).sum(axis=1)
    across = np.abs(direction[cell, 0] * offset[stem, 1] - direction[cell, 1] * offset[stem, 0])
    radius = stems[stem, 2]
    result[cell[(along > 0) & (across < radius) & (along + radius < length[cell])]] = True
    return result


def _same_bearing(ray: Floats, offset: Floats, radius: Floats) -> tuple[Ints, Ints]:
    """Numbers (P,) of cells and of stems that an eye may see in one line: each with each would be gigabytes.

    ``ray`` (C, 2) and ``offset`` (T, 2) lead there from the eye. All that are in line are among them, few others.
    """
    bearing = np.arctan2(ray[:, 1], ray[:, 0])
    order = np.argsort(bearing)
    # Twice round, so that no stem's bearings have a gap in them.
    turns = np.concatenate([bearing[order], bearing[order] + 2.0 * np.pi])
    half = np.arcsin(np.minimum(radius / np.maximum(np.hypot(*offset.T), 1e-9), 1.0)) + _BEARING_MARGIN
    low = (np.arctan2(offset[:, 1], offset[:, 0]) - half + np.pi) % (2.0 * np.pi) - np.pi
    first, last = np.searchsorted(turns, low), np.searchsorted(turns, low + 2.0 * half)
    stem = np.repeat(np.arange(len(offset)), last - first)
    place = np.arange(len(stem)) + np.repeat(first - (np.cumsum(last - first) - (last - first)), last - first)
    return order[place % max(len(order), 1)], stem
