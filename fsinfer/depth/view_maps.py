"""The depth and the confidence maps of views, several at a time, with the feature maps of the last ones at hand."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fsinfer.depth.job import DepthJob, reduced_size
from fsinfer.depth.median_filter import settle_unsure
from fsinfer.depth.memory import DepthPlan
from fsinfer.depth.model import DepthEstimate, DepthModel
from fsinfer.depth.photo_confidence import ConfidenceCurves, probability, quantities
from fsinfer.depth.settings import DepthSettings
from fsinfer.depth.subpixel import Refinement, normalised, refine_depth
from fsinfer.depth.surface import doubted
from fsinfer.depth.tiles import TiledDepth
from fsinfer.depth.view_group import ViewFeatures
from fsinfer.scene import Scene, View, read_view_image


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


@dataclass(frozen=True, kw_only=True)
class ViewMaps:
    """What is written of a view.

    Attributes
    ----------
    depth, confidence: (h, w) float32.
    stride: pixels of the reduced photograph to one of the maps.
    scale_x, scale_y: by which the photograph was reduced.
    """

    depth: NDArray[np.float32]
    confidence: NDArray[np.float32]
    stride: int
    scale_x: float
    scale_y: float


class _Slot:
    """Place of a photograph in the cache; who comes first loads it, and others wait for that."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.loaded: LoadedView | None = None


class MapsOfViews:
    """The model of a job, which computes the maps of its views in any order; those of neighbours are quickest together.

    Several threads may ask at a time.

    Parameters
    ----------
    plan: of the job, or one for less memory that cuts depth into the same tiles.
    threads: for one view; 0 uses every core.
    graph_threads: of onnxruntime, which all views share that are computed at a time; 0 is as many as ``threads``.

    Raises
    ------
    ModelError
        The model cannot be loaded.
    """

    def __init__(self, job: DepthJob, *, plan: DepthPlan, threads: int, graph_threads: int = 0) -> None:
        self._settings = job.settings
        self._cached_views = plan.cached_views
        self._model = DepthModel.load(
            job.settings.model,
            threads=threads,
            graph_threads=graph_threads,
            provider=job.settings.provider,
            precision=job.precision,
            trust=job.settings.trust_model,
            regularizers=plan.regularizers,
        )
        self.model_sha256 = self._model.sha256
        self._predictor = (
            TiledDepth(self._model, plan.tile_size, keeps_volume=plan.keeps_volume) if plan.tile_size else self._model
        )
        self._cache: OrderedDict[str, _Slot] = OrderedDict()
        self._lock = threading.Lock()

    def of(self, view: View, sources: Sequence[View]) -> ViewMaps:
        """The maps of a view, compared with its sources."""
        settings = self._settings
        loaded = [self._recall(v) for v in (view, *sources)]
        intrinsics = np.stack([item.intrinsic for item in loaded])
        cam_from_world = np.stack([v.camera.cam_from_world for v in (view, *sources)])
        depth_range = search_range(
            view.camera.depth_min, view.camera.depth_max, settings, inverse_depth=self._model.manifest.inverse_depth
        )
        estimate = self._predictor.predict_from_features(
            [item.features for item in loaded], intrinsics, cam_from_world, depth_range
        )
        greys = [item.grey for item in loaded]
        depth, confidence = finish_depth(
            estimate,
            greys,
            intrinsics,
            cam_from_world,
            curves=self._model.manifest.photo_confidence,
            settings=settings,
            threads=self._model.threads,
        )
        return ViewMaps(
            depth=depth,
            confidence=confidence,
            stride=estimate.stride,
            scale_x=loaded[0].scale_x,
            scale_y=loaded[0].scale_y,
        )

    def _recall(self, view: View) -> LoadedView:
        with self._lock:
            slot = self._cache.setdefault(view.name, _Slot())
            self._cache.move_to_end(view.name)
            while len(self._cache) > self._cached_views:
                self._cache.popitem(last=False)
        with slot.lock:
            if slot.loaded is None:
                slot.loaded = load_view(self._model, view, self._settings)
            return slot.loaded


