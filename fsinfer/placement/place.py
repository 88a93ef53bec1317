"""From scene units to the plot: z up, ground near z = 0, metres when the scale is known."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fsinfer.geometry.similarity import apply, compose, rotation_of, scale_of, scaling
from fsinfer.io.cloud import LENGTHS, PointCloud
from fsinfer.io.gravity import noted_gravity
from fsinfer.io.turned import upright_from_picture
from fsinfer.notices.capture import CaptureCode
from fsinfer.notices.notice import Notice, notice
from fsinfer.placement.level import level
from fsinfer.placement.on_side import upright_axes
from fsinfer.placement.settings import LevelSettings
from fsinfer.trees.points.cells import count_cells

if TYPE_CHECKING:
    from fsinfer.scene import Scene

#: Side of the cells whose area counts as covered for the density, metres. Source: judgement; wide against the point
#: spacing of a cloud from photographs (1-2 cm), narrow against a plot. The paper gives points per square metre without
#: saying of what.
DENSITY_CELL_M = 0.25


@dataclass(frozen=True, kw_only=True)
class PlacedCloud:
    """A cloud in the plot's frame.

    Attributes
    ----------
    cloud: z up; metres when the scale is known, else model units.
    cloud_from_scene: (4, 4) float64 similarity from scene coordinates to those of ``cloud``.
    camera_height: median height of the cameras over z = 0, in units of ``cloud``; None when the cloud is not levelled.
    warnings: that no ground plane was found.
    """

    cloud: PointCloud
    cloud_from_scene: NDArray[np.float64]
    camera_height: float | None = None
    warnings: tuple[Notice, ...] = ()


def place_cloud(
    cloud: PointCloud, scene: Scene, *, m_per_unit: float | None = None, settings: LevelSettings | None = None
) -> PlacedCloud:
    """Level a fused cloud by its ground and the cameras, and scale it.

    Parameters
    ----------
    cloud: in scene units.
    scene: the cameras say which side is up.
    m_per_unit: metres per scene unit; None keeps scene units.

    Raises
    ------
    CloudError
        The cloud has too few points to find the ground in.
    """
    cloud_from_scene, camera_height, ground_seen = level_scene(
        cloud.xyz, scene, m_per_unit=m_per_unit, settings=settings
    )
    return PlacedCloud(
        cloud=transform_cloud(cloud, cloud_from_scene),
        cloud_from_scene=cloud_from_scene,
        camera_height=camera_height,
        warnings=() if ground_seen else (notice(CaptureCode.no_ground_plane),),
    )


def level_scene(
    points: NDArray[np.float64],
    scene: Scene,
    *,
    m_per_unit: float | None = None,
    settings: LevelSettings | None = None,
) -> tuple[NDArray[np.float64], float, bool]:
    """Find the plot's frame from points (N, 3) and cameras in scene units: z up, ground near z = 0.

    Parameters
    ----------
    m_per_unit: metres per scene unit; None keeps scene units.

    Returns
    -------
    (4, 4) float64 similarity from scene coordinates to the plot's, the median height of the cameras there, and whether
    a ground plane was found.

    Raises
    ------
    CloudError
        There are too few points to find the ground in.
    """
    centers = np.array([view.camera.center for view in scene.views])
    # How the photograph is looked at: imported pictures may lie as the sensor does, on its side or on its head.
    upright = np.array([upright_from_picture(v.image_path) @ v.camera.cam_from_world[:3, :3] for v in scene.views])
    # The image's downward axis in world coordinates: the second row of the rotation.
    down = upright[:, 1]
    # People tilt a phone up or down more than they roll it: its horizontal axis tells what is level.
    right = upright[:, 0]
    down, right = upright_axes(points, centers, down, right, settings=settings)
    scale = 1.0 if m_per_unit is None else m_per_unit
    levelled, ground_seen = level(
        points, centers, down, camera_right=right, gravity=_gravity_of(scene), settings=settings
    )
    plot_from_scene = compose(scaling(scale), levelled)
    height = float(np.median(centers @ plot_from_scene[2, :3] + plot_from_scene[2, 3]))
    return plot_from_scene, height, ground_seen


def _gravity_of(scene: Scene) -> NDArray[np.float64]:
    """(G, 3) unit vectors to the ground, in scene coordinates, of the views whose phone noted it."""
    noted = ((view.camera, noted_gravity(view.image_path, upright=False)) for view in scene.views)
    down = [camera.cam_from_world[:3, :3].T @ gravity for camera, gravity in noted if gravity is not None]
    return np.array(down).reshape(-1, 3)


def transform_cloud(cloud: PointCloud, similarity: NDArray[np.float64]) -> PointCloud:
    """Apply a (4, 4) similarity to points, normals and what else is a length."""
    normals = None if cloud.normals is None else (cloud.normals @ rotation_of(similarity).T).astype(np.float32)
    scale = np.float32(scale_of(similarity))
    extra = {name: values * scale if name in LENGTHS else values for name, values in cloud.extra.items()}
    return replace(cloud, xyz=apply(similarity, cloud.xyz), normals=normals, extra=extra)


def density_per_m2(xyz: NDArray[np.float64]) -> float | None:
    """Points per square metre of plan area covered: points over the area of the occupied 0.25 m cells.

    Parameters
    ----------
    xyz: (N, 3) metres, z up.

    Returns
    -------
    None for an empty cloud.
    """
    if not len(xyz):
        return None
    return float(len(xyz) / (count_cells(xyz[:, :2], DENSITY_CELL_M) * DENSITY_CELL_M**2))
