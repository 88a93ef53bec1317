"""Cost volumes: variance over the views (MVSNet), and group correlation weighted by view."""

from __future__ import annotations

import torch
from torch import Tensor

from training.model.warping import warp


def plane_inverse_depths(depth_min: Tensor, depth_max: Tensor, planes: int, *, inverse: bool) -> Tensor:
    """(D,) 1/depth of the planes: uniform in 1/depth from far to near, or uniform in depth from near to far."""
    steps = torch.linspace(0, 1, planes, device=depth_min.device)
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
    planes = inverse_depth_dhw.shape[0]
    total = reference_chw[:, None].expand(-1, planes, -1, -1)
    squares = total.square()
    for i, source in enumerate(sources):
        warped = warp(source, a[i], b[i], inverse_depth_dhw, origin_xy)
        total, squares = total + warped, squares + warped.square()
    views = len(sources) + 1
    return squares / views - (total / views).square()


def correlation(reference_chw: Tensor, warped_cdhw: Tensor, groups: int) -> Tensor:
    """Group-wise correlation (Guo et al. 2019, GwcNet): mean product per group, (D, G, h, w)."""
    channels, planes, h, w = warped_cdhw.shape
    product = (reference_chw[:, None] * warped_cdhw).reshape(groups, channels // groups, planes, h, w)
    return product.mean(dim=1).transpose(0, 1)


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
        warped = warp(source, a[i], b[i], inverse_depth_dhw, origin_xy)
        corr = correlation(reference_chw, warped, groups)
        weight = torch.softmax(corr.sum(dim=1), dim=0).amax(dim=0) if view_weights is None else view_weights[i]
        weights.append(weight)
        summed = corr * weight if summed is None else summed + corr * weight
        weight_sum = weight if weight_sum is None else weight_sum + weight
    if summed is None or weight_sum is None:
        msg = "a cost volume needs at least one source view"
        raise ValueError(msg)
    return summed / (weight_sum + 1e-6), torch.stack(weights)
