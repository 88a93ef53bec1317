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

from fsinfer.depth.candidates import candidate_planes, hints
from fsinfer.depth.cost_volume import (
    Features,
    correlation_volume,
    plane_inverse_depths,
    upsample_index,
    upsample_twice,
    variance_volume,
)
from fsinfer.depth.manifest import ModelManifest, read_manifest
from fsinfer.depth.plane_volume import plane_correlation_volume
from fsinfer.depth.precision import AUTO, INT8, choose_precision
from fsinfer.depth.session import available_providers, find_providers, load_graph
from fsinfer.depth.settings import DepthSettings
from fsinfer.depth.warping import relative_projection
from fsinfer.errors import InputError, ModelError
from fsinfer.threads import one_blas_thread

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

#: Least 1/depth of a hypothesis: what lies beyond infinity is nowhere. Source: numerics.
_LEAST_INVERSE = np.float32(1e-6)
#: Least side of an image, pixels. Source: judgement.
_LEAST_SIDE_PX = 32


@dataclass(frozen=True, kw_only=True)
class DepthEstimate:
    """Depth of the reference view.

    Attributes
    ----------
    depth: (h, w) float32, z depth in the units of the poses.
    confidence: (h, w) float32 in [0, 1]. Of a calibrated model (``field``) it is the probability that the depth is
        within 1 % of the truth, as counted on rendered validation views.
    stride: depth pixel (i, j) lies at image pixel (stride * i, stride * j).
    """

    depth: Float32
    confidence: Float32
    stride: int


@dataclass(frozen=True, kw_only=True)
class ViewFeatures:
    """Feature maps of one image at a quarter and, for the refinement, at half resolution."""

    quarter: Features
    half: Features | None


