"""A calibrated confidence is the share of good pixels, and the deployed model gives it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsinfer.depth.manifest import models_folder, read_manifest
from fsinfer.depth.model import DepthModel
from fsinfer.depth.photo_confidence import QUANTITIES
from fsinfer.errors import ModelError
from fsinfer.io.images import read_image
from fsinfer.scene import read_scene
from tests.support.plane_scene import write_plane_scene
from training.calibration import fit_calibration, main


def test_the_share_of_good_pixels_is_recovered() -> None:
    rng = np.random.default_rng(0)
    raw = rng.random(200_000).astype(np.float32)
    good = rng.random(len(raw)) < raw**2  # over-confident by as much as 0.25
    knots, share = fit_calibration(raw, good)
    fresh = rng.random(50_000).astype(np.float32)
    assert np.abs(np.interp(fresh, knots, share) - fresh**2).mean() < 0.01


@given(st.integers(0, 2**31), st.integers(5, 500))
def test_the_ranking_is_kept_and_a_probability_comes_out(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    raw = rng.random(count).astype(np.float32) ** 3
    knots, share = fit_calibration(raw, rng.random(count) < 0.5)
    assert (np.diff(knots) > 0).all()
    assert (np.diff(share) >= 0).all()
    assert 0 <= share[0] <= share[-1] <= 1
    assert knots[0] == 0 < 1 < knots[-1]


@pytest.fixture
def model(tmp_path: Path) -> Path:
    """A copy of the shipped model without its calibration."""
    for file in models_folder().glob("field_*.onnx"):
        shutil.copy(file, tmp_path)
    data = json.loads((models_folder() / "field.json").read_text(encoding="utf-8"))
    data.pop("confidence_calibration", None)
    data["photo_confidence"] = {"constant": 0.0} | {name: {"at": [0, 1], "adds": [0, 1]} for name in QUANTITIES}
    path = tmp_path / "field.json"
    path.write_text(json.dumps(data), encoding="utf-8")
    return path


def test_the_command_calibrates_the_deployed_model(
    model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_plane_scene(tmp_path / "scene")
    scene = read_scene(folder)
    group = [scene.views[0], scene.views[1]]
    inputs = (
        [read_image(view.image_path) for view in group],
        np.stack([view.camera.intrinsic for view in group]),
        np.stack([view.camera.cam_from_world for view in group]),
        (1.5, 12.0),
    )
    raw = DepthModel.load(model).predict(*inputs)
    assert main([str(model), str(folder)]) == 0
    said = capsys.readouterr().out
    assert "mean distance of confidence and share" in said
    # Curves of the sub-pixel step have the network's calibrated word in them.
    assert "training.photo_confidence" in said
    assert read_manifest(model).photo_confidence is None
    calibration = read_manifest(model).calibration
    assert calibration is not None
    calibrated = DepthModel.load(model).predict(*inputs)
    np.testing.assert_array_equal(calibrated.depth, raw.depth)
    np.testing.assert_allclose(calibrated.confidence, np.interp(raw.confidence, *calibration), atol=1e-6)
    untouched = DepthModel.load(model, calibrate=False).predict(*inputs)
    np.testing.assert_array_equal(untouched.confidence, raw.confidence)
    assert main([str(model), str(tmp_path / "nothing")]) == 2


def test_a_calibration_that_does_not_rise_is_refused(model: Path) -> None:
    data = json.loads(model.read_text(encoding="utf-8"))
    data["confidence_calibration"] = {"raw": [0.0, 0.5, 0.5], "within_1pct": [0.0, 0.5, 1.0]}
    model.write_text(json.dumps(data), encoding="utf-8")
    with pytest.raises(ModelError, match="confidence_calibration"):
        read_manifest(model)
