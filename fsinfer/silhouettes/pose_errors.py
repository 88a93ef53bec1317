"""What the cameras' own errors do to a stem's radius."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from fsinfer.geometry.similarity import apply, scale_of
from fsinfer.poses.adjustment.precision import CameraPrecision
from fsinfer.scene import Scene, project
from fsinfer.trees.diameter.edge_set import Edges
from fsinfer.trees.diameter.silhouette import SilhouetteFit

Floats = NDArray[np.float64]


def ray_errors(
    scene: Scene, cloud_from_scene: Floats, precisions: Mapping[str, CameraPrecision]
) -> Callable[[Floats], Floats] | None:
    """A function that tells how far the cameras' errors move their rays at a place (3,) of the cloud.

    It returns one standard deviation for each view of the scene, metres across the ray: of the centre and of the
    direction times the distance; zero for a view of which nothing is known, or behind which the place lies. None where
    nothing is known of any.
    """
    if not any(view.name in precisions for view in scene.views):
        return None
    scale, scene_from_cloud = scale_of(cloud_from_scene), np.asarray(np.linalg.inv(cloud_from_scene), np.float64)

    def std_m(place: Floats) -> Floats:
        point = apply(scene_from_cloud, place[None])
        found = np.zeros(len(scene.views))
        for index, view in enumerate(scene.views):
            known = precisions.get(view.name)
            if known is not None:
                depth = max(float(project(point, view.camera)[1][0]), 0.0)
                found[index] = scale * np.hypot(known.center_std, depth * known.direction_std_rad) if depth else 0.0
        return found

    return std_m


def radius_std(edges: Edges, fit: SilhouetteFit, ray_std_m: Floats) -> float:
    """Standard deviation that errors of the cameras bring into the radius of a silhouette, metres.

    Parameters
    ----------
    ray_std_m: (V,), of each photograph of the scene across its rays.

    Notes
    -----
    A camera that is moved by s moves the tangent with outward normal n by n.s, on all its bands, and the radius by the
    sum of that over its edges, each times its gain. Both sides of a stem in one photograph have opposite normals: they
    move its place, not its size. What is left are stems half hidden in photographs of one side.
    """
    pull = np.zeros((len(ray_std_m), 2))
    normals = np.column_stack([np.cos(edges.angle_rad), np.sin(edges.angle_rad)])
    np.add.at(pull, edges.photo, fit.gain[:, None] * normals)
    return float(np.sqrt(((pull**2).sum(axis=1) * ray_std_m**2).sum()))
