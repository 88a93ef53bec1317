"""From plane scores to depth: soft-argmin, local soft-argmin, confidence."""

from __future__ import annotations

import torch
from torch import Tensor

from training.model.backbone import upsample_like


def soft_argmin(probability_dhw: Tensor, values: Tensor) -> Tensor:
    """Expectation over all planes (MVSNet, eq. 3); ``values`` (D,) or (D, h, w)."""
    if values.dim() == 1:
        values = values[:, None, None]
    return (probability_dhw * values).sum(dim=0)


def peak_window(probability_dhw: Tensor, radius: int) -> tuple[Tensor, Tensor]:
    """Sub-plane index and probability mass of the window around the best plane.

    Soft-argmin over all planes falls between two surfaces where the distribution has two peaks, that is, at
    every silhouette; the window of ``2 radius + 1`` planes round the best one does not.

    Returns
    -------
    index: (h, w) float, in planes. mass: (h, w) in [0, 1].
    """
    planes = probability_dhw.shape[0]
    best = probability_dhw.detach().argmax(dim=0)
    start = (best - radius).clamp(0, planes - 1 - 2 * radius)
    offsets = torch.arange(2 * radius + 1, device=best.device)
    window = start[None] + offsets[:, None, None]
    inside = torch.gather(probability_dhw, 0, window)
    mass = inside.sum(dim=0)
    index = (inside * window).sum(dim=0) / (mass + 1e-6)
    return index, mass


def upsample_index(index_hw: Tensor, height: int, width: int) -> Tensor:
    """Plane index at twice the resolution: bilinear, but a neighbour's value across a step.

    Between two surfaces the bilinear value lies on neither; wherever it differs from the nearest value by more than
    one plane the nearest one is kept, so that the narrow volume is centred on a real surface.
    """
    bilinear = upsample_like(index_hw[None, None], torch.empty(height, width, device=index_hw.device))[0, 0]
    nearest = index_hw.repeat_interleave(2, dim=0).repeat_interleave(2, dim=1)[:height, :width]
    return torch.where((bilinear - nearest).abs() > 1, nearest, bilinear)
