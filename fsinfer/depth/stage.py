"""Stage ``depth``: a depth and a confidence map for every view of a scene folder."""

from __future__ import annotations

import json
import logging
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fsinfer.depth.maps import read_depth_index
from fsinfer.depth.median_filter import settle_unsure
from fsinfer.depth.memory import DepthPlan, plan_depth
from fsinfer.depth.model import DepthEstimate, DepthModel, ViewFeatures
from fsinfer.depth.precision import FLOAT32, INT8
from fsinfer.depth.settings import DepthSettings
from fsinfer.depth.subpixel import normalised, refine_depth
from fsinfer.depth.tiles import TiledDepth
from fsinfer.errors import SceneError
from fsinfer.io.files import make_folder, write_text
from fsinfer.io.images import read_image
from fsinfer.io.pfm import read_pfm, write_pfm
from fsinfer.progress import Progress, silent
from fsinfer.scene import Scene, View
from fsinfer.threads import one_blas_thread

_log = logging.getLogger(__name__)

#: Feature maps kept at most; those of neighbours are asked for again within a few views, and 1280x720 takes 11 MB each.
#: Source: numerics.
CACHED_VIEWS = 24


@dataclass(frozen=True, kw_only=True)
class DepthResult:
    """What the stage wrote: ``depth_folder/depth/*.pfm`` and ``depth_folder/confidence/*.pfm``.

    ``precision`` is the one that was used; ``model_sha256`` is over the graphs of that precision.
    """

    depth_folder: Path
    views: int
    model: str
    model_sha256: str
    precision: str


@dataclass(frozen=True, kw_only=True)
class LoadedView:
    """Feature maps of a photograph reduced by ``scale_x``, ``scale_y``, and its (3, 3) intrinsics after that.

    ``grey`` (H, W) float16 are its grey values for the sub-pixel step (:func:`fsinfer.depth.subpixel.normalised`).
    """

    features: ViewFeatures
    grey: NDArray[np.float16]
    intrinsic: NDArray[np.float64]
    scale_x: float
    scale_y: float


@one_blas_thread()
def estimate_depth(
    scene: Scene,
    out: Path,
    *,
    settings: DepthSettings | None = None,
    resume: bool = False,
    progress: Progress = silent,
) -> DepthResult:
    """Write ``out/depth/NAME.pfm``, ``out/confidence/NAME.pfm`` and ``out/depth/depth.json``.

    ``resume``: views whose maps are there already are kept; for an attempt with the same scene, settings and model,
    which was stopped.

    Raises
    ------
    SceneError
        A view has no source view. ModelError, ImageError, OutputError as their names say.
    InputError
        A depth map takes more than ``settings.memory_gb``.
    """
    settings = settings or DepthSettings()
    load = partial(
        DepthModel.load,
        settings.model,
        threads=settings.threads,
        provider=settings.provider,
        trust=settings.trust_model,
    )
    model = load(precision=settings.precision)
    usable = [view for view in scene.views if view.sources]
    if not usable:
        msg = f"{scene.folder / 'pair.txt'} gives no view a source view; the photos do not overlap"
        raise SceneError(msg)
    plan = _plan(usable, settings, model)
    if plan.tile_size and model.precision == INT8:
        # Tiles are computed in float32 alone; what is written says so.
        model = load(precision=FLOAT32)
    predictor = TiledDepth(model, plan.tile_size, keeps_volume=plan.keeps_volume) if plan.tile_size else model
    make_folder(out / "depth")
    make_folder(out / "confidence")
    index = _begin(out, settings, model.sha256, resume=resume)
    cached_views = plan.cached_views
    threads_before = cv2.getNumThreads()
    cv2.setNumThreads(1)  # the volume is shared out over blocks of rows already
    cache: OrderedDict[str, LoadedView] = OrderedDict()
    try:
        for done, view in enumerate(usable):
            progress(done, len(usable), f"depth of {view.name}")
            sources = [scene.views[i] for i in view.sources[: settings.source_views]]
            if view.name in index["views"] and _complete(out, view.name):
                continue
            loaded = [_recall(model, v, settings, cache, cached_views) for v in (view, *sources)]
            intrinsics = np.stack([item.intrinsic for item in loaded])
            cam_from_world = np.stack([v.camera.cam_from_world for v in (view, *sources)])
            estimate = predictor.predict_from_features(
                [item.features for item in loaded],
                intrinsics,
                cam_from_world,
                search_range(
                    view.camera.depth_min, view.camera.depth_max, settings, inverse_depth=model.manifest.inverse_depth
                ),
            )
            greys = [item.grey for item in loaded]
            depth = finish_depth(estimate, greys, intrinsics, cam_from_world, settings=settings, threads=model.threads)
            write_pfm(out / "depth" / f"{view.name}.pfm", depth)
            write_pfm(out / "confidence" / f"{view.name}.pfm", estimate.confidence)
            scale_x, scale_y = loaded[0].scale_x, loaded[0].scale_y
            index["views"][view.name] = {
                "width": estimate.depth.shape[1],
                "height": estimate.depth.shape[0],
                "pixel_step_x": estimate.stride / scale_x,
                "pixel_step_y": estimate.stride / scale_y,
                "offset_x_px": 0.5 / scale_x - 0.5,
                "offset_y_px": 0.5 / scale_y - 0.5,
            }
            if done == 0:
                # The same for all views of one camera; a quick look should not have to search for it.
                first = index["views"][view.name]
                index.update({k: first[k] for k in ("width", "height", "pixel_step_x", "pixel_step_y")})
            _write_index(out, index)
    finally:
        cv2.setNumThreads(threads_before)
    _write_index(out, index)
    progress(len(usable), len(usable), "depth")
    return DepthResult(
        depth_folder=out,
        views=len(usable),
        model=model.manifest.name,
        model_sha256=model.sha256,
        precision=model.precision,
    )


