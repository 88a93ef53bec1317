"""The network of the surface beside an exported model: entered, kept, and refused where it is of another."""

from __future__ import annotations

import json
import shutil
import warnings
from pathlib import Path

import numpy as np
import pytest
import torch

from export.onnx_export import export_model
from export.surface import add_surface, main
from fsinfer.depth.manifest import hash_files, models_folder, read_manifest
from fsinfer.depth.model import DepthModel
from fsinfer.errors import ModelError
from tests.support.places import ROOT
from training.checkpoint import load_checkpoint
from training.model.surface import SurfaceHead
from training.surface import load_surface, save_surface

CHECKPOINTS = ROOT / "training" / "checkpoints"

pytestmark = pytest.mark.skipif(
    not (CHECKPOINTS / "cascade_surface.pt").is_file(), reason="the checkpoint is not in this source tree"
)


@pytest.fixture
def bare(tmp_path: Path) -> Path:
    """The shipped model without the network."""
    for file in models_folder().glob("cascade*"):
        shutil.copy(file, tmp_path)
    (tmp_path / "cascade_surface.onnx").unlink()
    path = tmp_path / "cascade.json"
    data = json.loads(path.read_text(encoding="utf-8"))
    del data["surface"]
    exact = [tmp_path / entry["file"] for entry in data["graphs"].values()]
    data["sha256"] = hash_files(exact)
    data["int8"]["sha256"] = hash_files([tmp_path / data["int8"][role] for role in data["graphs"]])
    path.write_text(json.dumps(data), encoding="utf-8")
    assert read_manifest(path).surface is None
    return path


def add(path: Path, checkpoint: Path) -> float:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the exporter's own deprecations are not ours to mend
        return add_surface(path, checkpoint)


def test_what_ships_is_that_of_the_checkpoint() -> None:
    shipped = read_manifest("cascade")
    head, state = load_surface(CHECKPOINTS / "cascade_surface.pt")
    assert state["model_weights_sha256"] == shipped.details["weights_sha256"]
    assert state["training"] == shipped.details["surface"]["training"]
    inputs = np.random.default_rng(0).normal(size=(48, 21, 34)).astype(np.float32)
    found = DepthModel.load("cascade", threads=1)._sessions["surface"].run_parts(inputs)
    with torch.no_grad():
        expected = torch.sigmoid(head(torch.from_numpy(inputs)[None]))[0].numpy()
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_it_is_entered_and_hashed(bare: Path) -> None:
    before = read_manifest(bare)
    assert add(bare, CHECKPOINTS / "cascade_surface.pt") < 1e-5
    after = read_manifest(bare)  # which checks the hashes of both precisions
    assert after.surface == "cascade_surface.onnx"
    assert after.sha256 != before.sha256
    assert after.int8_sha256 != before.int8_sha256
    assert after.files[-1].name == "cascade_surface.onnx"
    assert after.files_of(int8=True)[-1].name == "cascade_surface.onnx"


def test_a_graph_that_was_changed_is_seen(bare: Path) -> None:
    add(bare, CHECKPOINTS / "cascade_surface.pt")
    shutil.copy(bare.parent / "cascade_refiner.onnx", bare.parent / "cascade_surface.onnx")
    with pytest.raises(ModelError, match="damaged or was changed"):
        read_manifest(bare)


def test_that_of_another_model_is_refused(bare: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = tmp_path / "other.pt"
    save_surface(SurfaceHead(features=8, width=8), other, read_manifest("field"), {})
    assert main([str(bare), str(other)]) == 2
    assert "of another model" in capsys.readouterr().out
    assert read_manifest(bare).surface is None


def test_a_model_that_lost_it_keeps_what_else_was_made_of_the_weights(bare: Path) -> None:
    before = read_manifest(bare)
    add(bare, CHECKPOINTS / "cascade_surface.pt")
    (bare.parent / "cascade_surface.onnx").unlink()
    model, state = load_checkpoint(CHECKPOINTS / "cascade.pt")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        export_model(model, bare.parent, provenance=state["training"])
    after = read_manifest(bare)
    assert after.surface is None
    assert after.int8_features == before.int8_features is not None
    assert after.calibration is not None
    assert after.photo_confidence is not None


def test_exporting_the_same_weights_again_keeps_it_and_other_weights_do_not(bare: Path) -> None:
    add(bare, CHECKPOINTS / "cascade_surface.pt")
    model, state = load_checkpoint(CHECKPOINTS / "cascade.pt")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        export_model(model, bare.parent, provenance=state["training"])
        kept = read_manifest(bare)
        assert kept.surface == "cascade_surface.onnx"
        assert kept.int8_features is not None
        with torch.no_grad():
            next(model.parameters()).add_(0.01)
        export_model(model, bare.parent, provenance=state["training"])
    assert read_manifest(bare).surface is None
    assert not (bare.parent / "cascade_surface.onnx").exists()
