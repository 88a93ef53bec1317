"""Pictures that lie on their side with nothing that says so: apps and editors lose the tag that would turn them.

The x axes of cameras that are held level point in all directions of a walk, and their y axes all point down, more or
less. Where it is the other way round the pictures lie on their side, and to which one the ground tells: it is below.
"""

from __future__ import annotations

import logging

import numpy as np
from numpy.typing import NDArray

from fsinfer.placement.ground_plane import ground_plane
from fsinfer.placement.settings import LevelSettings
from fsinfer.placement.up import upright_frame

_log = logging.getLogger(__name__)

Array = NDArray[np.float64]

#: Share of their scatter that axes have along one line where they all point up and down, at least, and where they lie
#: level and look all round, at most. Source: geometry; 0.88 for a phone tilted by 20 degrees, 0.5 for a full circle and
#: 0.64 for half of one.
_ALONG, _AROUND = 0.8, 0.7
#: The ground covers so many times as many cells as what lies on the other side. Source: judgement.
_MORE_GROUND = 2.0


def upright_axes(
    points: Array, centers: Array, down: Array, right: Array, *, settings: LevelSettings | None = None
) -> tuple[Array, Array]:
    """The axes down and right (C, 3) of the upright photographs, from those of the pictures.

    Those that were given, unless the pictures lie on their side and the ground among the points (N, 3) tells on which;
    ``centers`` (C, 3) are the cameras.
    """
    along, line = _main_line(right)
    if along < _ALONG or _main_line(down)[0] > _AROUND:
        return down, right
    settings = settings or LevelSettings()
    below, above = (_ground_cells(points, centers, up, settings) for up in (line, -line))
    if max(below, above) <= _MORE_GROUND * min(below, above):
        return down, right
    up = line if below > above else -line
    _log.info("the pictures lie on their side, and nothing but the ground tells on which")
    return -right * np.sign(right @ up)[:, None], down


def _main_line(axes: Array) -> tuple[float, Array]:
    """The share of the scatter of unit vectors (C, 3) along the line that they are nearest to, and that line (3,)."""
    values, vectors = np.linalg.eigh(axes.T @ axes)
    return float(values[-1] / values.sum()), np.asarray(vectors[:, -1])


def _ground_cells(points: Array, centers: Array, up: Array, settings: LevelSettings) -> int:
    """How many cells of a grid the ground covers below the cameras, were ``up`` (3,) up."""
    rotation = upright_frame(up)
    middle = np.median(centers, axis=0)
    local, cameras = (points - middle) @ rotation.T, (centers - middle) @ rotation.T
    plane = ground_plane(local, cameras, settings=settings)
    if plane is None:
        return 0
    # As wide as the ground plane looks: twice the reach of most points.
    extent = 4 * float(np.median(np.hypot(local[:, 0], local[:, 1])))
    off = np.abs(local[:, :2] @ plane[:2] + plane[2] - local[:, 2])
    cells = np.floor(local[off < settings.plane_tolerance * extent, :2] / (extent / settings.cells)).astype(np.int64)
    return len(np.unique(cells[(np.abs(cells) <= settings.cells).all(axis=1)], axis=0))