def load_view(model: DepthModel, view: View, settings: DepthSettings) -> LoadedView:
    """Read a photograph, reduce it to ``max_size_px`` on its longer side, and compute its feature maps."""
    image, scale_x, scale_y = reduced_image(view, settings)
    intrinsic = reduced_intrinsic(view.camera.intrinsic, scale_x, scale_y)
    grey = normalised(image, settings.subpixel)
    return LoadedView(features=model.features(image), grey=grey, intrinsic=intrinsic, scale_x=scale_x, scale_y=scale_y)


def reduced_image(view: View, settings: DepthSettings) -> tuple[NDArray[np.uint8], float, float]:
    """The (H, W, 3) photograph of a view as it is given to the network, and by how much its sides were reduced."""
    image = read_view_image(view)
    height, width = image.shape[:2]
    size = reduced_size(width, height, settings)
    if size != (width, height):
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.uint8)
    return image, size[0] / width, size[1] / height


def reduced_intrinsic(intrinsic: NDArray[np.float64], scale_x: float, scale_y: float) -> NDArray[np.float64]:
    """(3, 3) of a photograph that was reduced: pixel centre x goes to (x + 0.5) scale - 0.5, as in cv2.resize."""
    reduced = intrinsic.copy()
    reduced[0] *= scale_x
    reduced[1] *= scale_y
    reduced[0, 2] += 0.5 * scale_x - 0.5
    reduced[1, 2] += 0.5 * scale_y - 0.5
    return reduced


def finish_depth(
    estimate: DepthEstimate,
    greys: Sequence[NDArray[np.float16]],
    intrinsics: NDArray[np.float64],
    cam_from_world: NDArray[np.float64],
    *,
    curves: ConfidenceCurves | None,
    settings: DepthSettings,
    threads: int = 1,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Depth (h, w) of the network, unsure pixels settled, at a tenth of a pixel, and settled again; and the confidence.

    ``greys`` (N, H, W), ``intrinsics`` (N, 3, 3) and ``cam_from_world`` (N, 4, 4) of reference and sources. Without
    ``curves`` of the model, or a sub-pixel step, the confidence (h, w) begins with the network's; where the model tells
    whether a depth is of the surface that its pixel shows, it is doubted by that.
    """
    refined = settled_and_refined(estimate, greys, intrinsics, cam_from_world, settings=settings, threads=threads)
    confidence = estimate.confidence
    if curves is not None and refined.last is not None:
        confidence = probability(quantities(confidence, refined.last), curves, threads=threads)
    if estimate.surface is not None:
        confidence = doubted(confidence, estimate.surface)
    # The photographs at full size tell better than the network which pixels are wrong, and what is sure is sharper now.
    depth = settle_unsure(refined.depth, confidence, settings=settings.unsure_after, threads=threads)
    return depth, confidence


def settled_and_refined(
    estimate: DepthEstimate,
    greys: Sequence[NDArray[np.float16]],
    intrinsics: NDArray[np.float64],
    cam_from_world: NDArray[np.float64],
    *,
    settings: DepthSettings,
    threads: int = 1,
) -> Refinement:
    """The depth of :func:`finish_depth`, and what the sub-pixel step saw: what the curves are fitted on."""
    own = estimate.confidence
    depth = settle_unsure(estimate.depth, own, settings=settings.unsure, threads=threads)
    return refine_depth(depth, own, greys, intrinsics, cam_from_world, settings=settings.subpixel, threads=threads)


def search_range(near: float, far: float, settings: DepthSettings, *, inverse_depth: bool) -> tuple[float, float]:
    """Depth range to search where planes are uniform in 1/depth, see :class:`DepthSettings`; others are searched as is.

    The near bound of a range that is too long is moved out first, then the far bound of one that is too tight.
    """
    if not inverse_depth:
        return near, far
    near = max(near, far / settings.max_far_over_near)
    return near, max(far, settings.min_far_over_near * near)


def sources_of(scene: Scene, view: View, settings: DepthSettings) -> list[View]:
    """The views that one is compared with."""
    return [scene.views[i] for i in view.sources[: settings.source_views]]
