"""The command that fits how sure a depth is by the photographs."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from fsinfer.depth.manifest import models_folder, read_manifest
from fsinfer.depth.photo_confidence import QUANTITIES
from tests.support.plane_scene import write_plane_scene
from training.photo_confidence import main


@pytest.fixture
def model(tmp_path: Path) -> Path:
    """A copy of the shipped model that has no curves."""
    for file in models_folder().glob("field_*.onnx"):
        shutil.copy(file, tmp_path)
    path = tmp_path / "field.json"
    shutil.copy(models_folder() / "field.json", path)
    return path


def test_the_command_writes_curves_that_the_model_is_read_with(
    model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert read_manifest(model).photo_confidence is None
    folder = write_plane_scene(tmp_path / "scene")
    assert main([str(model), str(folder), "--share", "1"]) == 0
    assert "of the surer 70 %" in capsys.readouterr().out
    curves = read_manifest(model).photo_confidence
    assert curves is not None
    assert set(curves.places) == set(curves.values) == set(QUANTITIES)
    written = json.loads(model.read_text(encoding="utf-8"))["photo_confidence"]
    assert written["scenes"] == 1
    assert written["pixels"] > 1000
    assert all(np.isfinite(curves.values[name]).all() for name in QUANTITIES)


def test_no_scene_is_one_message(model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(model), str(tmp_path / "nothing")]) == 2
    assert capsys.readouterr().out.startswith("Error: ")


def test_a_scene_without_truth_in_reach_is_one_message(
    model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = model.read_bytes()
    folder = write_plane_scene(tmp_path / "scene", height=64, width=80)
    assert main([str(model), str(folder), "--max-depth", "1"]) == 2
    assert "true depth below 1;" in capsys.readouterr().out
    assert model.read_bytes() == before


def test_the_shipped_curves_go_the_way_that_they_should() -> None:
    curves = read_manifest("cascade").photo_confidence
    assert curves is not None
    ends = {name: float(curves.values[name][-1] - curves.values[name][0]) for name in QUANTITIES}
    assert ends["network"] > 1.0  # surer where the network is
    assert ends["information"] > 1.0  # where another depth would look different
    assert ends["misfit"] < -1.0  # where a source looks the same
