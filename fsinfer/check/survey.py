"""What a walk shows before anything is measured: its plan, the stems, and which photo sees which of them."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fsinfer.check.coarse_depth import Glance
from fsinfer.check.settings import SightingSettings, SparseStemSettings
from fsinfer.check.sightings import find_sightings
from fsinfer.check.sparse_stems import find_sparse_stems
from fsinfer.check.visible_stems import VisibleStem, join_stems
from fsinfer.errors import CloudError
from fsinfer.geometry.similarity import apply, compose, scaling
from fsinfer.placement.place import level_scene
from fsinfer.poses.sparse import LONG_TRACK, SparseModel
from fsinfer.scale.scale import CAMERA_HEIGHT_M
from fsinfer.scene import Scene
from fsinfer.trees.ground.ground import Ground, find_ground
from fsinfer.trees.search.find import find_stems
from fsinfer.trees.search.stem import StemSettings

_log = logging.getLogger(__name__)

Floats = NDArray[np.float64]

#: Height of the cameras that stands for none, scene units. Source: numerics.
_LEAST_HEIGHT = 1e-9


@dataclass(frozen=True, kw_only=True)
class SurveySettings:
    """How stems are found.

    Attributes
    ----------
    surface, sparse: the search in the surface and in the sparse points.
    max_reach_m: points farther from the middle of the walk are left out. Source: judgement; wider than a plot.
    """

    surface: StemSettings = field(default_factory=StemSettings)
    sparse: SparseStemSettings = field(default_factory=SparseStemSettings)
    sightings: SightingSettings = field(default_factory=SightingSettings)
    max_reach_m: float = 30.0


@dataclass(frozen=True, kw_only=True)
class Survey:
    """A walk and its stems, metres, z up.

    Attributes
    ----------
    names: of the placed photos, in the order of walking.
    cameras: (P, 2) their plan positions.
    plot_from_scene: (4, 4) similarity.
    stems: K of them, in no order.
    seen: (K, P) bool, which photo sees which stem.
    """

    names: tuple[str, ...]
    cameras: Floats
    plot_from_scene: Floats
    stems: tuple[VisibleStem, ...]
    seen: NDArray[np.bool_]


def survey_scene(
    scene: Scene,
    sparse: SparseModel,
    glance: Glance | None,
    *,
    m_per_unit: float | None,
    settings: SurveySettings | None = None,
) -> Survey:
    """Find the stems, and who sees them.

    Parameters
    ----------
    glance: the quick look; without one no stem is found, because nothing tells which photo sees it.
    m_per_unit: metres per scene unit; without it they are guessed from the height of the cameras.

    Raises
    ------
    CloudError
        There are too few sparse points to tell which side is up.
    """
    settings = settings or SurveySettings()
    motion, camera_height, _ = level_scene(sparse.points, scene, m_per_unit=m_per_unit)
    if m_per_unit is None:
        guess = CAMERA_HEIGHT_M / max(camera_height, _LEAST_HEIGHT)
        motion = compose(scaling(guess), motion)
    centers = np.array([view.camera.center for view in scene.views])
    stems: list[VisibleStem] = []
    seen = np.zeros((0, len(scene.views)), dtype=bool)
    if glance is not None:
        surface, points = (apply(motion, xyz) for xyz in (glance.points, sparse.points))
        ground = _find_ground(surface, settings.max_reach_m)
        found = find_stems(_above(surface, ground, settings.max_reach_m), settings=settings.surface)
        trusted = (sparse.track_lengths >= LONG_TRACK) & (sparse.errors_px < settings.sparse.max_error_px)
        trusted &= np.hypot(*points[:, :2].T) < settings.max_reach_m
        heights = _heights(points, ground)
        stems = join_stems(found.stems, find_sparse_stems(points, heights, trusted, settings=settings.sparse))
        seen = find_sightings(stems, ground, scene, glance.maps, motion, settings=settings.sightings)
    return Survey(
        names=tuple(view.name for view in scene.views),
        cameras=apply(motion, centers)[:, :2],
        plot_from_scene=motion,
        stems=tuple(stems),
        seen=seen,
    )


def _find_ground(points: Floats, reach_m: float) -> Ground | None:
    try:
        return find_ground(points[np.hypot(*points[:, :2].T) < reach_m])
    except CloudError as error:
        _log.info("no ground is seen (%s); z = 0 stands for it", error)
        return None


def _heights(points: Floats, ground: Ground | None) -> Floats:
    return points[:, 2] if ground is None else points[:, 2] - ground.height_at(points[:, :2])


def _above(points: Floats, ground: Ground | None, reach_m: float) -> Floats:
    """Points (N, 3) of x, y and height above the ground, those out of reach left out."""
    near = points[np.hypot(*points[:, :2].T) < reach_m]
    return np.column_stack([near[:, :2], _heights(near, ground)])
