"""The graphs as they are exported: batch norm folded, 192 planes fixed, image size free."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import TypeVar

import torch
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from export.fast_heads import FastPlaneHead, FastRefineHead, TilePlaneHead
from training.model import FSMVSNet
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
    fast = config.regularizer == "packed" and config.loss == "plane"
    plane_head = FastPlaneHead(fold_batch_norm(model.plane_head)) if fast else fold_batch_norm(model.plane_head)
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
    if config.regularizer == "packed":
        packed = config.packed_planes
        volume = torch.randn(DEPTH_PLANES // packed, packed * config.groups, h, w)
        free = {2: "rows", 3: "columns"}
    else:
        channels = config.feature_channels if config.volume == "variance" else config.groups
        volume = torch.rand(1, channels, DEPTH_PLANES, h, w)
        free = {3: "rows", 4: "columns"}
    result.append(
        Graph(
            role="regularizer",
            module=_ByName(plane_head),
            inputs={"volume": volume},
            outputs=["index", "confidence"],
            free={"volume": free},
        )
    )
    if model.refine_head is not None:
        result.append(
            Graph(
                role="refiner",
                module=FastRefineHead(fold_batch_norm(model.refine_head)),
                inputs={
                    "volume": torch.randn(config.refine_planes * REFINE_GROUPS, 2 * h, 2 * w),
                    "features": torch.randn(config.refine_channels, 2 * h, 2 * w),
                },
                outputs=["index", "confidence"],
                free={"volume": {1: "rows", 2: "columns"}, "features": {1: "rows", 2: "columns"}},
            )
        )
    return result


#: Tiles begin at multiples of 8 quarter-resolution pixels, the coarsest stride of the packed regularizer. Its levels
#: see 3, 9 and 29 of them far (a convolution of stride 2 and one or two more at each of the strides 2, 4 and 8); with
#: the enlarged levels coming up and the head the result sees 49. The refiner sees 21 half-resolution pixels.
#: Source: these fields of view, rounded up.
TILE_ALIGN, TILE_LEVEL_HALOS, TILE_HALO = 8, (8, 16, 32), 56


def tile_graph(model: FSMVSNet) -> Graph | None:
    """The regularizer for parts of a volume; ``None`` for a model that is not cut into tiles."""
    config = model.config
    if not (config.regularizer == "packed" and config.loss == "plane" and config.se):
        return None
    head = TilePlaneHead(fold_batch_norm(model.plane_head))
    height, width = EXAMPLE_SIZE
    packed = config.packed_planes
    volume = torch.randn(DEPTH_PLANES // packed, packed * config.groups, height // 4, width // 4)
    regularizer = head.regularizer
    channels = [regularizer.excitation(level).channels for level in range(len(regularizer.se))]
    return Graph(
        role="tile_regularizer",
        module=head,
        inputs={"volume": volume, **{f"mean{level}": torch.rand(count) for level, count in enumerate(channels)}},
        outputs=["index", "confidence", *(f"level{level}" for level in range(len(channels)))],
        free={"volume": {2: "rows", 3: "columns"}},
    )