def network_input(image: NDArray[np.uint8]) -> Float32:
    """(1, 3, H, W) float32, 0 to 255, of an (H, W, 3) RGB uint8 image."""
    return np.ascontiguousarray(image.transpose(2, 0, 1)[None], dtype=np.float32)


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
        outputs = self._sessions["features"].run(None, {"images": network_input(image)})
        if not outputs or any(maps.ndim != 4 or maps.shape[1] % 4 or not maps.size for maps in outputs):
            shapes = [maps.shape for maps in outputs]
            msg = f"the features of model {self.manifest.name} are {shapes}, not (1, C, h, w) with C a multiple of 4"
            raise ModelError(msg)
        return ViewFeatures(
            quarter=Features.from_chw(outputs[0][0]),
            half=Features.from_chw(outputs[1][0]) if len(outputs) > 1 else None,
        )

    @one_blas_thread()
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
        return self.predict_from_features(
            [self.features(image) for image in images], intrinsics, cam_from_world, depth_range
        )

    @one_blas_thread()
    def predict_from_features(
        self,
        features: Sequence[ViewFeatures],
        intrinsics: Float64,
        cam_from_world: Float64,
        depth_range: tuple[float, float],
    ) -> DepthEstimate:
        """Do the same from feature maps already computed (:meth:`features`)."""
        intrinsics, cam_from_world = np.asarray(intrinsics, np.float64), np.asarray(cam_from_world, np.float64)
        volume, weights = self.cost_volume(features, intrinsics, cam_from_world, depth_range)
        index, confidence = self.regularize(volume)
        del volume  # a quarter of a map's memory
        return self.finish(features, intrinsics, cam_from_world, depth_range, index, confidence, weights)

    def finish(
        self,
        features: Sequence[ViewFeatures],
        intrinsics: Float64,
        cam_from_world: Float64,
        depth_range: tuple[float, float],
        index: Float32,
        confidence: Float32,
        weights: Float32 | None,
    ) -> DepthEstimate:
        """Refine what :meth:`regularize` gave where the model does so, and turn plane indices into depth."""
        near, far = depth_range
        if self.manifest.candidates is not None and weights is not None:
            inputs, weights = self.candidate_volume(
                features, intrinsics, cam_from_world, depth_range, index, confidence, weights
            )
            index, confidence = self.choose(inputs, confidence)
            del inputs  # the narrow volume takes its place
        if features[0].half is None or weights is None:
            return DepthEstimate(depth=self._depth(index, near, far), confidence=self.calibrated(confidence), stride=4)
        return self._refine(features, intrinsics, cam_from_world, (near, far), index, confidence, weights)

    @one_blas_thread()
    def cost_volume(
        self,
        features: Sequence[ViewFeatures],
        intrinsics: Float64,
        cam_from_world: Float64,
        depth_range: tuple[float, float],
    ) -> tuple[Float32, Float32 | None]:
        """What the regularizer is given, at the manifest's wide stride, and the weights (S, h, w) of the sources.

        The shape of the volume stands in the manifest; ``None`` for weights where the model knows none. Arguments and
        errors are those of :meth:`predict`.
        """
        intrinsics, cam_from_world = np.asarray(intrinsics, np.float64), np.asarray(cam_from_world, np.float64)
        near, far = depth_range
        if intrinsics.shape != (len(features), 3, 3) or cam_from_world.shape != (len(features), 4, 4):
            msg = f"{len(features)} views need (N,3,3) and (N,4,4), got {intrinsics.shape=}, {cam_from_world.shape=}"
            raise InputError(msg)
        if not 0 < near < far or not np.isfinite(far):
            msg = f"the depth range must be 0 < near < far, is {depth_range}"
            raise InputError(msg)
        manifest = self.manifest
        planes = plane_inverse_depths(near, far, manifest.planes, inverse=manifest.inverse_depth)[:, None, None]
        reference = features[0].quarter.every(manifest.wide_stride // 4)
        sources = [view.quarter for view in features[1:]]
        projections = self._projections(intrinsics, cam_from_world, 4, manifest.wide_stride)
        if manifest.volume == "variance":
            return variance_volume(reference, sources, projections, planes, threads=self.threads)[None], None
        volume, weights = plane_correlation_volume(
            reference, sources, projections, planes[:, 0, 0], threads=self.threads
        )
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

        ``inputs`` are those of :meth:`candidate_volume`, ``confidence`` is that of :meth:`regularize`.
        """
        index, mass = self._sessions["candidates"].run_two(inputs)
        return index, upsample_twice(confidence, *index.shape) * mass

    @one_blas_thread()
    def candidate_volume(
        self,
        features: Sequence[ViewFeatures],
        intrinsics: Float64,
        cam_from_world: Float64,
        depth_range: tuple[float, float],
        index: Float32,
        confidence: Float32,
        weights: Float32,
    ) -> tuple[dict[str, Float32], Float32]:
        """What the graph of the candidates is given, and the weights (S, H, W) of the sources at a quarter.

        The inputs are by their names ``volume`` (candidates x groups, H, W), ``features`` (C, H, W), ``hints`` (3, H,
        W) and ``planes`` (candidates, H, W); see :mod:`fsinfer.depth.candidates`. The arguments are those of
        :meth:`narrow_volume`.
        """
        found = self.manifest.candidates
        if found is None:
            msg = f"model {self.manifest.name} has no candidates"
            raise ModelError(msg)
        quarter = [view.quarter for view in features]
        height, width = quarter[0].shape
        planes = candidate_planes(index, height, width, around=found.around, step=found.step)
        weights = upsample_twice(weights, height, width)
        volume, _ = correlation_volume(
            quarter[0],
            quarter[1:],
            self._projections(intrinsics, cam_from_world, 4),
            self._inverse_depth(planes, depth_range),
            view_weights=weights,
            threads=self.threads,
        )
        inputs = {
            "volume": volume.reshape(-1, height, width),
            "features": quarter[0].to_chw(),
            "hints": hints(planes, confidence),
            "planes": planes,
        }
        return inputs, weights

    def _inverse_depth(self, planes_dhw: Float32, depth_range: tuple[float, float]) -> Float32:
        """1/depth at plane indices, of a model whose planes are uniform in it."""
        near, far = depth_range
        interval = np.float32((1 / near - 1 / far) / (self.manifest.planes - 1))
        inverse = planes_dhw * interval
        inverse += np.float32(1 / far)
        np.maximum(inverse, _LEAST_INVERSE, out=inverse)
        return inverse

    def _refine(
        self,
        features: Sequence[ViewFeatures],
        intrinsics: Float64,
        cam_from_world: Float64,
        depth_range: tuple[float, float],
        index: Float32,
        confidence: Float32,
        weights: Float32,
    ) -> DepthEstimate:
        """Depth at half resolution, from the narrow volume round that of the 192 planes."""
        manifest = self.manifest
        near, far = depth_range
        inputs, centre = self.narrow_volume(features, intrinsics, cam_from_world, depth_range, index, weights)
        fine_index, fine_confidence = self._sessions["refiner"].run_two(inputs)
        step = np.float32(2 * manifest.refine_span / (manifest.refine_planes - 1))
        final = centre - np.float32(manifest.refine_span) + fine_index * step
        height, width = centre.shape
        return DepthEstimate(
            depth=self._depth(final, near, far),
            confidence=self.calibrated(upsample_twice(confidence, height, width) * fine_confidence),
            stride=2,
        )

    @one_blas_thread()
    def narrow_volume(
        self,
        features: Sequence[ViewFeatures],
        intrinsics: Float64,
        cam_from_world: Float64,
        depth_range: tuple[float, float],
        index: Float32,
        weights: Float32,
    ) -> tuple[dict[str, Float32], Float32]:
        """What the refiner is given, and the plane index (H, W) at half resolution that its hypotheses lie round.

        ``index`` (h, w) is that of :meth:`regularize`, ``weights`` (S, h, w) those of :meth:`cost_volume`; the others
        as there. The inputs are ``volume`` (hypotheses x groups, H, W) and ``features`` (C, H, W) by their names.
        """
        manifest = self.manifest
        half = [view.half for view in features if view.half is not None]
        height, width = half[0].shape
        centre = upsample_index(index, height, width)
        offsets = np.linspace(-manifest.refine_span, manifest.refine_span, manifest.refine_planes, dtype=np.float32)
        narrow = self._inverse_depth(centre[None] + offsets[:, None, None], depth_range)
        fine_volume, _ = correlation_volume(
            half[0],
            half[1:],
            self._projections(intrinsics, cam_from_world, 2),
            narrow,
            view_weights=upsample_twice(weights, height, width),
            threads=self.threads,
        )
        return {"volume": fine_volume.reshape(-1, height, width), "features": half[0].to_chw()}, centre

    def calibrated(self, confidence: Float32) -> Float32:
        """What the model gives for this raw confidence of the network."""
        if self._calibration is None:
            return confidence
        return np.interp(confidence, *self._calibration).astype(np.float32)

    @staticmethod
    def _projections(
        intrinsics: Float64, cam_from_world: Float64, stride: int, reference_stride: int | None = None
    ) -> list[Any]:
        reference = intrinsics[0], cam_from_world[0]
        return [
            relative_projection(*reference, intrinsics[i], cam_from_world[i], stride, reference_stride)
            for i in range(1, len(intrinsics))
        ]

    def _depth(self, index: Float32, near: float, far: float) -> Float32:
        fraction = index / np.float32(self.manifest.planes - 1)
        if self.manifest.inverse_depth:
            inverse = np.float32(1 / far) + fraction * np.float32(1 / near - 1 / far)
            return np.asarray(1 / np.maximum(inverse, _LEAST_INVERSE), np.float32)
        return np.asarray(np.float32(near) + fraction * np.float32(far - near), np.float32)
