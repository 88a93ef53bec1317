"""FS-MVSNet on the CPU: ONNX graphs around a NumPy cost volume."""

from __future__ import annotations

import os
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsinfer.depth.cost_volume import plane_inverse_depths, upsample_twice, variance_volume
from fsinfer.depth.manifest import ModelManifest, read_manifest
from fsinfer.depth.map_levels import features_of
from fsinfer.depth.memory import keep_freed_memory
from fsinfer.depth.narrow_volumes import candidate_volume, depth_of_index, refiner_volume
from fsinfer.depth.network_input import network_input
from fsinfer.depth.plane_volume import plane_correlation_volume
from fsinfer.depth.precision import AUTO, INT8, choose_precision
from fsinfer.depth.session import available_providers, find_providers, load_graph
from fsinfer.depth.settings import DepthSettings
from fsinfer.depth.surface import SURFACE, of_parts, surface_inputs
from fsinfer.depth.view_group import ViewFeatures, ViewGroup
from fsinfer.errors import InputError, ModelError
from fsinfer.threads import in_order, one_blas_thread

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

#: Least side of an image, pixels. Source: judgement.
_LEAST_SIDE_PX = 32
#: Pixels of an image from one of its feature maps' to the next, of each map that a graph gives out. Source: layout.
_STRIDES = (4, 2)
#: Images whose features are computed at a time. Source: numerics; a third would take as much memory as all the rest.
_IMAGES_AT_ONCE = 2


@dataclass(frozen=True, kw_only=True)
class DepthEstimate:
    """Depth of the reference view.

    Attributes
    ----------
    depth: (h, w) float32, z depth in the units of the poses.
    confidence: (h, w) float32 in [0, 1]. Of a calibrated model (``field``) it is the probability that the depth is
        within 1 % of the truth, as counted on rendered validation views.
    stride: depth pixel (i, j) lies at image pixel (stride * i, stride * j).
    surface: (h, w) float32 in [0, 1], the probability that the depth is of the surface which the pixel shows
        (:mod:`fsinfer.depth.surface`); ``None`` where the model does not tell.
    """

    depth: Float32
    confidence: Float32
    stride: int
    surface: Float32 | None = None


