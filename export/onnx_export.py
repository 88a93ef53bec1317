"""Write a trained model as ONNX graphs with a manifest."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import torch

from export.graphs import TILE_ALIGN, TILE_HALO, TILE_LEVEL_HALOS, Graph, graphs, tile_graph
from fsinfer.depth.manifest import hash_files
from fsinfer.errors import ModelError
from training.model import FSMVSNet
from training.model.config import DEPTH_PLANES

#: Source: format; the least that the exporter writes.
OPSET = 18


def export_model(
    model: FSMVSNet, folder: Path, *, provenance: dict[str, Any], confidence_threshold: float = 0.3
) -> Path:
    """Write ``NAME_*.onnx`` and ``NAME.json`` into ``folder``; returns the manifest's path.

    Every graph passes the ONNX checker and is compared with PyTorch on an input of another size than the one it
    was traced with; the largest differences stand in the manifest.
    """
    folder.mkdir(parents=True, exist_ok=True)
    name = model.config.name
    entries, files = {}, []
    for graph in graphs(model):
        path = folder / f"{name}_{graph.role}.onnx"
        write_graph(graph, path)
        entries[graph.role] = {
            "file": path.name,
            "inputs": {key: _shape(graph, key) for key in graph.inputs},
            "outputs": graph.outputs,
            "max_abs_difference": compare_graph(graph, path),
        }
        files.append(path)
    config = model.config
    manifest = {
        "name": name,
        "graphs": entries,
        "opset": OPSET,
        "volume": {
            "kind": config.volume,
            "planes": DEPTH_PLANES,
            "groups": config.groups,
            "packed_planes": config.packed_planes if config.regularizer == "packed" else 0,
            "inverse_depth": config.inverse_depth,
        },
        "refine": {"planes": config.refine_planes, "span": config.refine_span},
        "confidence_threshold": confidence_threshold,
        "tolerances": {"depth_rel_p999": 1e-3, "confidence_mask_agreement": 0.999},
        "config": config.to_dict(),
        "training": provenance,
        "sha256": hash_files(files),
    }
    path = folder / f"{name}.json"
    path.write_text(json.dumps(manifest, indent=1) + "\n", encoding="utf-8")
    add_tiles(model, path)
    return path


def add_tiles(model: FSMVSNet, manifest: Path) -> None:
    """Write the regularizer for tiles beside a manifest and name it there, if the model can be cut into tiles."""
    graph = tile_graph(model)
    if graph is None:
        return
    path = manifest.parent / f"{model.config.name}_{graph.role}.onnx"
    write_graph(graph, path)
    data = json.loads(manifest.read_text(encoding="utf-8"))
    data["tiles"] = {
        "regularizer": path.name,
        "halo": TILE_HALO,
        "level_halos": list(TILE_LEVEL_HALOS),
        "align": TILE_ALIGN,
        "max_abs_difference": compare_graph(graph, path),
        "sha256": hash_files([path]),
    }
    manifest.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")


def write_graph(graph: Graph, path: Path) -> None:
    """Export one graph with the dynamo exporter and check it."""
    dimension = torch.export.Dim
    shapes = {key: dict.fromkeys(graph.free.get(key, {}), dimension.DYNAMIC) for key in graph.inputs}
    program = torch.onnx.export(
        graph.module.eval(),
        kwargs=graph.inputs,
        input_names=list(graph.inputs),
        output_names=graph.outputs,
        opset_version=OPSET,
        dynamo=True,
        dynamic_shapes=shapes,
        optimize=True,
        verbose=False,
    )
    if program is None:
        msg = f"the exporter returned nothing for {graph.role}"
        raise ModelError(msg)
    program.save(str(path), external_data=False)
    onnx.checker.check_model(onnx.load(path), full_check=True)


def _shape(graph: Graph, key: str) -> list[int | str]:
    return [graph.free.get(key, {}).get(i, size) for i, size in enumerate(graph.inputs[key].shape)]


def compare_graph(graph: Graph, path: Path) -> float:
    """Largest absolute difference between PyTorch and onnxruntime, relative to the output's largest value."""
    generator = torch.Generator().manual_seed(0)
    inputs = {}
    for key, example in graph.inputs.items():
        # Odd multiples and odd remainders: sizes that the trace has not seen.
        free = graph.free.get(key, {})
        shape = [size + 22 if i in free and size > 8 else size for i, size in enumerate(example.shape)]
        inputs[key] = torch.rand(shape, generator=generator) * float(example.abs().max())
    with torch.no_grad():
        expected = graph.module(**inputs)
    expected = expected if isinstance(expected, tuple) else (expected,)
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    found = session.run(None, {key: value.numpy() for key, value in inputs.items()})
    worst = 0.0
    for a, b in zip(expected, found, strict=True):
        if tuple(a.shape) != b.shape:
            msg = f"{path.name}: PyTorch gives {tuple(a.shape)}, onnxruntime {b.shape}"
            raise ModelError(msg)
        worst = max(worst, float(np.quantile(np.abs(a.numpy() - b), 0.999)) / max(1e-6, float(a.abs().max())))
    return worst
