"""Which photo sees which stem: its own depth map shows a surface where the stem's is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fsinfer.check.settings import SightingSettings
from fsinfer.check.visible_stems import VisibleStem
from fsinfer.conventions.breast_height import BREAST_HEIGHT_M
from fsinfer.depth.maps import DepthMap, DepthMaps, look_up
from fsinfer.geometry.similarity import apply, scale_of
from fsinfer.scene import Camera, Scene
from fsinfer.trees.ground.ground import Ground

Floats = NDArray[np.float64]


#: Distance of the places on a stem that are looked up, metres. Source: numerics.
_STEP_M = 0.1
#: Distances that stand for none. Source: numerics.
_LEAST_M = 1e-9


def find_sightings(
    stems: Sequence[VisibleStem],
    ground: Ground | None,
    scene: Scene,
    maps: DepthMaps,
    plot_from_scene: Floats,
    *,
    settings: SightingSettings | None = None,
) -> NDArray[np.bool_]:
    """Look every stem up in every photo.

    Parameters
    ----------
    stems: in the plot's frame, metres, z up; ``ground`` gives the height they stand on (None: z = 0).
    plot_from_scene: (4, 4) similarity.

    Returns
    -------
    (K, P) bool, stems by photos in the order of ``scene.views``. Photos without a depth map see nothing.
    """
    s = settings or SightingSettings()
    seen = np.zeros((len(stems), len(scene.views)), dtype=bool)
    if not stems:
        return seen

    m_per_unit = scale_of(plot_from_scene)
    scene_from_plot = np.asarray(np.linalg.inv(plot_from_scene), dtype=np.float64)
    heights = np.arange(s.heights_m[0], s.heights_m[1] + _STEP_M / 2, _STEP_M)
    plans = np.array([stem.center + (heights[:, None] - BREAST_HEIGHT_M) * stem.lean for stem in stems])
    foot = (
        np.zeros(plans.shape[:2]) if ground is None else ground.height_at(plans.reshape(-1, 2)).reshape(plans.shape[:2])
    )
    places = np.array([plot_from_scene[:3, :3] @ v.camera.center + plot_from_scene[:3, 3] for v in scene.views])
    axes = np.concatenate([plans, (foot + heights)[..., None]], axis=2)
    radii = np.array([stem.radius for stem in stems])[:, None]
    for index in maps.available:
        camera, found = scene.views[index].camera, maps.get(index)
        towards = places[index, :2] - axes[..., :2]
        distance = np.linalg.norm(towards, axis=2)
        front = axes.copy()
        front[..., :2] += towards * (np.minimum(radii, distance) / np.maximum(distance, _LEAST_M))[..., None]
        points = apply(scene_from_plot, front).reshape(-1, 3)
        tolerance = (s.tolerance_m + s.of_radius * radii + s.of_distance * distance).ravel() / m_per_unit
        there = _shown(points, tolerance, camera, found, s.near * camera.depth_min)
        seen[:, index] = there.reshape(distance.shape).mean(axis=1) >= s.min_share
    return seen & _accompanied(seen, places, s.together_m)


def _shown(points: Floats, tolerance: Floats, camera: Camera, found: DepthMap, near: float) -> NDArray[np.bool_]:
    """Whether the depth map has a surface at the points (N, 3), within their tolerance (N,) of z depth, scene units.

    Points in the picture that are nearer than ``near`` are shown as well.
    """
    depth, inverse, inside = look_up(points, camera, found)
    agrees = (inverse > 0) & (np.abs(1 / np.where(inverse > 0, inverse, 1.0) - depth) <= tolerance)
    return np.asarray(agrees | (inside & (depth < near)))


def _accompanied(seen: NDArray[np.bool_], places: Floats, within_m: float) -> NDArray[np.bool_]:
    """Whether another photo within reach sees the stem, (K, P); ``places`` (P, 3)."""
    pairs = cKDTree(places).query_pairs(within_m, output_type="ndarray")
    others = np.zeros(seen.shape, dtype=bool)
    for one, other in (pairs.T, pairs.T[::-1]):
        np.logical_or.at(others.T, one, seen.T[other])
    return others