def finish_depth(
    estimate: DepthEstimate,
    greys: Sequence[NDArray[np.float16]],
    intrinsics: NDArray[np.float64],
    cam_from_world: NDArray[np.float64],
    *,
    settings: DepthSettings,
    threads: int = 1,
) -> NDArray[np.float32]:
    """Depth (h, w) of the network with its unsure pixels settled, and that at a tenth of a pixel.

    ``greys`` (N, H, W), ``intrinsics`` (N, 3, 3) and ``cam_from_world`` (N, 4, 4) of reference and sources.
    """
    depth = settle_unsure(estimate.depth, estimate.confidence, settings=settings.unsure)
    if settings.subpixel.rounds == 0:
        return depth
    return refine_depth(
        depth, estimate.confidence, greys, intrinsics, cam_from_world, settings=settings.subpixel, threads=threads
    )


def search_range(near: float, far: float, settings: DepthSettings, *, inverse_depth: bool) -> tuple[float, float]:
    """Depth range to search where planes are uniform in 1/depth, see :class:`DepthSettings`; others are searched as is.

    The near bound of a range that is too long is moved out first, then the far bound of one that is too tight.
    """
    if not inverse_depth:
        return near, far
    near = max(near, far / settings.max_far_over_near)
    return near, max(far, settings.min_far_over_near * near)


def _plan(views: Sequence[View], settings: DepthSettings, model: DepthModel) -> DepthPlan:
    """Memory for the first photograph's size; those of a mixed capture are reduced to the same longer side."""
    height, width = read_image(views[0].image_path).shape[:2]
    factor = min(1.0, settings.max_size_px / max(height, width))
    plan = plan_depth(
        settings.memory_gb,
        width=round(width * factor),
        height=round(height * factor),
        planes=model.manifest.planes,
        groups=model.manifest.groups,
        level_channels=model.manifest.level_channels,
        feature_channels=model.manifest.feature_channels,
        refine_channels=model.manifest.refine_channels,
        views=settings.source_views + 1,
        most_cached=CACHED_VIEWS,
        int8=model.precision == INT8,
        tile_halo=None if model.manifest.tiles is None else model.manifest.tiles.halo,
    )
    if plan.tile_size:
        _log.warning(
            "depth of %dx%d photos as a whole takes more than the %g GB of --memory-gb: it is computed in tiles, to "
            "the same result in two to four times the time; a larger --memory-gb or a smaller --max-size avoids that",
            round(width * factor),
            round(height * factor),
            settings.memory_gb,
        )
    _log.info("depth takes about %.1f GB, %d feature maps are kept", plan.peak_bytes / 1e9, plan.cached_views)
    return plan


def _recall(
    model: DepthModel, view: View, settings: DepthSettings, cache: OrderedDict[str, LoadedView], cached_views: int
) -> LoadedView:
    if view.name in cache:
        cache.move_to_end(view.name)
        return cache[view.name]
    loaded = cache[view.name] = load_view(model, view, settings)
    while len(cache) > cached_views:
        cache.popitem(last=False)
    return loaded


def load_view(model: DepthModel, view: View, settings: DepthSettings) -> LoadedView:
    """Read a photograph, reduce it to ``max_size_px`` on its longer side, and compute its feature maps."""
    image = read_image(view.image_path)
    height, width = image.shape[:2]
    factor = min(1.0, settings.max_size_px / max(height, width))
    intrinsic = view.camera.intrinsic.copy()
    scale_x = scale_y = 1.0
    if factor < 1:
        size = (round(width * factor), round(height * factor))
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.uint8)
        scale_x, scale_y = size[0] / width, size[1] / height
        # cv2.resize maps the centre of pixel x to (x + 0.5) * scale - 0.5.
        intrinsic[0] *= scale_x
        intrinsic[1] *= scale_y
        intrinsic[0, 2] += 0.5 * scale_x - 0.5
        intrinsic[1, 2] += 0.5 * scale_y - 0.5
    grey = normalised(image, settings.subpixel)
    return LoadedView(features=model.features(image), grey=grey, intrinsic=intrinsic, scale_x=scale_x, scale_y=scale_y)


def _begin(out: Path, settings: DepthSettings, model_sha256: str, *, resume: bool) -> dict[str, Any]:
    """The index to go on with: that of the attempt before, or one without views."""
    # The model's hash stands for its name and its precision too: two manifests of the same graphs give the same maps.
    index: dict[str, Any] = {
        "model": settings.model,
        "model_sha256": model_sha256,
        "source_views": settings.source_views,
        "max_size_px": settings.max_size_px,
        "views": {},
    }
    try:
        before = read_depth_index(out) if resume else index
    except SceneError:
        return index
    return before if before.get("model_sha256") == model_sha256 else index


def _write_index(out: Path, index: dict[str, Any]) -> None:
    write_text(out / "depth" / "depth.json", json.dumps(index, indent=1))


def _complete(out: Path, name: str) -> bool:
    try:
        read_pfm(out / "depth" / f"{name}.pfm")
        read_pfm(out / "confidence" / f"{name}.pfm")
    except SceneError:
        return False
    return True
