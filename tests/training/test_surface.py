"""The command that trains what tells of the surface, on a scene whose depth is known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from fsinfer.depth.manifest import models_folder, read_manifest
from fsinfer.depth.model import DepthModel
from fsinfer.errors import ModelError
from fsinfer.io.pfm import read_pfm, write_pfm
from fsinfer.scene import read_scene
from tests.support.plane_scene import write_plane_scene
from training.model.surface import surface_inputs
from training.surface import (
    Sample,
    SurfaceTraining,
    load_surface,
    main,
    right_of_surer,
    sample_of,
    train_surface,
)

SMALL = SurfaceTraining(window_px=(32, 48), width=8)


def sample(seed: int) -> Sample:
    """A stem whose map goes on for four pixels beyond what the features show."""
    rng = np.random.default_rng(seed)
    left = 2 * int(rng.integers(4, 14))
    shown, said = np.zeros((40, 60), bool), np.zeros((40, 60), bool)
    shown[:, left : left + 16] = said[:, left - 4 : left + 20] = True
    features = (rng.normal(size=(8, 40, 60)) * 0.3 + np.where(shown, 1.5, -1.5)).astype(np.float16)
    index = np.where(said, 90.0, 30.0).astype(np.float32)
    return Sample(features=features, index=index, confidence=np.full_like(index, 0.7), right=shown == said)


def test_it_learns_where_the_picture_has_the_edge() -> None:
    head = train_surface([sample(seed) for seed in range(12)], steps=120, settings=SMALL)
    assert not head.training
    held_out = [sample(seed) for seed in range(100, 104)]
    alone, both = right_of_surer(head, held_out, SMALL)
    assert both > 0.99
    assert both > alone + 0.1


def test_the_same_seed_is_the_same_network() -> None:
    samples = [sample(seed) for seed in range(2)]
    one, again, other = (train_surface(samples, steps=3, settings=SMALL, seed=seed) for seed in (1, 1, 2))
    for name, value in one.state_dict().items():
        assert torch.equal(value, again.state_dict()[name])
    weights = [dict(head.named_parameters())["leave.1.weight"] for head in (one, other)]
    assert not torch.equal(*weights)


def test_the_command_writes_a_network_of_that_model(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_plane_scene(tmp_path / "scene")
    truth = read_pfm(folder / "depths" / "1.pfm").copy()
    truth[:, 70:] = 0.0  # the sky: whatever the map says there is wrong
    write_pfm(folder / "depths" / "1.pfm", truth)
    out = tmp_path / "net" / "surface.pt"
    manifest = models_folder() / "cascade.json"
    given = [str(manifest), str(folder), "--out", str(out), "--steps", "2", "--validation", str(folder)]
    assert main([*given, "--precision", "float32"]) == 0
    said = capsys.readouterr().out
    assert "3 views of 1 scenes" in said
    assert "validation: right of the surer half" in said
    head, state = load_surface(out)
    assert (head.features, head.width) == (8, SurfaceTraining.width)
    assert state["model_weights_sha256"] == read_manifest(manifest).details["weights_sha256"]
    assert (state["training"]["views"], state["training"]["steps"]) == (3, 2)
    logits = head(surface_inputs(torch.zeros(1, 8, 6, 4), torch.zeros(1, 6, 4), torch.zeros(1, 6, 4)))
    assert logits.shape == (1, 4, 3, 2)


def test_a_near_bound_that_is_drawn_in_leaves_the_planes_farther_apart(tmp_path: Path) -> None:
    scene = read_scene(write_plane_scene(tmp_path))
    truth = read_pfm(tmp_path / "depths" / "0.pfm")
    model = DepthModel.load("cascade", threads=1, calibrate=False)
    usual, drawn = (
        float(np.median(sample_of(model, scene.views[0], scene.views[1:], truth, pull, 0.02).index))
        for pull in (1.0, 3.0)
    )
    assert drawn / usual == pytest.approx((1 / 1.5 - 1 / 12) / (1 / 0.5 - 1 / 12), abs=0.01)


def test_what_is_no_checkpoint_of_it(tmp_path: Path) -> None:
    path = tmp_path / "other.pt"
    torch.save({"config": {"features": 8, "width": 8}, "average": {}}, path)
    with pytest.raises(ModelError, match=r"not a checkpoint of training\.surface"):
        load_surface(path)


def test_no_scene_is_one_message(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = [str(models_folder() / "cascade.json"), str(tmp_path), "--out", str(tmp_path / "x.pt")]
    assert main(given) == 2
    assert capsys.readouterr().out.startswith("Error: no view with a true depth map")


def test_windows_smaller_than_the_map_begin_at_even_places() -> None:
    odd = replace(SMALL, window_px=(4, 6))
    head = train_surface([sample(0)], steps=2, settings=odd)
    assert head.width == 8
