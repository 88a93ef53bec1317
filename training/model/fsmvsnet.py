"""FS-MVSNet: features, warping, 192-plane volume, regularization, depth; with every switch of the ablation."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from training.model.backbone import BFPN, PlainBackbone, upsample_like
from training.model.candidates import (
    LOOKED_UP,
    LOOKED_UP_STEP,
    CandidateHead,
    candidate_planes,
    hints,
    read_candidates,
    spread_indices,
)
from training.model.config import DEPTH_PLANES, ModelConfig
from training.model.packed import PackedRegularizer, Refiner, pack
from training.model.regression import peak_window, soft_argmin, upsample_index
from training.model.regularizer3d import Regularizer3D
from training.model.volume import correlation_volume, plane_inverse_depths, variance_volume
from training.model.warping import relative_projection

#: Planes on each side of the best one in the local soft-argmin of the 192-plane volume, and of the narrow one. Source:
#: judgement.
WINDOW_RADIUS, REFINE_WINDOW_RADIUS = 3, 3
#: Groups of the narrow volume's correlation. Source: 8 channels in groups of four.
REFINE_GROUPS = 2
#: Planes on each side of the best one whose probability is the confidence. Source: MVSNet (Yao et al. 2018) sums four
#: planes round the estimate; a symmetric window of three is its odd sister.
CONFIDENCE_RADIUS = 1


def _at_least_single(values: Tensor) -> Tensor:
    """``values`` in float32 where they have fewer digits; float64 stays."""
    return values if values.dtype == torch.float64 else values.float()


def _hypotheses(centre_hw: Tensor, span: float, count: int, interval: Tensor, far: Tensor) -> Tensor:
    """1/depth (``count``, h, w) of plane indices evenly spaced from ``span`` below the centre to as much above it."""
    offsets = torch.linspace(-span, span, count, device=centre_hw.device, dtype=centre_hw.dtype)
    return (1 / far + (centre_hw[None] + offsets[:, None, None]) * interval).clamp_min(1e-6)


@dataclass(frozen=True, kw_only=True)
class ScaleOutput:
    """Plane scores at one scale and what was read off them.

    Attributes
    ----------
    stride: image pixels per output pixel.
    scores_dhw: (D, h, w) logits of the planes.
    index_hw: (h, w) sub-plane index into those planes.
    inverse_depth_dhw: (D, 1, 1) or (D, h, w) 1/depth of the planes.
    candidates_dhw: (K, h, w) where the scores are those of candidates: their plane indices, as ``index_hw`` is one.
    """

    stride: int
    scores_dhw: Tensor
    index_hw: Tensor
    inverse_depth_dhw: Tensor
    candidates_dhw: Tensor | None = None


@dataclass(frozen=True, kw_only=True)
class DepthOutput:
    """Depth of the reference view (h, w), confidence in [0, 1], output stride, and the scales, finest last."""

    depth: Tensor
    confidence: Tensor
    stride: int
    scales: tuple[ScaleOutput, ...]


@dataclass(frozen=True, kw_only=True)
class Window:
    """Part of the reference view, in quarter-resolution pixels; training works on crops of the volume."""

    x: int
    y: int
    width: int
    height: int


class FeatureNetwork(nn.Module):
    """Normalization and backbone: (N, 3, H, W) RGB in 0 … 255 → quarter (and half) resolution features.

    Each channel of each image is standardized by itself, so that exposure and white balance of single frames
    cancel before the first layer; it is part of the exported graph.
    """

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        if config.backbone == "bfpn":
            refine = config.refine_channels if config.refine_planes else 0
            self.backbone: nn.Module = BFPN(
                base=config.base_channels, channels=config.feature_channels, refine_channels=refine
            )
        else:
            self.backbone = PlainBackbone(base=config.base_channels, channels=config.feature_channels)

    def forward(self, images_nchw: Tensor) -> tuple[Tensor, Tensor | None]:
        """Return (N, F, H/4, W/4) and (N, R, H/2, W/2) or ``None``."""
        mean = images_nchw.mean(dim=(2, 3), keepdim=True)
        centred = images_nchw - mean
        deviation = centred.square().mean(dim=(2, 3), keepdim=True).sqrt()
        quarter, half = self.backbone(centred / (deviation + 1.0))
        return quarter, half


class PlaneHead(nn.Module):
    """The regularizer with what is read off its scores, as exported: volume → (index (h, w), confidence (h, w))."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.config = config
        if config.regularizer == "packed":
            self.regularizer: nn.Module = PackedRegularizer(
                groups=config.groups, packed_planes=config.packed_planes, width=config.width, se=config.se
            )
        else:
            channels = config.feature_channels if config.volume == "variance" else config.groups
            self.regularizer = Regularizer3D(channels, config.width, se=config.se)

    def scores(self, volume: Tensor) -> list[Tensor]:
        """(D, h, w) scores, finest first, then the coarser heads where the regularizer has them."""
        if self.config.regularizer == "packed":
            return [self.regularizer(volume)]
        return [s[0] for s in self.regularizer(volume)]

    def read(self, scores_dhw: Tensor) -> tuple[Tensor, Tensor]:
        """Sub-plane index and confidence: soft-argmin over all planes (paper), or local to the peak (field)."""
        probability = torch.softmax(scores_dhw, dim=0)
        local_index, _ = peak_window(probability, WINDOW_RADIUS)
        _, mass = peak_window(probability, CONFIDENCE_RADIUS)
        if self.config.loss == "plane":
            return local_index, mass
        planes = torch.arange(probability.shape[0], device=probability.device, dtype=probability.dtype)
        return soft_argmin(probability, planes), mass

    def forward(self, volume: Tensor) -> tuple[Tensor, Tensor]:
        """Packed slabs (S, k*G, h, w), or a (1, C, D, h, w) volume."""
        return self.read(self.scores(volume)[0])


