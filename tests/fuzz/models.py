"""Readers of depth models: the manifest, the graphs, and the checkpoints of the training."""

from __future__ import annotations

import hashlib
import json
import shutil
from functools import cache
from pathlib import Path
from random import Random
from tempfile import mkdtemp

import numpy as np

from tests.fuzz.lies import in_member
from tests.fuzz.mutators import change_bytes, change_json, change_text, cut
from tests.fuzz.reader import Reader

_ROLES = ("features", "regularizer", "refiner")


def _make_model(folder: Path) -> None:
    from fsinfer.depth.manifest import models_folder

    data = json.loads((models_folder() / "field.json").read_text(encoding="utf-8"))
    # Without the graphs for other precisions and tiles: they take time to hash, and are checked in the same way.
    data = {key: value for key, value in data.items() if key not in ("int8", "tiles")}
    for role in _ROLES:
        name = data["graphs"][role]["file"]
        shutil.copy(models_folder() / name, folder / f"{role}.onnx")
        data["graphs"][role]["file"] = f"{role}.onnx"
    (folder / "manifest.json").write_text(json.dumps(data), encoding="utf-8")


def _read_manifest(folder: Path) -> None:
    from fsinfer.depth.model import DepthModel

    model = DepthModel.load(folder, threads=1)
    model.predict(*_views())


@cache
def _views() -> tuple[list[np.ndarray], np.ndarray, np.ndarray, tuple[float, float]]:
    rng = np.random.default_rng(0)
    images = [rng.integers(0, 255, (32, 36, 3), dtype=np.uint8) for _ in range(2)]
    poses = np.stack([np.eye(4), np.eye(4)])
    poses[1, 0, 3] = -0.3
    return images, np.stack([np.array([[40.0, 0, 18], [0, 40, 16], [0, 0, 1]])] * 2), poses, (1.5, 12.0)


def _mend_hash(folder: Path) -> None:
    """The manifest says that the changed graphs are the right ones."""
    path = folder / "manifest.json"
    data = json.loads(path.read_text(encoding="utf-8"))
    digest = hashlib.sha256()
    for role in _ROLES:
        digest.update((folder / f"{role}.onnx").read_bytes())
    path.write_text(json.dumps(data | {"sha256": digest.hexdigest()}), encoding="utf-8")


def _graph_lies(data: bytes, rng: Random) -> bytes:
    """Another number somewhere in the graph itself, behind which the weights stay as they are."""
    import onnx

    model = onnx.load_from_string(data)
    nodes = model.graph.node
    for _ in range(rng.randint(1, 2)):
        node = nodes[rng.randrange(len(nodes))]
        kind = rng.randrange(4)
        if kind == 0 and node.attribute:
            attribute = node.attribute[rng.randrange(len(node.attribute))]
            if attribute.ints:
                attribute.ints[rng.randrange(len(attribute.ints))] = rng.choice((-1, 0, 1, 7, 10_000))
            else:
                attribute.i = rng.choice((-1, 0, 1, 7, 10_000))
        elif kind == 1 and node.input:
            node.input[rng.randrange(len(node.input))] = rng.choice(("", "nothing", nodes[0].input[0]))
        elif kind == 2:
            node.op_type = rng.choice(("Relu", "Softmax", "NoSuchOperator", "Transpose", "Loop"))
        else:
            del model.graph.output[rng.randrange(len(model.graph.output))]
            if not model.graph.output:
                break
    return bytes(model.SerializeToString())


@cache
def _checkpoint() -> Path:
    import torch

    from training.model import FSMVSNet, ModelConfig

    config = ModelConfig(name="tiny", feature_channels=8, base_channels=4, width=4)
    model = FSMVSNet(config)
    path = Path(mkdtemp()) / "checkpoint.pt"
    state = {"config": config.to_dict(), "average": model.state_dict(), "step": 1, "spent_s": 0.5, "training": {}}
    torch.save(state, path)
    return path


def _make_checkpoint(folder: Path) -> None:
    shutil.copy(_checkpoint(), folder / "checkpoint.pt")


def _read_checkpoint(folder: Path) -> None:
    from training.checkpoint import load_checkpoint

    load_checkpoint(folder / "checkpoint.pt")


READERS = (
    Reader(name="manifest", what="model manifests", make=_make_model, targets=("manifest.json",), read=_read_manifest,
           mutators=(change_json, change_json, change_text, cut), most_mb=1024),
    Reader(name="onnx", what="ONNX graphs whose hash is that of the manifest", make=_make_model, targets=("*.onnx",),
           mutators=(_graph_lies, _graph_lies, change_bytes, cut), read=_read_manifest, mend=_mend_hash, most_mb=1024),
    Reader(name="checkpoint", what="checkpoints of the training", make=_make_checkpoint, targets=("*.pt",),
           mutators=(in_member("data.pkl", change_bytes), in_member("", change_bytes), change_bytes, cut),
           read=_read_checkpoint, most_mb=1024),
)  # fmt: skip
