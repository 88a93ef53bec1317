"""The photographs of a run, as the trees stage looks stems up in them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fsinfer.poses.adjustment.precision import read_camera_precisions
from fsinfer.scene import Scene
from fsinfer.silhouettes.join import StemPhotos
from fsinfer.silhouettes.pose_errors import ray_errors


def photos_of_run(out: Path, scene: Scene, cloud_from_scene: NDArray[np.float64]) -> StemPhotos:
    """Photographs, depth maps and cameras of the run in ``out``, and how well the cameras are known.

    Raises
    ------
    SceneError
        The record of the poses is damaged.
    """
    errors = ray_errors(scene, cloud_from_scene, read_camera_precisions(out / "scene"))
    return StemPhotos(scene=scene, depth_folder=out, cloud_from_scene=cloud_from_scene, ray_std_m=errors)
