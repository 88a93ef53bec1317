"""Losses: the paper's hybrid loss, smooth L1 alone (MVSNet), and cross-entropy over planes (``field``).

All are computed in units of plane intervals, so that a scene's scale and depth range do not weigh.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from training.model.config import ModelConfig
from training.model.fsmvsnet import DepthOutput, ScaleOutput

#: Planes; beyond it L1 is the business of the cross-entropy. Source: the radius of the local soft-argmin.
SUBPLANE_LIMIT = 3.0
#: Step from one pixel to the next, as a share of the depth, that counts as a whole edge. Source: judgement.
EDGE_GRADIENT = 0.05


def at_stride(depth_hw: Tensor, stride: int) -> Tensor:
    """Depth map of the full image at every ``stride``-th pixel (pixel i of the level is pixel ``stride * i``)."""
    return depth_hw[::stride, ::stride]


def target_index(truth_hw: Tensor, inverse_depth_dhw: Tensor) -> tuple[Tensor, Tensor]:
    """Fractional plane index of the true depth and the mask of pixels whose truth lies between the planes."""
    inverse = 1 / truth_hw.clamp_min(1e-6)
    planes = inverse_depth_dhw.shape[0]
    first, last = inverse_depth_dhw[0], inverse_depth_dhw[-1]
    ratio = (inverse_depth_dhw[1] - first) / (last - first)
    uniform_in_inverse = torch.isclose(ratio.mean(), torch.tensor(1 / (planes - 1), device=ratio.device), rtol=1e-2)
    if uniform_in_inverse:
        index = (inverse - first) / (last - first) * (planes - 1)
    else:
        index = (truth_hw - 1 / first) / (1 / last - 1 / first) * (planes - 1)
    mask = (truth_hw > 0) & (index >= 0) & (index <= planes - 1)
    return index, mask


def cross_entropy_two_bins(scores_dhw: Tensor, index_hw: Tensor, mask: Tensor) -> Tensor:
    """Cross-entropy against a label split linearly between the two planes that enclose the truth."""
    planes = scores_dhw.shape[0]
    log_probability = torch.log_softmax(scores_dhw, dim=0)
    index = index_hw.clamp(0, planes - 1)
    low = index.floor().clamp(max=planes - 2).long()
    share = index - low
    picked = log_probability.gather(0, torch.stack([low, low + 1]))
    loss = -(picked[0] * (1 - share) + picked[1] * share)
    return (loss * mask).sum() / mask.sum().clamp_min(1)


def cross_entropy_candidates(scores_dhw: Tensor, away_dhw: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
    """Cross-entropy against the candidates within a plane of the truth, by how near they are; and where there are any.

    ``away_dhw`` is the distance of each candidate from the truth in planes. Several candidates may be of one plane:
    the label is shared among them.
    """
    share = (1 - away_dhw).clamp_min(0)
    total = share.sum(dim=0)
    mask = mask & (total > 0.05)
    loss = -(share / total.clamp_min(0.05) * torch.log_softmax(scores_dhw, dim=0)).sum(dim=0)
    return (loss * mask).sum() / mask.sum().clamp_min(1), mask


def plane_loss(output: DepthOutput, truths: dict[int, Tensor]) -> tuple[Tensor, dict[str, float]]:
    """Cross-entropy plus L1 below the plane, at the 192-plane volume and at the refinement."""
    total = torch.zeros((), device=output.depth.device)
    parts = {}
    for scale in output.scales:
        truth = truths[scale.stride]
        index, mask = target_index(truth, scale.inverse_depth_dhw)
        if scale.candidates_dhw is None:
            entropy = cross_entropy_two_bins(scale.scores_dhw, index, mask)
        else:
            away = (scale.candidates_dhw - index).abs()
            entropy, mask = cross_entropy_candidates(scale.scores_dhw, away, mask)
        error = (scale.index_hw - index).abs()
        near = mask & (error.detach() < SUBPLANE_LIMIT)
        below = (error * near).sum() / near.sum().clamp_min(1)
        total = total + entropy + below
        parts[f"ce{scale.stride}"], parts[f"sub{scale.stride}"] = float(entropy.detach()), float(below.detach())
    return total, parts


def _smooth_l1(scale: ScaleOutput, truth: Tensor, weight: Tensor | None = None) -> Tensor:
    index, mask = target_index(truth, scale.inverse_depth_dhw)
    loss = F.smooth_l1_loss(scale.index_hw, index, reduction="none")
    if weight is not None:
        loss = loss * weight
    return (loss * mask).sum() / mask.sum().clamp_min(1)


def edge_attention(truth_hw: Tensor) -> Tensor:
    """A_p of the paper from the magnitude of the depth gradient, (h, w) in [0, 1]: 0 on a wall, 1 at an edge.

    The gradient is relative to the depth, and whole from :data:`EDGE_GRADIENT` on. Towards pixels whose depth is not
    known (0) there is none.
    """
    padded = F.pad(truth_hw[None, None], (0, 1, 0, 1), mode="replicate")[0, 0]
    known = (truth_hw > 0).to(truth_hw.dtype)
    gradient = torch.zeros_like(truth_hw)
    for beside in (padded[:-1, 1:], padded[1:, :-1]):
        gradient = gradient + (beside - truth_hw).abs() * known * (beside > 0)
    relative = gradient / truth_hw.clamp_min(1e-6)
    return (relative / EDGE_GRADIENT).clamp(0, 1)


def scale_weights(count: int, first_scale: str) -> list[float]:
    """w_s = 1 / 2^(s-1) of each of ``count`` scales, the coarsest first as in :attr:`DepthOutput.scales`.

    ``first_scale``: see :class:`training.model.ModelConfig`.
    """
    weights = [0.5**rank for rank in range(count)]
    return weights if first_scale == "coarsest" else weights[::-1]


def hybrid_loss(output: DepthOutput, truths: dict[int, Tensor], config: ModelConfig) -> tuple[Tensor, dict[str, float]]:
    """L = 1 L_smooth + 0.5 L_multiscale + 0.2 L_attention with w_s = 1 / 2^(s-1) (paper, section 2.3.1)."""
    finest = output.scales[-1]
    smooth = _smooth_l1(finest, truths[finest.stride])
    if config.loss == "smooth":
        return smooth, {"smooth": float(smooth.detach())}
    multiscale = torch.zeros_like(smooth)
    weights = scale_weights(len(output.scales), config.first_scale)
    for weight, scale in zip(weights, output.scales, strict=True):
        multiscale = multiscale + weight * _smooth_l1(scale, truths[scale.stride])
    attention = _smooth_l1(finest, truths[finest.stride], edge_attention(truths[finest.stride]))
    total = config.lambda_smooth * smooth + config.lambda_multiscale * multiscale + config.lambda_attention * attention
    parts = {"smooth": smooth, "multiscale": multiscale, "attention": attention}
    return total, {name: float(value.detach()) for name, value in parts.items()}


def compute_loss(
    output: DepthOutput, truth: Tensor, window: tuple[int, int, int, int] | None, config: ModelConfig
) -> tuple[Tensor, dict[str, float]]:
    """Loss of one view. ``truth`` is the full-size depth map; ``window`` (x, y, width, height) at a quarter of it."""
    truths = {}
    x, y = (0, 0) if window is None else (4 * window[0], 4 * window[1])
    # Levels are counted from the window's corner, which may lie between the pixels of the whole view's coarse level.
    part = truth[y:, x:]
    for scale in output.scales:
        height, width = scale.index_hw.shape
        truths[scale.stride] = at_stride(part, scale.stride)[:height, :width]
    if config.loss == "plane":
        return plane_loss(output, truths)
    return hybrid_loss(output, truths, config)
