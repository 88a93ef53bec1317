"""The files that ship are those of the checkpoint that ships, and stay so when they are exported again."""

from __future__ import annotations

import json
import logging
import shutil
import warnings
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch

import export.__main__ as command
from export.onnx_export import export_model, hash_weights
from export.parity import Parity, whole_parity
from export.quantize import QuantizeSettings, add_to_manifest, score_nodes
from fsinfer.depth.manifest import models_folder, read_manifest
from fsinfer.depth.model import DepthModel
from fsinfer.depth.photo_confidence import QUANTITIES
from fsinfer.scene import read_scene
from tests.support.places import ROOT
from tests.support.plane_scene import write_plane_scene
from training.checkpoint import load_checkpoint
from training.model import PRESETS, FSMVSNet

CHECKPOINTS = ROOT / "training" / "checkpoints"
CHECKPOINT = CHECKPOINTS / "field.pt"
#: What ships, and the stride of its maps.
SHIPPED = {"cascade": 2, "field": 2, "paper": 4}

pytestmark = pytest.mark.skipif(not CHECKPOINT.is_file(), reason="the checkpoint is not in this source tree")


@pytest.fixture(scope="module")
def checkpoint() -> FSMVSNet:
    return load_checkpoint(CHECKPOINT)[0]


def test_these_models_ship() -> None:
    assert {path.stem for path in models_folder().glob("*.json")} == SHIPPED.keys()


@pytest.mark.parametrize("name", SHIPPED)
def test_the_manifest_names_the_weights_of_the_checkpoint(name: str) -> None:
    data = json.loads((models_folder() / f"{name}.json").read_text(encoding="utf-8"))
    path = CHECKPOINTS / f"{name}.pt"
    assert data["weights_sha256"] == hash_weights(load_checkpoint(path)[0])
    state = torch.load(path, weights_only=True)
    assert (data["training"]["steps"], data["training"]["seed"]) == (state["step"], state["training"]["seed"])


@pytest.mark.parametrize("path", sorted(models_folder().glob("*.onnx")), ids=lambda path: path.stem)
def test_no_graph_names_a_file_of_the_machine_that_wrote_it(path: Path) -> None:
    # The exporter notes the lines of code that each node comes from.
    assert b"training/model" not in path.read_bytes()


@pytest.mark.parametrize("name", SHIPPED)
def test_confidence_of_what_ships_is_a_share_of_pixels(name: str) -> None:
    calibration = read_manifest(name).calibration
    assert calibration is not None
    assert calibration[1][-1] > 0.9


