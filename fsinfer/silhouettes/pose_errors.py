"""What the cameras' own errors do to a stem's radius."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from fsinfer.geometry.similarity import apply, scale_of
from fsinfer.poses.adjustment.precision import CameraPrecision
from fsinfer.scene import Scene, project

Floats = NDArray[np.float64]

#: Photos from farther away add little to a stem, metres. Source: judgement.
_FAR_M = 15.0


def radius_error(
    scene: Scene, cloud_from_scene: Floats, precisions: Mapping[str, CameraPrecision]
) -> Callable[[Floats], float] | None:
    """A function that tells the standard deviation that the cameras bring into the radius of a stem, in metres.

    It takes the place of the stem (3,) in the cloud. None where nothing is known of the cameras.

    Notes
    -----
    What a camera's error moves at a stem is its centre's error and its direction's times the distance; each photo moves
    the side that it sees, and photos that are known beside their neighbours err independently of each other, so that
    the mean of n of them errs by 1/sqrt(n) of one.
    """
    known = [view for view in scene.views if view.name in precisions]
    if not known:
        return None
    scale, scene_from_cloud = scale_of(cloud_from_scene), np.linalg.inv(cloud_from_scene)

    def std_m(place: Floats) -> float:
        point = apply(np.asarray(scene_from_cloud, np.float64), place[None])
        variances = []
        for view in known:
            pixel, depth = project(point, view.camera)
            # The principal point is near the middle of the picture.
            inside = (pixel[0] >= 0).all() and (pixel[0] < 2 * view.camera.intrinsic[:2, 2] + 1).all()
            if inside and 0 < scale * depth[0] < _FAR_M:
                precision = precisions[view.name]
                moved = (precision.center_std, depth[0] * precision.direction_std_rad)
                variances.append((scale * float(np.hypot(*moved))) ** 2)
        return float(np.sqrt(np.sum(variances))) / max(len(variances), 1)

    return std_m
