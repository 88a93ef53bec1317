"""The faithful 3D regularizer as it is exported: without a second copy of the cost volume.

Squeeze-and-excitation multiplies each channel of the volume by a gain; the first convolution that follows is linear, so
its weights are multiplied instead. At 1280x720 the volume of ``paper`` takes 1.4 GB, and the copy would as much again.
"""

from __future__ import annotations

import copy
from typing import cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from training.model.fsmvsnet import PlaneHead
from training.model.regularizer3d import Regularizer3D


class VolumeHead(nn.Module):
    """:class:`PlaneHead` of a :class:`Regularizer3D` with folded batch norms, to the same result.

    forward: volume (1, C, D, h, w) → index and confidence (h, w).
    """

    def __init__(self, head: PlaneHead) -> None:
        super().__init__()
        regularizer = head.regularizer
        if not isinstance(regularizer, Regularizer3D):
            msg = "the volume head is for 3D regularizers"
            raise TypeError(msg)
        self.head = copy.deepcopy(head)

    def forward(self, volume: Tensor) -> tuple[Tensor, Tensor]:
        """Return index and confidence."""
        # One direction after the other: a sum of ten million values in float32 would lose digits.
        return self.read(volume, volume.mean(dim=4).mean(dim=3).mean(dim=2)[0])

    def read(self, volume: Tensor, volume_mean: Tensor) -> tuple[Tensor, Tensor]:
        """Return index and confidence; ``volume_mean`` (C,) is that of each channel over the whole volume."""
        net = cast(Regularizer3D, self.head.regularizer)
        enter = cast(nn.Conv3d, net.enter[0])
        weight: Tensor = enter.weight
        if net.se is not None:
            weight = weight * net.se.fc(volume_mean[None])[:, :, None, None, None]
        entered = torch.relu(F.conv3d(volume, weight, enter.bias, padding=1))
        finest, _, _ = net.levels(entered)
        return self.head.read(net.heads[0](finest)[0, 0])


class TileVolumeHead(VolumeHead):
    """:class:`VolumeHead` for a part of a volume: squeeze-and-excitation takes the means of the whole.

    forward: volume (1, C, D, h, w) of the part and its means (C,) over the whole volume → index and confidence (h, w).
    """

    def forward(self, volume: Tensor, volume_mean: Tensor) -> tuple[Tensor, Tensor]:  # type: ignore[override]
        """Return index and confidence."""
        return self.read(volume, volume_mean)