class DepthModel:
    """A depth network: load it once, call :meth:`predict` for each reference view.

    Examples
    --------
    >>> model = DepthModel.load("field")  # doctest: +SKIP
    >>> estimate = model.predict(images, intrinsics, cam_from_world, (1.0, 20.0))  # doctest: +SKIP

    ``precision`` is that of the graphs, ``float32`` or ``int8``; ``sha256`` is over those in use.
    """

    def __init__(
        self,
        manifest: ModelManifest,
        sessions: dict[str, Any],
        threads: int,
        precision: str,
        *,
        calibrate: bool = True,
        providers: Sequence[str] = ("CPUExecutionProvider",),
        regularizers: int = 1,
    ) -> None:
        self.manifest = manifest
        self.threads = threads
        self.precision = precision
        self.sha256 = manifest.sha256_of(int8=precision == INT8)
        self._calibration = manifest.calibration if calibrate else None
        self._sessions = sessions
        self._turns = threading.Semaphore(regularizers)
        self.providers = tuple(providers)

    @classmethod
    def load(
        cls,
        name_or_path: str | Path = DepthSettings.model,
        *,
        threads: int = 0,
        graph_threads: int = 0,
        calibrate: bool = True,
        provider: str = "cpu",
        precision: str = AUTO,
        trust: bool = False,
        regularizers: int = 1,
    ) -> DepthModel:
        """Load a shipped model by name, or any model by the path of its manifest.

        ``threads`` = 0 uses every core, ``graph_threads`` = 0 as many in onnxruntime; ``calibrate`` = False leaves the
        network's confidence as it is; ``provider`` see :func:`fsinfer.depth.session.find_providers`; ``precision`` see
        :func:`fsinfer.depth.precision.choose_precision`; ``trust`` takes graphs whose hash is not the manifest's. Of
        threads that share the model so many ``regularizers`` run at a time, which takes most of a map's memory.
        Raises :class:`ModelError` where a file is missing, damaged or not ONNX, or the provider is not there, and
        :class:`InputError` for an unknown precision.
        """
        providers = find_providers(provider, available_providers())
        manifest = read_manifest(name_or_path, trust=trust)
        precision = choose_precision(precision, manifest, provider=provider)
        threads = threads or os.cpu_count() or 1
        files = manifest.graphs_of(int8=precision == INT8)
        graph_threads = graph_threads or threads
        keep_freed_memory()
        sessions = {role: load_graph(file, graph_threads, providers) for role, file in files.items()}
        return cls(
            manifest,
            sessions,
            threads,
            precision,
            calibrate=calibrate,
            providers=providers,
            regularizers=regularizers,
        )

    def features(self, image: NDArray[np.uint8]) -> ViewFeatures:
        """Feature maps of one (H, W, 3) RGB uint8 image; they can be kept and given to several reference views."""
        if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8 or min(image.shape[:2]) < _LEAST_SIDE_PX:
            least = f"{_LEAST_SIDE_PX}x{_LEAST_SIDE_PX}"
            msg = f"an image must be (H, W, 3) uint8 RGB of at least {least} pixels, is {image.shape=}, {image.dtype=}"
            raise InputError(msg)
        graph = self._sessions["features"]
        outputs = graph.run(None, {"images": network_input(image) if graph.levels is None else graph.levels.of(image)})
        try:
            maps = [
                features_of(output, levels, -(-image.shape[1] // stride))
                for output, levels, stride in zip(outputs, graph.map_levels, _STRIDES, strict=False)
            ]
        except ValueError as error:
            msg = f"the features of model {self.manifest.name} cannot be used: {error}; re-export the model"
            raise ModelError(msg) from error
        if not maps:
            msg = f"the features of model {self.manifest.name} are none; re-export the model"
            raise ModelError(msg)
        return ViewFeatures(quarter=maps[0], half=maps[1] if len(maps) > 1 else None)

    def features_of(self, images: Sequence[NDArray[np.uint8]]) -> list[ViewFeatures]:
        """:meth:`features` of each image, two of them at a time where there are threads for it.

        Threads that share out one image wait for each other in every layer.
        """
        return list(in_order(self.features, images, min(self.threads, _IMAGES_AT_ONCE)))

    def predict(
        self,
        images: Sequence[NDArray[np.uint8]],
        intrinsics: Float64,
        cam_from_world: Float64,
        depth_range: tuple[float, float],
    ) -> DepthEstimate:
        """Depth of the first image.

        Parameters
        ----------
        images: N ≥ 2 RGB uint8 arrays (H, W, 3); the first is the reference.
        intrinsics: (N, 3, 3) pixels, pixel centres at integer coordinates.
        cam_from_world: (N, 4, 4), metres or scene units.
        depth_range: nearest and farthest z depth searched, in the same units.

        Raises
        ------
        InputError
            Fewer than two images, shapes that do not fit, or an empty depth range.
        """
        count = len(images)
        if count < 2:
            msg = f"depth needs a reference and at least one source image, got {count}"
            raise InputError(msg)
        features = self.features_of(images)
        return self.predict_from_features(features, intrinsics, cam_from_world, depth_range)

    def predict_from_features(
        self,
        features: Sequence[ViewFeatures],
        intrinsics: Float64,
        cam_from_world: Float64,
        depth_range: tuple[float, float],
    ) -> DepthEstimate:
        """Do the same from feature maps already computed (:meth:`features`)."""
        return self.estimate(ViewGroup.of(features, intrinsics, cam_from_world, depth_range))

    @one_blas_thread()
    def estimate(self, group: ViewGroup) -> DepthEstimate:
        """Depth of the group's reference view."""
        volume, weights = self.cost_volume(group)
        index, confidence = self.regularize(volume)
        del volume  # a quarter of a map's memory
        return self.finish(group, index, confidence, weights)

    @one_blas_thread()
    def cost_volume(self, group: ViewGroup) -> tuple[Float32, Float32 | None]:
        """What the regularizer is given, at the manifest's wide stride, and the weights (S, h, w) of the sources.

        The shape of the volume stands in the manifest; ``None`` for weights where the model knows none.
        """
        manifest = self.manifest
        planes = plane_inverse_depths(*group.depth_range, manifest.planes, inverse=manifest.inverse_depth)
        quarter = group.quarter
        reference, sources = quarter[0].every(manifest.wide_stride // 4), quarter[1:]
        projections = group.projections(4, manifest.wide_stride)
        if manifest.volume == "variance":
            volume = variance_volume(reference, sources, projections, planes[:, None, None], threads=self.threads)
            return volume[None], None
        volume, weights = plane_correlation_volume(reference, sources, projections, planes, threads=self.threads)
        if not manifest.packed_planes:
            return np.ascontiguousarray(volume.transpose(1, 0, 2, 3))[None], weights
        depth, groups, height, width = volume.shape
        packed = manifest.packed_planes
        return volume.reshape(depth // packed, packed * groups, height, width), weights

    def regularize(self, volume: Float32) -> tuple[Float32, Float32]:
        """Plane index, with fraction, and the network's own confidence (h, w) of a volume of :meth:`cost_volume`."""
        with self._turns:
            index, confidence = self._sessions["regularizer"].run_two({"volume": volume})
        return index, confidence

    def choose(self, inputs: dict[str, Float32], confidence: Float32) -> tuple[Float32, Float32]:
        """Plane index and confidence at a quarter of the resolution, of the surface that the correlations speak for.

        ``inputs`` are those of :func:`fsinfer.depth.narrow_volumes.candidate_volume`, ``confidence`` is that of
        :meth:`regularize`.
        """
        index, mass = self._sessions["candidates"].run_two(inputs)
        return index, upsample_twice(confidence, *index.shape) * mass

    def finish(self, group: ViewGroup, index: Float32, confidence: Float32, weights: Float32 | None) -> DepthEstimate:
        """Refine what :meth:`regularize` gave where the model does so, and turn plane indices into depth."""
        manifest = self.manifest
        if manifest.candidates is not None and weights is not None:
            inputs, weights = candidate_volume(manifest, group, index, confidence, weights, threads=self.threads)
            index, confidence = self.choose(inputs, confidence)
            del inputs  # the volume of the refiner takes its place
        stride, surface = 4, None
        if group.half and weights is not None:
            inputs, centre = refiner_volume(manifest, group, index, weights, threads=self.threads)
            fine_index, fine_confidence = self._sessions["refiner"].run_two(inputs)
            features = inputs["features"]
            del inputs  # what is asked of the surface takes the place of the volume
            step = np.float32(2 * manifest.refine_span / (manifest.refine_planes - 1))
            index, stride = centre - np.float32(manifest.refine_span) + fine_index * step, 2
            confidence = upsample_twice(confidence, *centre.shape) * fine_confidence
            if manifest.surface is not None:
                parts = self._sessions[SURFACE].run_parts(surface_inputs(features, index, confidence))
                surface = of_parts(parts, centre.shape)
        depth = depth_of_index(index, manifest, group.depth_range)
        return DepthEstimate(depth=depth, confidence=self.calibrated(confidence), stride=stride, surface=surface)

    def calibrated(self, confidence: Float32) -> Float32:
        """What the model gives for this raw confidence of the network."""
        if self._calibration is None:
            return confidence
        return np.interp(confidence, *self._calibration).astype(np.float32)