class RefineHead(nn.Module):
    """The refiner: (L*G, h, w) volume and (R, h, w) features → (index (h, w), confidence (h, w))."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.refiner = Refiner(
            planes=config.refine_planes,
            looked_up=config.refine_looked_up,
            groups=REFINE_GROUPS,
            features=config.refine_channels,
        )

    def scores(self, volume_chw: Tensor, features_chw: Tensor) -> Tensor:
        """(D, h, w) scores of the narrow volume."""
        return torch.as_tensor(self.refiner(volume_chw, features_chw))

    @staticmethod
    def read(scores_dhw: Tensor) -> tuple[Tensor, Tensor]:
        """Sub-plane index and the mass near it."""
        return peak_window(torch.softmax(scores_dhw, dim=0), REFINE_WINDOW_RADIUS)

    def forward(self, volume_chw: Tensor, features_chw: Tensor) -> tuple[Tensor, Tensor]:
        """Return index and confidence."""
        return self.read(self.scores(volume_chw, features_chw))


@dataclass(frozen=True, kw_only=True)
class _Views:
    """Photographs (N, 3, H, W) with their cameras, the reference first."""

    images: Tensor
    intrinsics: Tensor
    cam_from_world: Tensor

    def projection(self, stride: int, reference_stride: int | None = None) -> tuple[Tensor, Tensor]:
        """:func:`training.model.warping.relative_projection`, where the photographs are."""
        dtype = self.images.dtype
        found = relative_projection(self.intrinsics, self.cam_from_world, stride, reference_stride, dtype)
        a, b = (part.to(self.images.device) for part in found)
        return a, b


@dataclass(frozen=True, kw_only=True)
class _Wide:
    """What the volume of all planes gave; ``weights`` (S, h, w) of the sources where it knows them."""

    index: Tensor
    confidence: Tensor
    weights: Tensor | None
    scales: tuple[ScaleOutput, ...]


class FSMVSNet(nn.Module):
    """The whole network for one reference view and its sources."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.config = config
        self.features = FeatureNetwork(config)
        self.plane_head = PlaneHead(config)
        self.refine_head = RefineHead(config) if config.refine_planes else None
        self.candidate_head: CandidateHead | None = None
        if config.wide_stride > 4:
            self.candidate_head = CandidateHead(groups=config.groups, features=config.feature_channels)

    def forward(
        self,
        images: Tensor,  # (N, 3, H, W) RGB 0..255, view 0 is the reference; float64 with the weights in float64
        intrinsics: Tensor,  # (N, 3, 3) pixels
        cam_from_world: Tensor,  # (N, 4, 4)
        depth_range: tuple[float, float],
        window: Window | None = None,
        planes: int = DEPTH_PLANES,
    ) -> DepthOutput:
        """Depth of view 0 inside ``window`` (default: all of it); training may begin with fewer ``planes``."""
        config = self.config
        quarter, half = self.features(images)
        # Under autocast the networks may compute in 16 bits; where features meet coordinates, and where a depth is read
        # off 192 planes, three digits are too few.
        quarter, half = _at_least_single(quarter), None if half is None else _at_least_single(half)
        if window is None:
            window = Window(x=0, y=0, width=quarter.shape[-1], height=quarter.shape[-2])
        near, far = (torch.tensor(d, device=images.device, dtype=images.dtype) for d in depth_range)
        inverse = plane_inverse_depths(near, far, planes, inverse=config.inverse_depth)[:, None, None]
        views = _Views(images=images, intrinsics=intrinsics, cam_from_world=cam_from_world)
        wide = self._wide(views, quarter, inverse, window)
        index, confidence, weights = wide.index, wide.confidence, wide.weights
        scales = list(wide.scales)
        interval = (1 / near - 1 / far) / (planes - 1)
        if self.candidate_head is not None and weights is not None:
            centres = spread_indices(index.detach(), window.height, window.width)
            candidates = candidate_planes(centres)
            weights = upsample_like(weights.detach()[None], candidates)[0]
            looked_up = candidate_planes(centres, LOOKED_UP, LOOKED_UP_STEP)
            hypotheses = (1 / far + looked_up * interval).clamp_min(1e-6)
            volume, reference = self._narrow(views, quarter, hypotheses, window, 4, config.groups, weights)
            scores = _at_least_single(
                self.candidate_head.scores(volume, reference, hints(candidates, confidence.detach()))
            )
            index, mass = read_candidates(scores, candidates)
            confidence = upsample_like(confidence[None, None], mass)[0, 0] * mass
            scales.append(
                ScaleOutput(
                    stride=4, scores_dhw=scores, index_hw=index, inverse_depth_dhw=inverse, candidates_dhw=candidates
                )
            )
        if self.refine_head is None or half is None or weights is None:
            depth = self._depth(index / (planes - 1), near, far)
            return DepthOutput(depth=depth, confidence=confidence, stride=4, scales=tuple(scales))

        fine = Window(
            x=2 * window.x,
            y=2 * window.y,
            width=min(2 * window.width, half.shape[-1] - 2 * window.x),
            height=min(2 * window.height, half.shape[-2] - 2 * window.y),
        )
        centre = upsample_index(index.detach(), fine.height, fine.width)
        narrow = _hypotheses(centre, config.refine_span, config.refine_planes, interval, far)
        looked_up = _hypotheses(centre, config.refine_span, config.refine_looked_up, interval, far)
        fine_weights = upsample_like(weights.detach()[None], centre)[0]
        volume, reference = self._narrow(views, half, looked_up, fine, 2, REFINE_GROUPS, fine_weights)
        scores = _at_least_single(self.refine_head.scores(volume, reference))
        fine_index, fine_confidence = self.refine_head.read(scores)
        scales.append(ScaleOutput(stride=2, scores_dhw=scores, index_hw=fine_index, inverse_depth_dhw=narrow.detach()))
        step = 2 * config.refine_span / (config.refine_planes - 1)
        final = centre - config.refine_span + fine_index * step
        coarse_confidence = upsample_like(confidence[None, None], centre)[0, 0]
        return DepthOutput(
            depth=self._depth(final / (planes - 1), near, far),
            confidence=coarse_confidence * fine_confidence,
            stride=2,
            scales=tuple(scales),
        )

    def _wide(self, views: _Views, quarter: Tensor, inverse: Tensor, window: Window) -> _Wide:
        """The volume of all planes, and what is read off it, at the wide stride."""
        config = self.config
        step = config.wide_stride // 4
        rows = slice(window.y, window.y + window.height, step)
        columns = slice(window.x, window.x + window.width, step)
        reference, sources = quarter[0, :, rows, columns], list(quarter[1:])
        hypotheses = inverse.expand(-1, *reference.shape[-2:])
        a, b = views.projection(4, config.wide_stride)
        origin = (window.x // step, window.y // step)
        weights: Tensor | None = None
        with torch.autocast(quarter.device.type, enabled=False):
            if config.volume == "variance":
                volume = variance_volume(reference, sources, a, b, hypotheses, origin)[None]
            else:
                correlations, weights = correlation_volume(reference, sources, a, b, hypotheses, origin, config.groups)
                volume = correlations.transpose(0, 1)[None]
                if config.regularizer == "packed":
                    volume = pack(correlations, config.packed_planes)
        all_scores = [_at_least_single(scores) for scores in self.plane_head.scores(volume)]
        index, confidence = self.plane_head.read(all_scores[0])
        scales = []
        for level in range(len(all_scores) - 1, 0, -1):
            coarser = 2**level
            coarse_index, _ = self.plane_head.read(all_scores[level])
            scales.append(
                ScaleOutput(
                    stride=4 * coarser,
                    scores_dhw=all_scores[level],
                    index_hw=coarse_index,
                    inverse_depth_dhw=inverse[::coarser],
                )
            )
        scales.append(
            ScaleOutput(stride=config.wide_stride, scores_dhw=all_scores[0], index_hw=index, inverse_depth_dhw=inverse)
        )
        return _Wide(index=index, confidence=confidence, weights=weights, scales=tuple(scales))

    @staticmethod
    def _narrow(
        views: _Views,
        features: Tensor,
        hypotheses_dhw: Tensor,
        window: Window,
        stride: int,
        groups: int,
        weights: Tensor,
    ) -> tuple[Tensor, Tensor]:
        """Correlations (D*G, h, w) at hypotheses of each pixel's own, and the reference's features (C, h, w).

        ``weights`` (S, h, w) of the sources are those of the wide volume, interpolated.
        """
        a, b = views.projection(stride)
        rows, columns = slice(window.y, window.y + window.height), slice(window.x, window.x + window.width)
        reference = features[0, :, rows, columns]
        with torch.autocast(features.device.type, enabled=False):
            volume, _ = correlation_volume(
                reference, list(features[1:]), a, b, hypotheses_dhw, (window.x, window.y), groups, weights
            )
        return volume.flatten(0, 1), reference

    def _depth(self, fraction_hw: Tensor, near: Tensor, far: Tensor) -> Tensor:
        """Depth at these shares of the way through the planes."""
        if self.config.inverse_depth:
            return 1 / (1 / far + fraction_hw * (1 / near - 1 / far)).clamp_min(1e-6)
        return near + fraction_hw * (far - near)
