"""Write a trained model as ONNX graphs with a manifest."""

from __future__ import annotations

import hashlib
import json
import logging
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import torch

from export.graphs import (
    TILE_ALIGN,
    TILE_HALO,
    TILE_HALO_OF_EIGHTHS,
    TILE_LEVEL_HALOS,
    Graph,
    graphs,
    needs_no_tile_graph,
    tile_graph,
    volume_channels,
)
from export.hashes import rehash
from export.parity import DEPTH_REL_P999, MASK_AGREEMENT
from export.tidy import tidy
from fsinfer.depth.manifest import hash_files
from fsinfer.depth.surface import SURFACE
from fsinfer.errors import ModelError
from training.model import FSMVSNet
from training.model.candidates import AROUND, LOOKED_UP, STEP
from training.model.config import DEPTH_PLANES

_log = logging.getLogger(__name__)

#: Source: format; the least that the exporter writes.
OPSET = 18
#: What a manifest holds that was made from the weights afterwards, and the command that makes it.
_MADE_AFTERWARDS = {
    "confidence_calibration": "python -m training.calibration",
    "photo_confidence": "python -m training.photo_confidence",
    "int8": "python -m export.quantize",
    SURFACE: "python -m export.surface",
}


def export_model(
    model: FSMVSNet, folder: Path, *, provenance: dict[str, Any], confidence_threshold: float = 0.3
) -> Path:
    """Write ``NAME_*.onnx`` and ``NAME.json`` into ``folder``; returns the manifest's path.

    Every graph passes the ONNX checker and is compared with PyTorch on an input of another size than the one it
    was traced with; the 99.9th percentiles of the differences stand in the manifest. What was made from the same
    weights afterwards, the calibration and the int8 regularizer, stays in a manifest that is replaced; of other weights
    it goes, with a warning.
    """
    folder.mkdir(parents=True, exist_ok=True)
    name = model.config.name
    path = folder / f"{name}.json"
    before = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    entries = {}
    for graph in graphs(model):
        file = folder / f"{name}_{graph.role}.onnx"
        write_graph(graph, file)
        entries[graph.role] = {
            "file": file.name,
            "inputs": {key: _shape(graph, key) for key in graph.inputs},
            "outputs": graph.outputs,
            "difference_p999_over_largest": compare_graph(graph, file),
        }
    config = model.config
    manifest = {
        "name": name,
        "graphs": entries,
        "opset": OPSET,
        "volume": {
            "kind": config.volume,
            "stride": config.wide_stride,
            "planes": DEPTH_PLANES,
            "channels": volume_channels(config),
            "packed_planes": config.packed_planes if config.regularizer == "packed" else 0,
            "inverse_depth": config.inverse_depth,
        },
        "refine": {
            "planes": config.refine_planes,
            "looked_up": config.refine_looked_up,
            "span": config.refine_span,
        },
        **({"candidates": {"around": AROUND, "looked_up": LOOKED_UP, "step": STEP}} if "candidates" in entries else {}),
        "parity_confidence_threshold": confidence_threshold,
        "tolerances": {"depth_rel_p999": DEPTH_REL_P999, "confidence_mask_agreement": MASK_AGREEMENT},
        "config": config.to_dict(),
        "training": provenance,
        "weights_sha256": hash_weights(model),
    }
    manifest |= _still_true(before, manifest, folder)
    rehash(manifest, folder)
    path.write_text(json.dumps(manifest, indent=1) + "\n", encoding="utf-8")
    add_tiles(model, path)
    return path


def hash_weights(model: FSMVSNet) -> str:
    """SHA-256 over the names and values of all weights: the same for every export of one checkpoint."""
    digest = hashlib.sha256()
    for name, value in sorted(model.state_dict().items()):
        digest.update(name.encode())
        digest.update(value.detach().cpu().contiguous().numpy().tobytes())
    return digest.hexdigest()


def _what_counts(manifest: dict[str, Any], key: str) -> Any:
    """An entry; where those of before do not say how many hypotheses are looked up, all are."""
    entry = manifest.get(key)
    if not isinstance(entry, dict):
        return entry
    return {"looked_up": entry.get("planes", entry.get("around")), **entry}


def _still_true(before: dict[str, Any], now: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Entries of the manifest that is replaced which hold for the new one; the others go with a warning."""
    made = {key: before[key] for key in _MADE_AFTERWARDS if key in before}
    if not made:
        return {}
    counts = ("weights_sha256", "refine", "candidates")
    same = all(_what_counts(before, key) == _what_counts(now, key) for key in counts)
    graphs_made = {
        "int8": [folder / made["int8"][role] for role in now["graphs"] if role in made.get("int8", ())],
        SURFACE: [folder / made[SURFACE]["file"]] if SURFACE in made else [],
    }
    if same:
        for key, files in graphs_made.items():
            if not files or not all(file.is_file() for file in files):
                made.pop(key, None)
        return made
    for file in (file for files in graphs_made.values() for file in files):
        file.unlink(missing_ok=True)
    for key in made:
        _log.warning(
            "%s: %s was made of other graphs and is gone; make it again: %s", now["name"], key, _MADE_AFTERWARDS[key]
        )
    return {}


def add_tiles(model: FSMVSNet, manifest: Path) -> None:
    """Write the regularizer for tiles beside a manifest and name it there, if the model can be cut into tiles."""
    data = json.loads(manifest.read_text(encoding="utf-8"))
    graph = tile_graph(model)
    if graph is not None:
        path = manifest.parent / f"{model.config.name}_{graph.role}.onnx"
        write_graph(graph, path)
        difference = compare_graph(graph, path)
    elif needs_no_tile_graph(model.config):
        whole = data["graphs"]["regularizer"]
        path, difference = manifest.parent / whole["file"], whole["difference_p999_over_largest"]
    else:
        return
    inputs = {} if graph is None else graph.inputs
    data["tiles"] = {
        "regularizer": path.name,
        "halo": TILE_HALO if model.config.wide_stride == 4 else TILE_HALO_OF_EIGHTHS,
        "level_halos": list(TILE_LEVEL_HALOS) if "mean0" in inputs else [],
        "volume_mean": "volume_mean" in inputs,
        "align": TILE_ALIGN,
        "difference_p999_over_largest": difference,
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
    written = onnx.load(path)
    tidy(written)
    onnx.checker.check_model(written, full_check=True)
    onnx.save(written, path)


def _shape(graph: Graph, key: str) -> list[int | str]:
    return [graph.free.get(key, {}).get(i, size) for i, size in enumerate(graph.inputs[key].shape)]


def compare_graph(graph: Graph, path: Path) -> float:
    """99.9th percentile of the absolute difference between PyTorch and onnxruntime, over the output's largest value.

    Of several outputs the worst. Not the largest difference: where two planes are as good as each other, rounding
    decides between them.
    """
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
