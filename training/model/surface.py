"""Whether a depth is that of the surface which its pixel shows: the network, see :mod:`fsinfer.depth.surface`.

Trained on the depth maps of a network that is there already, by itself (``python -m training.surface``): what it gives
is a confidence, and the depth does not hang on it.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from fsinfer.depth.surface import AROUND, PARTS, STEP_PLANES
from training.model.backbone import conv_bn_relu, upsample_like


def surface_inputs(features_nchw: Tensor, index_nhw: Tensor, confidence_nhw: Tensor) -> Tensor:
    """(N, 4 C + 16, H/2, W/2) of maps of even size; :func:`fsinfer.depth.surface.surface_inputs`."""
    four = F.pixel_unshuffle(index_nhw[:, None], 2)
    mean = four.mean(dim=1, keepdim=True)
    height, width = mean.shape[-2:]
    wide = F.pad(mean, (1, 1, 1, 1), mode="replicate")[:, 0]
    beside = torch.stack(
        [wide[:, 1 + down : 1 + down + height, 1 + right : 1 + right + width] for down, right in AROUND], dim=1
    )
    steps = torch.tanh(torch.cat([four - mean, beside - mean], dim=1) / STEP_PLANES)
    return torch.cat([F.pixel_unshuffle(features_nchw, 2), steps, F.pixel_unshuffle(confidence_nhw[:, None], 2)], dim=1)


class SurfaceHead(nn.Module):
    """forward: (N, 4 C + 16, h, w) of :func:`surface_inputs` → logits (N, 4, h, w) of the four parts of the map."""

    def __init__(self, *, features: int, width: int) -> None:
        super().__init__()
        self.features, self.width = features, width
        wider = 3 * width // 2
        inputs = PARTS * (features + 2) + len(AROUND)
        self.enter = nn.Sequential(conv_bn_relu(inputs, width), conv_bn_relu(width, width))
        self.down = nn.Sequential(conv_bn_relu(width, wider, stride=2), conv_bn_relu(wider, wider))
        self.reduce = nn.Conv2d(wider, width, 1)
        self.leave = nn.Sequential(conv_bn_relu(width, width), nn.Conv2d(width, PARTS, 1))

    def forward(self, inputs_nchw: Tensor) -> Tensor:
        """Return the logits."""
        fine = self.enter(inputs_nchw)
        fine = fine + upsample_like(self.reduce(self.down(fine)), fine)
        return torch.as_tensor(self.leave(fine))
