"""The faithful regularizer: MVSNet's 3D U-Net, with squeeze-and-excitation of the cost volume, and multi-scale heads.

Voxel (k, i, j) of a level with stride s lies at voxel (s*k, s*i, s*j) of the volume: 3x3x3 kernels with stride 2 and
padding 1 are centred on even voxels, and what comes up again is put back there. So plane k of a coarse scale is plane
s*k of the 192, and nothing moves towards the camera or to the side on its way through the levels.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from training.model.attention import SqueezeExcitation


def _conv3d(inputs: int, outputs: int, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv3d(inputs, outputs, 3, stride=stride, padding=1, bias=False),
        nn.BatchNorm3d(outputs),
        nn.ReLU(inplace=True),
    )


def upsample_voxels_like(coarse_ncdhw: Tensor, fine_ncdhw: Tensor) -> Tensor:
    """Trilinear upsampling that keeps voxel i of the coarse level at voxel 2i of the fine one, in all three directions.

    ``align_corners`` places the end points: the coarse level is extended by one repeated voxel, upsampled to exactly
    twice plus one, and cropped to the fine level's size, which may be odd. (Without it interpolation takes voxels for
    cells that share out the same length, and puts coarse voxel i at 2i + 0.5.)
    """
    depth, height, width = coarse_ncdhw.shape[2:]
    extended = F.pad(coarse_ncdhw, (0, 1, 0, 1, 0, 1), mode="replicate")
    size = (2 * depth + 1, 2 * height + 1, 2 * width + 1)
    doubled = F.interpolate(extended, size=size, mode="trilinear", align_corners=True)
    planes, rows, columns = fine_ncdhw.shape[2:]
    return doubled[:, :, :planes, :rows, :columns]


class Regularizer3D(nn.Module):
    """(1, C, D, h, w) cost volume → scores of the planes at scales 1, 2 and 4, each (1, D/s, h/s, w/s).

    Score is the logit of the plane (a low cost gives a high score). Odd sizes are handled by trilinear resizing to
    the skip connection's size instead of a transposed convolution's fixed factor.
    """

    def __init__(self, channels: int, width: int, *, se: bool) -> None:
        super().__init__()
        w = width
        self.se = SqueezeExcitation(channels) if se else None
        self.enter = _conv3d(channels, w)
        self.down1 = nn.Sequential(_conv3d(w, 2 * w, 2), _conv3d(2 * w, 2 * w))
        self.down2 = nn.Sequential(_conv3d(2 * w, 4 * w, 2), _conv3d(4 * w, 4 * w))
        self.down3 = nn.Sequential(_conv3d(4 * w, 8 * w, 2), _conv3d(8 * w, 8 * w))
        self.up2 = _conv3d(8 * w, 4 * w)
        self.up1 = _conv3d(4 * w, 2 * w)
        self.up0 = _conv3d(2 * w, w)
        self.heads = nn.ModuleList([nn.Conv3d(c, 1, 3, padding=1) for c in (w, 2 * w, 4 * w)])

    def forward(self, volume_bcdhw: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return the scores at scales 1, 2, 4."""
        u0, u1, u2 = self.levels(self.enter(volume_bcdhw if self.se is None else self.se(volume_bcdhw)))
        return self.heads[0](u0)[:, 0], self.heads[1](u1)[:, 0], self.heads[2](u2)[:, 0]

    def levels(self, entered_bcdhw: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """From what :attr:`enter` gives, (1, w, D, h, w), to what the three heads read, finest first."""
        c1 = self.down1(entered_bcdhw)
        c2 = self.down2(c1)
        c3 = self.down3(c2)
        u2 = c2 + upsample_voxels_like(self.up2(c3), c2)
        u1 = c1 + upsample_voxels_like(self.up1(u2), c1)
        return torch.as_tensor(entered_bcdhw + upsample_voxels_like(self.up0(u1), entered_bcdhw)), u1, u2