@pytest.mark.parametrize(("name", "stride"), SHIPPED.items())
def test_whole_maps_of_the_shipped_files_are_those_of_the_checkpoint(name: str, stride: int, tmp_path: Path) -> None:
    checkpoint, _ = load_checkpoint(CHECKPOINTS / f"{name}.pt")
    # An even and an odd size, and texture that the network is sure of.
    for height, width in ((192, 256), (190, 251)):
        scene = read_scene(write_plane_scene(tmp_path / str(height), height=height, width=width))
        parity = whole_parity(checkpoint, DepthModel.load(name, precision="float32"), scene, views=1)
        assert parity.pixels == -(-height // stride) * -(-width // stride)
        assert parity.depth_rel_p999 <= 1e-3
        assert parity.mask_agreement >= 0.999
        assert parity.passes()


@pytest.mark.parametrize("name", ["cascade", "field"])
def test_the_shipped_int8_file_gives_the_depth_of_the_checkpoint(name: str, tmp_path: Path) -> None:
    scene = read_scene(write_plane_scene(tmp_path, height=192, width=256))
    checkpoint, _ = load_checkpoint(CHECKPOINTS / f"{name}.pt")
    parity = whole_parity(checkpoint, DepthModel.load(name, precision="int8"), scene, views=1)
    # 8 bits are no exact copy: the middle of the differences is bounded, not their tail.
    assert parity.depth_rel_p50 < 1e-3


def test_parity_of_other_weights_does_not_pass(checkpoint: FSMVSNet, tmp_path: Path) -> None:
    scene = read_scene(write_plane_scene(tmp_path))
    other, _ = load_checkpoint(CHECKPOINT)
    with torch.no_grad():
        next(other.parameters()).mul_(1.02)
    assert not whole_parity(other, DepthModel.load("field", precision="float32"), scene, views=1).passes()


def _parity(**changes: float) -> Parity:
    given = {"depth_rel_p50": 0.0, "depth_rel_p999": 1e-3, "depth_rel_p999_sure": 0.0, "mask_agreement": 0.999}
    return Parity(views=1, pixels=9, **(given | changes))


@pytest.mark.parametrize(
    ("parity", "code"),
    [(_parity(), 0), (_parity(depth_rel_p999=1.01e-3), 1), (_parity(mask_agreement=0.9989), 1)],
)
def test_the_command_fails_beyond_the_tolerances(
    parity: Parity, code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(command, "whole_parity", lambda *_args, **_options: parity)
    scene = write_plane_scene(tmp_path)
    given = [str(CHECKPOINT), "--out", str(models_folder()), "--only-parity", "--parity", str(scene)]
    assert command.main(given) == code
    assert json.loads(capsys.readouterr().out)["depth_rel_p999"] == parity.depth_rel_p999


@pytest.mark.parametrize("path", sorted(models_folder().glob("*_int8.onnx")), ids=lambda path: path.stem)
def test_nothing_that_is_read_off_scores_is_rounded_to_8_bits(path: Path) -> None:
    graph = onnx.load(path).graph
    read = {output for node in score_nodes(graph) for output in node.output}
    assert read or path.stem.endswith("features_int8")
    for node in graph.node:
        if read.intersection(node.input):
            assert node.op_type not in ("QuantizeLinear", "DequantizeLinear"), node.name
            read.update(node.output)


@pytest.fixture
def exported(tmp_path: Path) -> tuple[FSMVSNet, Path]:
    """A small model with what is made of it afterwards: a calibration, and its graphs in int8."""
    torch.manual_seed(0)
    model = FSMVSNet(PRESETS["mvsnet"]).eval()
    manifest = exported_into(model, tmp_path)
    data = json.loads(manifest.read_text(encoding="utf-8"))
    data["confidence_calibration"] = {"raw": [0.0, 1.0], "within_1pct": [0.0, 0.5]}
    data["photo_confidence"] = {"constant": 0.5} | {name: {"at": [0.0, 1.0], "adds": [0.0, 2.0]} for name in QUANTITIES}
    manifest.write_text(json.dumps(data), encoding="utf-8")
    int8 = {role: tmp_path / f"mvsnet_{role}_int8.onnx" for role in ("features", "regularizer")}
    for role, file in int8.items():
        shutil.copy(tmp_path / f"mvsnet_{role}.onnx", file)
    add_to_manifest(manifest, int8, QuantizeSettings(), ["scene"], 1)
    read_manifest(manifest)
    return model, manifest


def exported_into(model: FSMVSNet, folder: Path) -> Path:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the exporter's own deprecations are not ours to mend
        return export_model(model, folder, provenance={"seed": 0})


def test_exporting_the_same_weights_again_keeps_what_was_made_of_them(
    exported: tuple[FSMVSNet, Path], caplog: pytest.LogCaptureFixture
) -> None:
    model, path = exported
    before = read_manifest(path)
    assert exported_into(model, path.parent) == path
    after = read_manifest(path)  # the hashes hold, too
    assert after.calibration is not None
    np.testing.assert_array_equal(after.calibration[1], [0.0, 0.5])
    assert after.photo_confidence is not None
    assert after.photo_confidence.constant == 0.5
    assert after.int8_regularizer == before.int8_regularizer == "mvsnet_regularizer_int8.onnx"
    assert after.int8_features == before.int8_features == "mvsnet_features_int8.onnx"
    assert DepthModel.load(path, precision="int8").precision == "int8"
    assert "is gone" not in caplog.text


def test_a_model_that_lost_one_of_its_int8_graphs_is_float32_alone(exported: tuple[FSMVSNet, Path]) -> None:
    model, path = exported
    (path.parent / "mvsnet_features_int8.onnx").unlink()
    exported_into(model, path.parent)
    after = read_manifest(path)
    assert after.int8_regularizer is after.int8_features is None
    assert after.calibration is not None


def test_exporting_other_weights_says_what_is_gone(
    exported: tuple[FSMVSNet, Path], caplog: pytest.LogCaptureFixture
) -> None:
    model, path = exported
    with torch.no_grad():
        next(model.parameters()).add_(0.01)
    with caplog.at_level(logging.WARNING):
        exported_into(model, path.parent)
    after = read_manifest(path)
    assert after.calibration is None
    assert after.int8_regularizer is after.int8_features is None
    assert not [*path.parent.glob("*_int8.onnx")]
    assert after.photo_confidence is None
    for made, again in (
        ("confidence_calibration", "training.calibration"),
        ("photo_confidence", "training.photo_confidence"),
        ("int8", "export.quantize"),
    ):
        assert f"mvsnet: {made} was made of other graphs and is gone" in caplog.text
        assert again in caplog.text
