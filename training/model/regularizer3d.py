"""The faithful regularizer: MVSNet's 3D U-Net, with squeeze-and-excitation, and multi-scale heads."""

from __future__ import annotations

import torch.nn.functional as F
from torch import Tensor, nn

from training.model.attention import SqueezeExcitation


def _conv3d(inputs: int, outputs: int, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv3d(inputs, outputs, 3, stride=stride, padding=1, bias=False),
        nn.BatchNorm3d(outputs),
        nn.ReLU(inplace=True),
    )


class Regularizer3D(nn.Module):
    """(1, C, D, h, w) cost volume → scores of the planes at scales 1, 2 and 4, each (1, D/s, h/s, w/s).

    Score is the logit of the plane (a low cost gives a high score). Odd sizes are handled by trilinear resizing to
    the skip connection's size instead of a transposed convolution's fixed factor.
    """

    def __init__(self, channels: int, width: int, *, se: bool) -> None:
        super().__init__()
        w = width
        self.enter = _conv3d(channels, w)
        self.down1 = nn.Sequential(_conv3d(w, 2 * w, 2), _conv3d(2 * w, 2 * w))
        self.down2 = nn.Sequential(_conv3d(2 * w, 4 * w, 2), _conv3d(4 * w, 4 * w))
        self.down3 = nn.Sequential(_conv3d(4 * w, 8 * w, 2), _conv3d(8 * w, 8 * w))
        self.se = nn.ModuleList([SqueezeExcitation(c) if se else nn.Identity() for c in (w, 2 * w, 4 * w, 8 * w)])
        self.up2 = _conv3d(8 * w, 4 * w)
        self.up1 = _conv3d(4 * w, 2 * w)
        self.up0 = _conv3d(2 * w, w)
        self.heads = nn.ModuleList([nn.Conv3d(c, 1, 3, padding=1) for c in (w, 2 * w, 4 * w)])

    def forward(self, volume_bcdhw: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return the scores at scales 1, 2, 4."""
        c0 = self.se[0](self.enter(volume_bcdhw))
        c1 = self.se[1](self.down1(c0))
        c2 = self.se[2](self.down2(c1))
        c3 = self.se[3](self.down3(c2))
        u2 = c2 + self._up(self.up2, c3, c2)
        u1 = c1 + self._up(self.up1, u2, c1)
        u0 = c0 + self._up(self.up0, u1, c0)
        return self.heads[0](u0)[:, 0], self.heads[1](u1)[:, 0], self.heads[2](u2)[:, 0]

    @staticmethod
    def _up(conv: nn.Module, coarse: Tensor, fine: Tensor) -> Tensor:
        return F.interpolate(conv(coarse), size=fine.shape[2:], mode="trilinear", align_corners=False)
