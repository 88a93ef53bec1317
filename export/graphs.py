"""The graphs as they are exported: batch norm folded, 192 planes fixed, image size free."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import TypeVar

import torch
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from export.fast_heads import FastCandidateHead, FastPlaneHead, FastRefineHead, TilePlaneHead
from export.volume_heads import TileVolumeHead, VolumeHead
from training.model import FSMVSNet, ModelConfig
from training.model.candidates import CANDIDATES, HINTS, LOOKED_UP
from training.model.config import DEPTH_PLANES
from training.model.fsmvsnet import REFINE_GROUPS

ModuleT = TypeVar("ModuleT", bound=nn.Module)
#: Height and width of the image that the exporter traces with. Source: numerics.
EXAMPLE_SIZE = (96, 128)


@dataclass(frozen=True, kw_only=True)
class Graph:
    """One ONNX graph: module, example inputs, names, and which dimensions are free."""

    role: str
    module: nn.Module
    inputs: dict[str, Tensor]
    outputs: list[str]
    free: dict[str, dict[int, str]]


class _FeaturesOnly(nn.Module):
    """The feature network with a tuple that has no ``None`` in it."""

    def __init__(self, features: nn.Module) -> None:
        super().__init__()
        self.features = features

    def forward(self, images: Tensor) -> Tensor | tuple[Tensor, Tensor]:
        quarter, half = self.features(images)
        return quarter if half is None else (quarter, half)


class _ByName(nn.Module):
    """Gives the inputs the names that the graph will show."""

    def __init__(self, head: nn.Module) -> None:
        super().__init__()
        self.head = head

    def forward(self, volume: Tensor) -> tuple[Tensor, Tensor]:
        index, confidence = self.head(volume)
        return index, confidence


def fold_batch_norm(module: ModuleT) -> ModuleT:
    """Return a copy in evaluation mode whose convolutions have absorbed the batch norms that follow them."""
    folded = copy.deepcopy(module).eval()
    for sequence in [m for m in folded.modules() if isinstance(m, nn.Sequential)]:
        for i in range(len(sequence) - 1):
            conv, norm = sequence[i], sequence[i + 1]
            if isinstance(conv, nn.Conv2d | nn.Conv3d) and isinstance(norm, nn.BatchNorm2d | nn.BatchNorm3d):
                sequence[i] = fuse_conv_bn_eval(conv, norm)
                sequence[i + 1] = nn.Identity()
    return folded


def graphs(model: FSMVSNet) -> list[Graph]:
    """Cut the model into its graphs, ready for the exporter."""
    config = model.config
    folded = fold_batch_norm(model.plane_head)
    plane_head: nn.Module = folded
    if config.regularizer == "conv3d":
        plane_head = VolumeHead(folded)
    elif config.loss == "plane":
        plane_head = FastPlaneHead(folded)
    height, width = EXAMPLE_SIZE
    h, w = height // 4, width // 4
    result = [
        Graph(
            role="features",
            module=_FeaturesOnly(fold_batch_norm(model.features)),
            inputs={"images": torch.rand(2, 3, height, width) * 255},
            outputs=["quarter", "half"] if config.refine_planes else ["quarter"],
            free={"images": {0: "views", 2: "height", 3: "width"}},
        )
    ]
    volume, free = _example_volume(config)
    result.append(
        Graph(
            role="regularizer",
            module=_ByName(plane_head),
            inputs={"volume": volume},
            outputs=["index", "confidence"],
            free={"volume": free},
        )
    )
    if model.candidate_head is not None:
        planes = torch.randn(CANDIDATES, h, w) + torch.arange(CANDIDATES)[:, None, None]
        inputs = {
            "volume": torch.randn(3 * LOOKED_UP * config.groups, h, w),
            "features": torch.randn(config.feature_channels, h, w),
            "hints": torch.rand(HINTS, h, w),
            "planes": planes,
        }
        result.append(
            Graph(
                role="candidates",
                module=FastCandidateHead(fold_batch_norm(model.candidate_head)),
                inputs=inputs,
                outputs=["index", "confidence"],
                free={name: {1: "rows", 2: "columns"} for name in inputs},
            )
        )
    if model.refine_head is not None:
        result.append(
            Graph(
                role="refiner",
                module=FastRefineHead(fold_batch_norm(model.refine_head)),
                inputs={
                    "volume": torch.randn(config.refine_looked_up * REFINE_GROUPS, 2 * h, 2 * w),
                    "features": torch.randn(config.refine_channels, 2 * h, 2 * w),
                },
                outputs=["index", "confidence"],
                free={"volume": {1: "rows", 2: "columns"}, "features": {1: "rows", 2: "columns"}},
            )
        )
    return result


def volume_channels(config: ModelConfig) -> int:
    """Values of the cost volume at each plane and pixel: groups of the correlation, or channels of the variance."""
    return config.feature_channels if config.volume == "variance" else config.groups


def _example_volume(config: ModelConfig) -> tuple[Tensor, dict[int, str]]:
    """A volume as the regularizer takes it, and which of its dimensions are free."""
    h, w = (size // 4 for size in EXAMPLE_SIZE)
    channels, packed = volume_channels(config), config.packed_planes
    if config.regularizer == "packed":
        return torch.randn(DEPTH_PLANES // packed, packed * channels, h, w), {2: "rows", 3: "columns"}
    return torch.rand(1, channels, DEPTH_PLANES, h, w), {3: "rows", 4: "columns"}


#: Tiles begin at multiples of 8 quarter-resolution pixels, the coarsest stride of both regularizers. The levels of the
#: packed one see 3, 9 and 29 of them far (a convolution of stride 2 and one or two more at each of the strides 2, 4 and
#: 8); with the enlarged levels coming up and the head the result sees 49. The refiner sees 21 half-resolution pixels.
#: The 3D one sees 51: 22 on the way down (two convolutions a level, at strides 1 to 8) and 29 on the way up.
#: Source: these fields of view, rounded up. Of a volume at an eighth the candidates of the cells beside and what looks
#: at them, 21 quarter pixels, come on top, and the ten quarter pixels of what tells of the surface.
TILE_ALIGN, TILE_LEVEL_HALOS, TILE_HALO, TILE_HALO_OF_EIGHTHS = 8, (8, 16, 32), 56, 72


def tile_graph(model: FSMVSNet) -> Graph | None:
    """The regularizer for parts of a volume.

    ``None`` where there is none: without squeeze-and-excitation the regularizer itself does not look beyond its field
    of view and serves for tiles, too (:func:`needs_no_tile_graph`).
    """
    config = model.config
    if not config.se or (config.regularizer == "packed" and config.loss != "plane"):
        return None
    volume, free = _example_volume(config)
    folded = fold_batch_norm(model.plane_head)
    if config.regularizer == "conv3d":
        return Graph(
            role="tile_regularizer",
            module=TileVolumeHead(folded),
            inputs={"volume": volume, "volume_mean": torch.rand(volume_channels(config))},
            outputs=["index", "confidence"],
            free={"volume": free},
        )
    head = TilePlaneHead(folded)
    regularizer = head.regularizer
    channels = [regularizer.excitation(level).channels for level in range(len(regularizer.se))]
    return Graph(
        role="tile_regularizer",
        module=head,
        inputs={"volume": volume, **{f"mean{level}": torch.rand(count) for level, count in enumerate(channels)}},
        outputs=["index", "confidence", *(f"level{level}" for level in range(len(channels)))],
        free={"volume": free},
    )


def needs_no_tile_graph(config: ModelConfig) -> bool:
    """Whether the regularizer itself gives of a part what it gives of the whole: nothing in it is a mean over all."""
    return not config.se
