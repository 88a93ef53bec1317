"""What the features in 8 bits are tried on, and copies of them with other notes."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.depth.manifest import hash_files, models_folder, read_manifest


def photograph(deviation: float, *, seed: int = 3) -> NDArray[np.uint8]:
    """Trunks before the sky: stripes of dark and bright with a texture, of about this standard deviation."""
    rng = np.random.default_rng(seed)
    stripes = np.where(np.arange(256) // 24 % 2, 1.0, -1.0) * np.ones((160, 1))
    grey = 128 + deviation * stripes + rng.normal(0, 12, stripes.shape)
    return np.clip(np.stack([grey, 0.9 * grey + 10, 0.8 * grey], axis=2), 0, 255).astype(np.uint8)


def with_notes(folder: Path, change: Callable[[dict[str, str]], dict[str, str]]) -> Path:
    """The manifest of a copy of ``field`` whose features graph has other notes."""
    onnx = pytest.importorskip("onnx", reason="onnx comes with the extra train")
    for file in models_folder().glob("field*"):
        shutil.copy(file, folder)
    features = folder / "field_features_int8.onnx"
    graph = onnx.load(features)
    notes = change({item.key: item.value for item in graph.metadata_props})
    del graph.metadata_props[:]
    onnx.helper.set_model_props(graph, notes)
    onnx.save(graph, features)
    manifest = folder / "field.json"
    old = read_manifest("field").int8_sha256
    assert old is not None
    now = hash_files([folder / f"field_{role}_int8.onnx" for role in ("features", "regularizer", "refiner")])
    manifest.write_text(manifest.read_text(encoding="utf-8").replace(old, now))
    return manifest
