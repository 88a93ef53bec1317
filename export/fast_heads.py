"""The packed regularizer and the refiner as they are exported: the same arithmetic in operators that a CPU runs fast.

What onnxruntime is slow at is moving data, not convolution. Against the modules of ``training.model``, to which the
tests hold these:

- The three slabs that a convolution mixes are gathered by one indexed copy instead of slices and concatenations.
- Scores stay at half the volume's resolution with four sub-pixels as an axis; only the finished index and confidence
  are interleaved. The 1x1 residual becomes a 2x2 convolution of stride 2 that gives the same four sub-pixels.
- The softmax over 192 planes is never written out: what is read off it needs its maximum, its sum, and the few planes
  round the best one.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import TypeVar

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from training.model.backbone import upsample_like
from training.model.candidates import READ_RADIUS, CandidateHead
from training.model.config import DEPTH_PLANES
from training.model.fsmvsnet import CONFIDENCE_RADIUS, REFINE_WINDOW_RADIUS, WINDOW_RADIUS, PlaneHead, RefineHead
from training.model.packed import DepthMix, PackedRegularizer

HeadT = TypeVar("HeadT", CandidateHead, RefineHead)


class GatheredMix(nn.Module):
    """:class:`DepthMix` with its three slabs gathered at once."""

    def __init__(self, mix: DepthMix, slabs: int) -> None:
        super().__init__()
        self.conv = mix.conv
        own = torch.arange(slabs)
        near = torch.stack([(own - 1).clamp(min=0), own, (own + 1).clamp(max=slabs - 1)], dim=1)
        self.register_buffer("near", near.flatten())

    def forward(self, slabs_schw: Tensor) -> Tensor:
        """(S, C, h, w) → (S, C, h, w)."""
        slabs, channels, height, width = slabs_schw.shape
        near = slabs_schw.index_select(0, torch.as_tensor(self.near))
        return torch.as_tensor(self.conv(near.reshape(slabs, 3 * channels, height, width)))


class SubPixels(nn.Module):
    """A 1x1 convolution that gives the four pixels of each 2x2 cell as channels, in the order of ``pixel_shuffle``.

    forward: (S, C, h, w) → (S, 4 * P, ceil(h / 2), ceil(w / 2)); what lies outside is that of zeros.
    """

    def __init__(self, conv: nn.Conv2d) -> None:
        super().__init__()
        outputs, inputs = conv.weight.shape[:2]
        kernel = torch.zeros(outputs, 2, 2, inputs, 2, 2)
        for down in range(2):
            for right in range(2):
                kernel[:, down, right, :, down, right] = conv.weight.detach()[:, :, 0, 0]
        self.conv = nn.Conv2d(inputs, 4 * outputs, 2, stride=2)
        self.conv.weight = nn.Parameter(kernel.reshape(4 * outputs, inputs, 2, 2))
        if conv.bias is None:
            self.conv.bias = None
        else:
            self.conv.bias = nn.Parameter(conv.bias.detach().repeat_interleave(4))

    def forward(self, slabs_schw: Tensor) -> Tensor:
        """Pad to an even size; where it is even already the last row and column of the padding are not read."""
        return torch.as_tensor(self.conv(F.pad(slabs_schw, (0, 1, 0, 1))))


def read_peak(scores_dhw: Tensor, index_radius: int, mass_radius: int) -> tuple[Tensor, Tensor]:
    """Sub-plane index of the window round the best plane and the probability mass of another such window.

    :func:`training.model.regression.peak_window` of the softmax, from the scores (D, ...) themselves.
    """
    planes = scores_dhw.shape[0]
    best = scores_dhw.argmax(dim=0, keepdim=True)
    # The scores less the greatest, which is at hand: every term of the softmax but for one factor.
    parts = torch.exp(scores_dhw - torch.gather(scores_dhw, 0, best))
    total = parts.sum(dim=0)

    def window(radius: int) -> tuple[Tensor, Tensor, Tensor]:
        start = (best[0] - radius).clamp(0, planes - 1 - 2 * radius)
        offsets = torch.arange(2 * radius + 1).reshape(-1, *[1] * start.dim())
        return start, offsets, torch.gather(parts, 0, start[None] + offsets)

    start, offsets, inside = window(index_radius)
    among = inside.sum(dim=0)
    # Planes are counted from the first of the window: its index is one map, those of all are as many as it has planes.
    index = (start * among + (inside * offsets).sum(dim=0)) / total / (among / total + 1e-6)
    if mass_radius != index_radius:
        among = window(mass_radius)[2].sum(dim=0)
    return index, among / total


def read_best(scores_dhw: Tensor, planes_dhw: Tensor) -> tuple[Tensor, Tensor]:
    """:func:`training.model.candidates.read_candidates` without a softmax, which turns all planes over."""
    place = scores_dhw.argmax(dim=0, keepdim=True)
    best = torch.gather(planes_dhw, 0, place)
    parts = torch.exp(scores_dhw - torch.gather(scores_dhw, 0, place))
    inside = parts * ((planes_dhw - best).abs() < READ_RADIUS)
    total = parts.sum(dim=0)
    mass = inside.sum(dim=0) / total
    return (inside * planes_dhw).sum(dim=0) / total / (mass + 1e-6), mass


class FastPlaneHead(nn.Module):
    """:class:`PlaneHead` of a packed regularizer, with the same weights.

    forward: volume (S, k*G, h, w) → index and confidence (h, w).
    """

    def __init__(self, head: PlaneHead) -> None:
        super().__init__()
        regularizer = copy.deepcopy(head.regularizer)
        if not isinstance(regularizer, PackedRegularizer) or head.config.loss != "plane":
            msg = "the fast head is for packed regularizers that read the depth off the best planes"
            raise TypeError(msg)
        slabs = DEPTH_PLANES // head.config.packed_planes
        for name, part in regularizer.named_children():
            if isinstance(part, DepthMix):
                setattr(regularizer, name, GatheredMix(part, slabs))
            elif isinstance(part, nn.Sequential):
                layers = [GatheredMix(layer, slabs) if isinstance(layer, DepthMix) else layer for layer in part]
                setattr(regularizer, name, nn.Sequential(*layers))
        self.regularizer = regularizer
        self.residual = SubPixels(regularizer.residual)

    def forward(self, volume: Tensor) -> tuple[Tensor, Tensor]:
        """Return index and confidence."""
        return self.read(volume, self.regularizer.excite)

    def read(self, volume: Tensor, excite: Callable[[int, Tensor], Tensor]) -> tuple[Tensor, Tensor]:
        """Return index and confidence; ``excite`` (level, slabs) scales the channels of a level."""
        net = self.regularizer
        c0 = excite(0, net.enter(volume))
        c1 = excite(1, net.down1(c0))
        c2 = excite(2, net.down2(c1))
        u1 = net.up1(c1 + upsample_like(net.reduce1(c2), c1))
        u0 = net.up0(c0 + upsample_like(net.reduce0(u1), c0))
        scores = net.head(u0) + self.residual(volume)
        _, _, rows, columns = scores.shape
        index, mass = read_peak(scores.reshape(DEPTH_PLANES, 4, rows, columns), WINDOW_RADIUS, CONFIDENCE_RADIUS)
        height, width = volume.shape[-2:]
        return tuple(F.pixel_shuffle(part[None], 2)[0, 0, :height, :width] for part in (index, mass))  # type: ignore[return-value]


class TilePlaneHead(FastPlaneHead):
    """:class:`FastPlaneHead` for a part of a volume: squeeze-and-excitation takes the means of the whole.

    forward: volume (S, k*G, h, w) of the part and the means (C_i,) of the three levels over the whole volume → index
    and confidence (h, w), and of each level the mean over its slabs (C_i, h / 2^(i+1), w / 2^(i+1)), from which the
    caller makes the mean of the whole for the next.
    """

    def forward(self, volume: Tensor, mean0: Tensor, mean1: Tensor, mean2: Tensor) -> tuple[Tensor, ...]:  # type: ignore[override]
        """Return index, confidence and the three levels."""
        levels: list[Tensor] = []

        def excite(level: int, slabs_schw: Tensor) -> Tensor:
            levels.append(slabs_schw.mean(dim=0))
            return self.regularizer.excitation(level).by_mean(slabs_schw, (mean0, mean1, mean2)[level])

        index, confidence = self.read(volume, excite)
        return index, confidence, *levels


def without_interpolation(head: HeadT) -> HeadT:
    """A copy, batch norm folded before, the first layers of whose refiner do the work of its :class:`Between`, too.

    That is linear.
    """
    folded = copy.deepcopy(head)
    refiner = folded.refiner
    for layer in (refiner.enter[0][0], refiner.residual):  # type: ignore[index]
        weight = refiner.between.folded(layer.weight.detach(), refiner.groups)
        layer.weight, layer.in_channels = nn.Parameter(weight), weight.shape[1]
    refiner.between = nn.Identity()  # type: ignore[assignment]
    return folded


class FastCandidateHead(nn.Module):
    """:class:`CandidateHead` with what is read off its scores.

    forward: volume (L*G, h, w) of the candidates that are looked up, features (C, h, w), hints (3, h, w), plane indices
    of all candidates (K, h, w) → index and confidence (h, w).
    """

    def __init__(self, head: CandidateHead) -> None:
        super().__init__()
        self.head = without_interpolation(head)

    def forward(self, volume: Tensor, features: Tensor, hints: Tensor, planes: Tensor) -> tuple[Tensor, Tensor]:
        """Return index and confidence."""
        return read_best(self.head.scores(volume, features, hints), planes)


class FastRefineHead(nn.Module):
    """:class:`RefineHead` without the written-out softmax.

    forward: volume (L*G, h, w) of the hypotheses that are looked up, features (R, h, w) → index and confidence (h, w).
    """

    def __init__(self, head: RefineHead) -> None:
        super().__init__()
        self.head = without_interpolation(head)

    def forward(self, volume: Tensor, features: Tensor) -> tuple[Tensor, Tensor]:
        """Return index and confidence."""
        return read_peak(self.head.scores(volume, features), REFINE_WINDOW_RADIUS, REFINE_WINDOW_RADIUS)
