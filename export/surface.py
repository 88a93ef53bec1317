"""The network of :mod:`fsinfer.depth.surface` beside an exported model.

python -m export.surface models/cascade.json training/checkpoints/cascade_surface.pt

It was trained on the depth maps of that model, so that it is exported after it.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import torch
from torch import Tensor, nn

from export.graphs import EXAMPLE_SIZE, Graph, fold_batch_norm
from export.hashes import rehash
from export.onnx_export import compare_graph, write_graph
from fsinfer.depth.manifest import read_manifest
from fsinfer.depth.surface import SURFACE
from fsinfer.errors import FsinferError, ModelError
from fsinfer.io.files import write_text
from training.surface import load_surface


class _Probability(nn.Module):
    """forward: inputs (C, h, w) → probability (4, h, w)."""

    def __init__(self, head: nn.Module) -> None:
        super().__init__()
        self.head = head

    def forward(self, inputs: Tensor) -> Tensor:
        return torch.sigmoid(self.head(inputs[None]))[0]


def add_surface(manifest: Path, checkpoint: Path) -> float:
    """Write ``NAME_surface.onnx`` and enter it; returns how far it is from PyTorch (``compare_graph``).

    Raises
    ------
    ModelError
        The checkpoint is of another model, or no such checkpoint.
    """
    model = read_manifest(manifest)
    head, state = load_surface(checkpoint)
    weights = model.details["weights_sha256"]
    if state["model_weights_sha256"] != weights or model.refine_channels != head.features:
        msg = (
            f"{checkpoint} was trained on the maps of another model; train it on {manifest}: python -m training.surface"
        )
        raise ModelError(msg)
    height, width = (size // 4 for size in EXAMPLE_SIZE)
    channels = head.enter[0][0].in_channels  # type: ignore[index]
    graph = Graph(
        role=SURFACE,
        module=_Probability(fold_batch_norm(head)),
        inputs={"inputs": torch.rand(int(channels), height, width)},
        outputs=["probability"],
        free={"inputs": {1: "rows", 2: "columns"}},
    )
    file = manifest.parent / f"{model.name}_{SURFACE}.onnx"
    write_graph(graph, file)
    difference = compare_graph(graph, file)
    data = model.details
    data[SURFACE] = {
        "file": file.name,
        "inputs": {"inputs": [int(channels), "rows", "columns"]},
        "outputs": graph.outputs,
        "width": head.width,
        "difference_p999_over_largest": difference,
        "training": state["training"],
    }
    rehash(data, manifest.parent)
    write_text(manifest, json.dumps(data, indent=1) + "\n")
    return difference


def main(arguments: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m export.surface", description=__doc__)
    parser.add_argument("manifest", type=Path, help="NAME.json of an exported model; the graph is put beside it")
    parser.add_argument("checkpoint", type=Path, help="of python -m training.surface")
    args = parser.parse_args(arguments)
    try:
        difference = add_surface(args.manifest, args.checkpoint)
    except FsinferError as error:
        print(f"Error: {error}")
        return 2
    print(f"{args.manifest.stem}_{SURFACE}.onnx: {difference:.1e} from PyTorch")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
