"""What the depth maps of one scene have in common, wherever they are computed: model, precision, memory, tiles."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass

from fsinfer.depth.manifest import ModelManifest, read_manifest
from fsinfer.depth.memory import DepthPlan, plan_depth
from fsinfer.depth.precision import FLOAT32, INT8, choose_precision
from fsinfer.depth.session import is_processor
from fsinfer.depth.settings import DepthSettings
from fsinfer.scene import View, view_image_size
from fsinfer.threads import cores

_log = logging.getLogger(__name__)

#: Feature maps kept at most; those of neighbours are asked for again within a few views, and 1280x720 takes 11 MB each.
#: Source: numerics.
CACHED_VIEWS = 20
#: So many views are worth processes of their own, which take two seconds to start. Source: numerics.
LEAST_APART = 40


@dataclass(frozen=True, kw_only=True)
class DepthJob:
    """How the depth of a scene is computed.

    Attributes
    ----------
    settings: of the stage.
    model, model_sha256: its name, and the hash of the graphs in use.
    precision: that is computed with, ``float32`` or ``int8``.
    width, height: of the largest photograph as it is given to the network, pixels; it takes the most memory.
    plan: memory and tiles for this size.
    """

    settings: DepthSettings
    model: str
    model_sha256: str
    precision: str
    width: int
    height: int
    plan: DepthPlan


def plan_job(views: Sequence[View], settings: DepthSettings) -> DepthJob:
    """The job of these views: all that depth is computed of, and those that they are compared with.

    Raises
    ------
    ModelError, ImageError
        As their names say.
    InputError
        A depth map takes more than ``settings.memory_gb``.
    """
    manifest = read_manifest(settings.model, trust=settings.trust_model)
    precision = choose_precision(settings.precision, manifest, provider=settings.provider)
    # Of one capture some may be upright and some across, of one camera or of several.
    width, height = max((reduced_size(*view_image_size(view), settings) for view in views), key=math.prod)
    plan = plan_within(
        settings.memory_gb,
        settings=settings,
        manifest=manifest,
        precision=precision,
        width=width,
        height=height,
        most_at_once=_most_at_once(settings),
        apart=len(views) >= LEAST_APART,
    )
    if plan.tile_size:
        _log.warning(
            "depth of %dx%d photos as a whole takes more than the %g GB of --memory-gb: it is computed in tiles, to "
            "the same result in two to four times the time; a larger --memory-gb or a smaller --max-size avoids that",
            width,
            height,
            settings.memory_gb,
        )
        # Tiles are computed in float32 alone; what is written says so.
        precision = FLOAT32
    _log.info(
        "depth takes about %.1f GB, %d at a time%s, %d feature maps are kept",
        plan.peak_bytes / 1e9,
        plan.at_once,
        ", each by a process" if plan.processes > 1 else "",
        plan.cached_views,
    )
    return DepthJob(
        settings=settings,
        model=manifest.name,
        model_sha256=manifest.sha256_of(int8=precision == INT8),
        precision=precision,
        width=width,
        height=height,
        plan=plan,
    )


def _most_at_once(settings: DepthSettings) -> int:
    """Depth maps that may be computed at a time: as many as cores; by a cluster's worker or a graphics card one."""
    if settings.scheduler or not is_processor(settings.provider):
        return 1
    return settings.threads or cores()


def reduced_size(width: int, height: int, settings: DepthSettings) -> tuple[int, int]:
    """(width, height) of a photograph of this size as it is given to the network."""
    factor = min(1.0, settings.max_size_px / max(height, width))
    return round(width * factor), round(height * factor)


def plan_within(
    memory_gb: float,
    *,
    settings: DepthSettings,
    manifest: ModelManifest,
    precision: str,
    width: int,
    height: int,
    most_at_once: int = 1,
    apart: bool = False,
) -> DepthPlan:
    """How depth of photographs of this size keeps within a limit; raises InputError where it cannot."""
    return plan_depth(
        memory_gb,
        width=width,
        height=height,
        planes=manifest.planes,
        groups=manifest.groups,
        level_channels=manifest.level_channels,
        wide_stride=manifest.wide_stride,
        feature_channels=manifest.feature_channels,
        refine_channels=manifest.refine_channels,
        views=settings.source_views + 1,
        most_cached=CACHED_VIEWS,
        int8=precision == INT8,
        tile_halo=None if manifest.tiles is None else manifest.tiles.halo,
        most_at_once=most_at_once,
        apart=apart,
    )
