"""A quick look: depth at a fraction of its size, enough to see which photo shows which stem, not to measure it.

The points that structure from motion shares are too few for this: on rendered plots thin stems and those that only
far photos look at get hardly any, and a photo that shares none on a stem may show it all the same.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fsinfer.depth.maps import DepthMaps
from fsinfer.depth.settings import DepthSettings
from fsinfer.depth.stage import estimate_depth
from fsinfer.errors import CloudError
from fsinfer.fusion.fuse import FusionSettings, fuse
from fsinfer.progress import Progress, silent
from fsinfer.scene import Scene

_log = logging.getLogger(__name__)


#: Longer side and sources of the quick look. Source: a fifth of a second a photo on two cores, against 1.5 s of a run.
_SIZE_PX, _SOURCES = 640, 2


def _small() -> DepthSettings:
    return DepthSettings(max_size_px=_SIZE_PX, source_views=_SOURCES)


#: Views that each is compared with. Source: docs/trials-speed.md, the same stems named as with twelve in two thirds of
#: the time.
_COMPARED = 6


def _joined() -> FusionSettings:
    return FusionSettings(max_sources=_COMPARED)


@dataclass(frozen=True, kw_only=True)
class GlanceSettings:
    """Of depth and fusion, smaller than a run's."""

    depth: DepthSettings = field(default_factory=_small)
    fusion: FusionSettings = field(default_factory=_joined)


@dataclass(frozen=True, kw_only=True)
class Glance:
    """Points (N, 3) of the surface, scene units, and the depth maps that they were fused from."""

    points: NDArray[np.float64]
    maps: DepthMaps


def take_glance(
    scene: Scene,
    folder: Path,
    *,
    settings: GlanceSettings | None = None,
    resume: bool = False,
    progress: Progress = silent,
) -> Glance | None:
    """Compute small depth maps into ``folder`` and fuse them; None where the photos do not allow it.

    ``resume``: maps that are there already are kept, of a check with the same settings which was stopped.

    Raises
    ------
    ModelError, ImageError, OutputError
        As their names say.
    """
    settings = settings or GlanceSettings()
    if not any(view.sources for view in scene.views):
        return None
    estimate_depth(
        scene,
        folder,
        settings=settings.depth,
        resume=resume,
        progress=lambda done, total, _what: progress(done, total, "a quick look at the depth"),
    )
    return read_glance(scene, folder, settings=settings, progress=progress)


def read_glance(
    scene: Scene, folder: Path, *, settings: GlanceSettings | None = None, progress: Progress = silent
) -> Glance | None:
    """Fuse depth maps that lie in ``folder``; None where no two of them agree on anything, or none could be made."""
    settings = settings or GlanceSettings()
    if not any(view.sources for view in scene.views):
        return None
    try:
        cloud = fuse(
            scene,
            folder,
            settings=settings.fusion,
            progress=lambda done, total, _what: progress(done, total, "joining the views"),
        )
    except CloudError as error:
        _log.info("no quick look: %s", error)
        return None
    return Glance(points=cloud.xyz, maps=DepthMaps(scene, folder, cache_maps=2))
