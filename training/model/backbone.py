"""Feature networks: the bidirectional feature pyramid (B-FPN) of FS-MVSNet and the plain one of MVSNet.

Both keep pixel (i, j) of a level with stride s exactly at pixel (s*i, s*j) of the image (3x3 kernels with stride 2
and padding 1 are centred on even pixels), so that intrinsics scale by 1/s with no half-pixel shift.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn


def conv_bn_relu(inputs: int, outputs: int, *, stride: int = 1, kernel: int = 3) -> nn.Sequential:
    """3x3 (or ``kernel``) convolution, batch normalization, ReLU."""
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, kernel, stride=stride, padding=kernel // 2, bias=False),
        nn.BatchNorm2d(outputs),
        nn.ReLU(inplace=True),
    )


def upsample_like(coarse_nchw: Tensor, fine_nchw: Tensor) -> Tensor:
    """Bilinear upsampling that keeps pixel i of the coarse level at pixel 2i of the fine one.

    Zero-pads nothing and needs no sizes known at export: ``align_corners`` places the end points, and levels
    made by stride 2 have ``ceil`` sizes, so the coarse level is first extended by one replicated row and column,
    upsampled to exactly twice minus one, and cropped.
    """
    height, width = coarse_nchw.shape[-2:]
    extended = F.pad(coarse_nchw, (0, 1, 0, 1), mode="replicate")
    doubled = F.interpolate(extended, size=(2 * height + 1, 2 * width + 1), mode="bilinear", align_corners=True)
    return doubled[..., : fine_nchw.shape[-2], : fine_nchw.shape[-1]]


class BFPN(nn.Module):
    """Bidirectional feature pyramid (paper, section 2.3): {P5..P2} at 1/32 … 1/4, top-down, then bottom-up.

    Three-layer stages of 3x3 conv, BN, ReLU; top-down: bilinear upsampling and addition; bottom-up: 3x3
    convolution with stride 2 and addition; a 1x1 convolution after each fusion.

    forward: (N, 3, H, W) with H, W multiples of 32 → quarter-resolution features (N, F, H/4, W/4) and
    half-resolution features (N, R, H/2, W/2) for the refinement (``None`` when ``refine_channels`` is 0).
    """

    def __init__(self, *, base: int, channels: int, refine_channels: int) -> None:
        super().__init__()
        widths = [2 * base, 3 * base, 4 * base, 4 * base]  # at 1/4, 1/8, 1/16, 1/32
        lateral = 2 * base
        self.stem = nn.Sequential(conv_bn_relu(3, base, stride=2), conv_bn_relu(base, base))
        previous = base
        stages = []
        for width in widths:
            stages.append(
                nn.Sequential(
                    conv_bn_relu(previous, width, stride=2), conv_bn_relu(width, width), conv_bn_relu(width, width)
                )
            )
            previous = width
        self.stages = nn.ModuleList(stages)
        self.lateral = nn.ModuleList(nn.Conv2d(width, lateral, 1) for width in widths)
        self.after_top_down = nn.ModuleList(nn.Conv2d(lateral, lateral, 1) for _ in widths[:-1])
        self.down = nn.ModuleList(nn.Conv2d(lateral, lateral, 3, stride=2, padding=1) for _ in widths[:-1])
        self.after_bottom_up = nn.ModuleList(nn.Conv2d(lateral, lateral, 1) for _ in widths[:-1])
        self.merge = nn.ModuleList(nn.Conv2d(lateral, lateral, 1) for _ in widths[:-1])
        self.output = nn.Sequential(conv_bn_relu(lateral, lateral), nn.Conv2d(lateral, channels, 3, padding=1))
        self.refine: nn.Module | None = None
        if refine_channels:
            self.refine_lateral = nn.Conv2d(lateral, base, 1)
            self.refine = nn.Sequential(conv_bn_relu(base, base), nn.Conv2d(base, refine_channels, 3, padding=1))

    def forward(self, images_nchw: Tensor) -> tuple[Tensor, Tensor | None]:
        """Return quarter- and half-resolution features."""
        half = self.stem(images_nchw)
        level, levels = half, []
        for stage, lateral in zip(self.stages, self.lateral, strict=True):
            level = stage(level)
            levels.append(lateral(level))
        for i in (2, 1, 0):  # top-down
            levels[i] = self.after_top_down[i](levels[i] + upsample_like(levels[i + 1], levels[i]))
        for i in (0, 1, 2):  # bottom-up
            levels[i + 1] = self.after_bottom_up[i](levels[i + 1] + self.down[i](levels[i]))
        fused = levels[3]
        for i in (2, 1, 0):  # the cost volume lives at 1/4: bring the finished pyramid there
            fused = self.merge[i](levels[i] + upsample_like(fused, levels[i]))
        quarter = self.output(fused)
        if self.refine is None:
            return quarter, None
        return quarter, self.refine(half + upsample_like(self.refine_lateral(fused), half))


class PlainBackbone(nn.Module):
    """The feature network of MVSNet (Yao et al. 2018): eight layers, two of stride 2, F = 32 at 1/4."""

    def __init__(self, *, base: int, channels: int) -> None:
        super().__init__()
        b = base
        self.layers = nn.Sequential(
            conv_bn_relu(3, b),
            conv_bn_relu(b, b),
            conv_bn_relu(b, 2 * b, stride=2, kernel=5),
            conv_bn_relu(2 * b, 2 * b),
            conv_bn_relu(2 * b, 2 * b),
            conv_bn_relu(2 * b, 4 * b, stride=2, kernel=5),
            conv_bn_relu(4 * b, 4 * b),
            nn.Conv2d(4 * b, channels, 3, padding=1),
        )

    def forward(self, images_nchw: Tensor) -> tuple[Tensor, None]:
        """(N, 3, H, W) → (N, F, H/4, W/4), no refinement features."""
        return torch.as_tensor(self.layers(images_nchw)), None
