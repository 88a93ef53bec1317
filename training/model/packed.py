"""The fast regularizers: a volume packed into slabs of planes, pure 2D convolution over slabs.

``k`` adjacent planes of ``G`` groups become ``k * G`` channels of one slab; the ``192 / k`` slabs are the batch.
Depth is mixed inside a slab by every convolution, and between slabs by concatenating a slab with its two neighbours
at half resolution and below.
"""

from __future__ import annotations

from typing import cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from training.model.attention import SqueezeExcitation
from training.model.backbone import conv_bn_relu, upsample_like
from training.model.between import Between


def pack(volume_dghw: Tensor, planes: int) -> Tensor:
    """(D, G, h, w) → (D / planes, planes * G, h, w)."""
    depth, groups, h, w = volume_dghw.shape
    return volume_dghw.reshape(depth // planes, planes * groups, h, w)


def with_neighbours(slabs_schw: Tensor) -> Tensor:
    """Concatenate each slab with the one before and the one after it: (S, 3C, h, w); the ends repeat."""
    before = torch.cat([slabs_schw[:1], slabs_schw[:-1]])
    after = torch.cat([slabs_schw[1:], slabs_schw[-1:]])
    return torch.cat([before, slabs_schw, after], dim=1)


class DepthMix(nn.Module):
    """3x3 convolution over a slab and its two neighbours, BN, ReLU."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.conv = conv_bn_relu(3 * channels, channels)

    def forward(self, slabs_schw: Tensor) -> Tensor:
        """(S, C, h, w) → (S, C, h, w)."""
        return torch.as_tensor(self.conv(with_neighbours(slabs_schw)))


class PackedRegularizer(nn.Module):
    """(S, k*G, h, w) slabs of ONE volume → (S*k, h, w) plane scores."""

    def __init__(self, *, groups: int, packed_planes: int, width: int, se: bool) -> None:
        super().__init__()
        inputs, w = groups * packed_planes, width
        self.enter = nn.Sequential(conv_bn_relu(inputs, w, stride=2), DepthMix(w))
        self.down1 = nn.Sequential(conv_bn_relu(w, 3 * w // 2, stride=2), DepthMix(3 * w // 2))
        self.down2 = nn.Sequential(conv_bn_relu(3 * w // 2, 2 * w, stride=2), DepthMix(2 * w), DepthMix(2 * w))
        self.se = nn.ModuleList([SqueezeExcitation(c) for c in (w, 3 * w // 2, 2 * w)] if se else [])
        self.reduce1, self.up1 = nn.Conv2d(2 * w, 3 * w // 2, 1), DepthMix(3 * w // 2)
        self.reduce0, self.up0 = nn.Conv2d(3 * w // 2, w, 1), DepthMix(w)
        self.head = nn.Conv2d(w, 4 * packed_planes, 3, padding=1)
        self.residual = nn.Conv2d(inputs, packed_planes, 1)

    def forward(self, slabs_schw: Tensor) -> Tensor:
        """Return the scores of all planes."""
        c0 = self.excite(0, self.enter(slabs_schw))
        c1 = self.excite(1, self.down1(c0))
        c2 = self.excite(2, self.down2(c1))
        u1 = self.up1(c1 + upsample_like(self.reduce1(c2), c1))
        u0 = self.up0(c0 + upsample_like(self.reduce0(u1), c0))
        fine = F.pixel_shuffle(self.head(u0), 2)[..., : slabs_schw.shape[-2], : slabs_schw.shape[-1]]
        return torch.as_tensor((fine + self.residual(slabs_schw)).flatten(0, 1))

    def excite(self, level: int, slabs_schw: Tensor) -> Tensor:
        """Squeeze-and-excitation of a level over all slabs of the volume, where the network has it."""
        return self.excitation(level).over_slabs(slabs_schw) if len(self.se) else slabs_schw

    def excitation(self, level: int) -> SqueezeExcitation:
        """Squeeze-and-excitation of a level; the list of modules knows them as modules only."""
        return cast(SqueezeExcitation, self.se[level])


class Refiner(nn.Module):
    """Scores of a narrow half-resolution volume, pure 2D: all its planes are one slab.

    forward: volume (L*G, h, w) of the hypotheses that are looked up, reference features (R, h, w) → scores (D, h, w) of
    all. ``looked_up`` and ``planes`` are those of each of the ``sets`` of evenly spaced hypotheses.
    """

    def __init__(
        self, *, planes: int, looked_up: int, groups: int, features: int, sets: int = 1, width: int = 32
    ) -> None:
        super().__init__()
        self.groups = groups
        self.between = Between(count=planes, looked_up=looked_up, sets=sets)
        scores = sets * planes
        inputs = scores * groups
        self.enter = nn.Sequential(conv_bn_relu(inputs + features, width), conv_bn_relu(width, width))
        self.down = nn.Sequential(
            conv_bn_relu(width, 3 * width // 2, stride=2), conv_bn_relu(3 * width // 2, 3 * width // 2)
        )
        self.down2 = nn.Sequential(
            conv_bn_relu(3 * width // 2, 2 * width, stride=2), conv_bn_relu(2 * width, 2 * width)
        )
        self.reduce2 = nn.Conv2d(2 * width, 3 * width // 2, 1)
        self.up = conv_bn_relu(3 * width // 2, 3 * width // 2)
        self.reduce = nn.Conv2d(3 * width // 2, width, 1)
        self.leave = nn.Sequential(conv_bn_relu(width, width), nn.Conv2d(width, scores, 3, padding=1))
        self.residual = nn.Conv2d(inputs, scores, 1)

    def forward(self, volume_chw: Tensor, features_chw: Tensor) -> Tensor:
        """Return the scores of the narrow volume's planes."""
        volume = self.between(volume_chw)[None]
        c0 = self.enter(torch.cat([volume, features_chw[None]], dim=1))
        c1 = self.down(c0)
        c2 = self.down2(c1)
        u1 = self.up(c1 + upsample_like(self.reduce2(c2), c1))
        u0 = c0 + upsample_like(self.reduce(u1), c0)
        return torch.as_tensor(self.leave(u0) + self.residual(volume))[0]
