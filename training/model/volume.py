"""Cost volumes: variance over the views (MVSNet), and group correlation weighted by view."""

from __future__ import annotations

from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from training.model.warping import project

#: Warped features at a time: what a second-level cache holds. Source: numerics; 2**18 was measured 12 % slower.
CHUNK_BYTES = 2**21


def plane_inverse_depths(depth_min: Tensor, depth_max: Tensor, planes: int, *, inverse: bool) -> Tensor:
    """(D,) 1/depth of the planes: uniform in 1/depth from far to near, or uniform in depth from near to far."""
    steps = torch.linspace(0, 1, planes, device=depth_min.device, dtype=depth_min.dtype)
    if inverse:
        return 1 / depth_max + steps * (1 / depth_min - 1 / depth_max)
    return 1 / (depth_min + steps * (depth_max - depth_min))


def variance_volume(
    reference_chw: Tensor,
    sources: list[Tensor],
    a: Tensor,
    b: Tensor,
    inverse_depth_dhw: Tensor,
    origin_xy: tuple[int, int],
) -> Tensor:
    """Variance of the N views' features (MVSNet, eq. 2): (C, D, h, w).

    ``reference_chw`` is already cut to the window; ``sources`` are whole feature maps.
    """
    places = [torch.stack(project(a[i], b[i], inverse_depth_dhw, origin_xy)) for i in range(len(sources))]
    return torch.as_tensor(FeatureVariance.apply(reference_chw, torch.stack(places), *sources))  # type: ignore[no-untyped-call]


