"""Squeeze-and-excitation (Hu et al. 2018) over a cost volume, reduction r = 16 as in the paper."""

from __future__ import annotations

import torch
from torch import Tensor, nn

#: r of the paper: the hidden layer has C / r values. Source: FS-MVSNet, Forests 2025, 16, 927; Hu et al. 2018.
REDUCTION = 16
#: Values that the hidden layer has at least: with fewer than 32 channels C / r is one or none, through which nothing
#: but a single gain could pass. The paper's 32 channels do not need it; ``field`` has 32, 48 and 64. Source: judgement.
LEAST_HIDDEN = 2


class SqueezeExcitation(nn.Module):
    """Mean over depth, height and width → FC (C/r) → ReLU → FC → sigmoid → scale the channels.

    The hidden layer has ``max(channels // reduction, LEAST_HIDDEN)`` values.
    """

    def __init__(self, channels: int, reduction: int = REDUCTION) -> None:
        super().__init__()
        self.channels = channels
        hidden = max(channels // reduction, LEAST_HIDDEN)
        self.fc = nn.Sequential(nn.Linear(channels, hidden), nn.ReLU(), nn.Linear(hidden, channels), nn.Sigmoid())

    def forward(self, volume: Tensor) -> Tensor:
        """(B, C, ...) volume, or (S, C, H, W) slabs of one volume when ``over_slabs`` is used by the caller."""
        weights = self.fc(volume.flatten(2).mean(dim=2))
        return torch.as_tensor(volume * weights.reshape(*weights.shape, *([1] * (volume.dim() - 2))))

    def over_slabs(self, slabs_schw: Tensor) -> Tensor:
        """Scale slabs of ONE volume by weights from the mean over all of them: (S, C, H, W)."""
        return self.by_mean(slabs_schw, slabs_schw.mean(dim=(0, 2, 3)))

    def by_mean(self, slabs_schw: Tensor, mean_c: Tensor) -> Tensor:
        """Scale slabs of a volume, or of a part of one, by weights from the mean (C,) over the whole."""
        return torch.as_tensor(slabs_schw * self.fc(mean_c[None])[..., None, None])