class FeatureVariance(torch.autograd.Function):
    """The variance of the reference and its warped sources without the warped volumes, as :class:`GroupCorrelation`.

    Written out, sums, squares and their gradients, each (C, D, h, w), were half of a training step on a CPU.
    """

    @staticmethod
    def forward(ctx: Any, reference_chw: Tensor, places_s2dhw: Tensor, *sources_chw: Tensor) -> Tensor:
        """(C, h, w), source coordinates (S, 2, D, h, w), S times (C, Hs, Ws) → (C, D, h, w)."""
        channels, h, w = reference_chw.shape
        planes, views = places_s2dhw.shape[2], len(sources_chw) + 1
        reference = reference_chw.reshape(channels, 1, h * w)
        grids = [_normalized(x, y, source) for (x, y), source in zip(places_s2dhw, sources_chw, strict=True)]
        result = reference_chw.new_empty(channels, planes, h * w)
        for chunk in _chunks(planes, reference_chw):
            first, *others = (_sample(source, grid[chunk])[0] for source, grid in zip(sources_chw, grids, strict=True))
            total, squares = first + reference, first.square().addcmul_(reference, reference)
            for warped in others:
                total += warped
                squares.addcmul_(warped, warped)
            result[:, chunk] = squares.div_(views).addcmul_(total, total, value=-1 / views**2)
        ctx.save_for_backward(reference_chw, *grids, *sources_chw)
        return result.reshape(channels, planes, h, w)

    @staticmethod
    def backward(ctx: Any, gradient_cdhw: Tensor) -> tuple[Tensor | None, ...]:
        """Gradients of the reference and of the sources: 2 / N times a feature's distance from the views' mean."""
        reference_chw, *rest = ctx.saved_tensors
        grids, sources = rest[: len(rest) // 2], rest[len(rest) // 2 :]
        channels, planes = gradient_cdhw.shape[:2]
        views = len(sources) + 1
        reference = reference_chw.reshape(channels, 1, -1)
        gradient = gradient_cdhw.reshape(channels, planes, -1)
        of_reference = torch.zeros_like(reference)
        of_sources = [torch.zeros_like(source)[None] for source in sources]
        for chunk in _chunks(planes, reference_chw):
            all_warped = [_sample(source, grid[chunk])[0] for source, grid in zip(sources, grids, strict=True)]
            mean = all_warped[0] + reference
            for warped in all_warped[1:]:
                mean += warped
            mean /= views
            part = gradient[:, chunk] * (2 / views)
            of_reference += ((reference - mean) * part).sum(dim=1, keepdim=True)
            for of_source, source, grid, warped in zip(of_sources, sources, grids, all_warped, strict=True):
                of_source += _sample_backward(warped.sub_(mean).mul_(part)[None], source, grid[chunk])
        return of_reference.reshape_as(reference_chw), None, *(of_source[0] for of_source in of_sources)


def correlation(reference_chw: Tensor, warped_cdhw: Tensor, groups: int) -> Tensor:
    """Group-wise correlation (Guo et al. 2019, GwcNet): mean product per group, (D, G, h, w)."""
    channels, planes, h, w = warped_cdhw.shape
    product = (reference_chw[:, None] * warped_cdhw).reshape(groups, channels // groups, planes, h, w)
    return product.mean(dim=1).transpose(0, 1)


class GroupCorrelation(torch.autograd.Function):
    """:func:`correlation` of a warped source without the warped volume: planes in chunks that stay in the cache.

    Written out, the (C, D, h, w) product and its gradients go through memory six times and take half of a training
    step on a CPU. Here a chunk is sampled, multiplied and summed at once, and sampled again for the gradient.
    """

    @staticmethod
    def forward(
        ctx: Any, reference_chw: Tensor, source_chw: Tensor, x_dhw: Tensor, y_dhw: Tensor, groups: int
    ) -> Tensor:
        """(C, h, w), (C, Hs, Ws), source coordinates (D, h, w) twice → (D, G, h, w)."""
        channels, h, w = reference_chw.shape
        planes = x_dhw.shape[0]
        reference = reference_chw.reshape(groups, channels // groups, 1, h * w)
        grid = _normalized(x_dhw, y_dhw, source_chw)
        result = reference_chw.new_empty(planes, groups, h * w)
        for chunk in _chunks(planes, reference_chw):
            warped = _sample(source_chw, grid[chunk]).reshape(groups, channels // groups, -1, h * w)
            result[chunk] = (warped * reference).mean(dim=1).transpose(0, 1)
        ctx.save_for_backward(reference_chw, source_chw, grid)
        return result.reshape(planes, groups, h, w)

    @staticmethod
    def backward(ctx: Any, gradient_dghw: Tensor) -> tuple[Tensor, Tensor, None, None, None]:
        """Gradients of the reference and of the source features."""
        reference_chw, source_chw, grid = ctx.saved_tensors
        channels, h, w = reference_chw.shape
        planes, groups = gradient_dghw.shape[:2]
        reference = reference_chw.reshape(groups, channels // groups, 1, h * w)
        gradient = gradient_dghw.reshape(planes, groups, 1, h * w).permute(1, 2, 0, 3) * (groups / channels)
        of_reference = torch.zeros_like(reference)
        of_source = torch.zeros_like(source_chw)[None]
        for chunk in _chunks(planes, reference_chw):
            part = gradient[:, :, chunk]
            warped = _sample(source_chw, grid[chunk]).reshape(groups, channels // groups, -1, h * w)
            of_reference += (warped * part).sum(dim=2, keepdim=True)
            of_warped = (part * reference).reshape(1, channels, -1, h * w)
            of_source += _sample_backward(of_warped, source_chw, grid[chunk])
        return of_reference.reshape(channels, h, w), of_source[0], None, None, None


def _normalized(x_dhw: Tensor, y_dhw: Tensor, source_chw: Tensor) -> Tensor:
    """Source pixel coordinates in -1 … 1, (D, h*w, 2), as grid_sample wants them with aligned corners."""
    height, width = source_chw.shape[1:]
    grid = torch.stack([x_dhw * (2 / (width - 1)) - 1, y_dhw * (2 / (height - 1)) - 1], dim=-1)
    return grid.reshape(x_dhw.shape[0], -1, 2)


def _sample(source_chw: Tensor, grid_dp2: Tensor) -> Tensor:
    return F.grid_sample(source_chw[None], grid_dp2[None], mode="bilinear", padding_mode="zeros", align_corners=True)


def _sample_backward(of_sampled: Tensor, source_chw: Tensor, grid_dp2: Tensor) -> Tensor:
    """Gradient of the source (1, C, Hs, Ws) from that of what :func:`_sample` gave."""
    found = torch.ops.aten.grid_sampler_2d_backward(
        of_sampled, source_chw[None], grid_dp2[None], 0, 0, True, [True, False]
    )
    return torch.as_tensor(found[0])


def _chunks(planes: int, reference_chw: Tensor) -> list[slice]:
    size = planes if reference_chw.is_cuda else max(1, CHUNK_BYTES // (4 * reference_chw.numel()))
    return [slice(start, start + size) for start in range(0, planes, size)]


def correlation_volume(
    reference_chw: Tensor,
    sources: list[Tensor],
    a: Tensor,
    b: Tensor,
    inverse_depth_dhw: Tensor,
    origin_xy: tuple[int, int],
    groups: int,
    view_weights: Tensor | None = None,
) -> tuple[Tensor, Tensor]:
    """Weighted mean of the sources' correlations, (D, G, h, w), and the weights (S, h, w).

    Without ``view_weights`` a source's weight at a pixel is the peak of the softmax over depth of its summed
    correlation: a view that sees the point clearly has one sharp peak, an occluded or blurred one has none.
    """
    summed: Tensor | None = None
    weight_sum: Tensor | None = None
    weights = []
    for i, source in enumerate(sources):
        x, y = project(a[i], b[i], inverse_depth_dhw, origin_xy)
        corr = torch.as_tensor(GroupCorrelation.apply(reference_chw, source, x, y, groups))  # type: ignore[no-untyped-call]
        weight = torch.softmax(corr.sum(dim=1), dim=0).amax(dim=0) if view_weights is None else view_weights[i]
        weights.append(weight)
        summed = corr * weight if summed is None else summed + corr * weight
        weight_sum = weight if weight_sum is None else weight_sum + weight
    if summed is None or weight_sum is None:
        msg = "a cost volume needs at least one source view"
        raise ValueError(msg)
    return summed / (weight_sum + 1e-6), torch.stack(weights)
