"""``python -m export``: when it says that what was exported is what was trained."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from export import __main__ as command
from export.parity import Parity, whole_parity
from fsinfer.depth.model import DepthModel
from fsinfer.errors import SceneError
from fsinfer.scene import read_scene, write_pairs
from tests.support.plane_scene import write_plane_scene

#: As much of a trained network as the command looks at.
PAPER = SimpleNamespace(config=SimpleNamespace(name="paper"))


@pytest.mark.parametrize(
    ("off", "agreement", "code"),
    [(0.0, 1.0, 0), (0.9e-3, 0.9991, 0), (1.1e-3, 1.0, 1), (1.9e-3, 1.0, 1), (0.0, 0.9989, 1), (0.5, 0.5, 1)],
)
def test_parity_is_a_thousandth_of_the_depth_and_of_the_mask(
    off: float, agreement: float, code: int, monkeypatch: pytest.MonkeyPatch, tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    found = Parity(
        views=3, pixels=9, depth_rel_p50=0.0, depth_rel_p999=off, depth_rel_p999_sure=0.0, mask_agreement=agreement
    )
    asked: dict[str, Any] = {}

    def load(manifest: Path, *, precision: str) -> str:
        asked.update(manifest=manifest, precision=precision)
        return "deployed"

    def compare(model: Any, deployed: Any, scene: Any, *, views: int) -> Parity:
        asked.update(compared=(model.config.name, deployed, scene), views=views)
        return found

    monkeypatch.setattr(
        command, "load_checkpoint", lambda _: (SimpleNamespace(config=SimpleNamespace(name="paper")), {})
    )
    monkeypatch.setattr(DepthModel, "load", load)
    monkeypatch.setattr(command, "read_scene", lambda path: path.name)
    monkeypatch.setattr(command, "whole_parity", compare)
    arguments = ["run.pt", "--out", str(tmp_path), "--only-parity", "--parity", "scene", "--views", "2"]
    assert command.main(arguments) == code
    assert asked == {
        "manifest": tmp_path / "paper.json", "precision": "float32", "compared": ("paper", "deployed", "scene"),
        "views": 2,
    }  # fmt: skip
    assert f'"depth_rel_p999": {off}' in capsys.readouterr().out


def test_without_a_scene_nothing_is_compared_and_a_users_error_is_one_line(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def no_scene(_: Path) -> None:
        msg = "there is no scene"
        raise SceneError(msg)

    monkeypatch.setattr(
        command, "load_checkpoint", lambda _: (SimpleNamespace(config=SimpleNamespace(name="paper")), {})
    )
    monkeypatch.setattr(DepthModel, "load", lambda *_, **__: None)
    monkeypatch.setattr(command, "read_scene", no_scene)
    assert command.main(["run.pt", "--out", str(tmp_path), "--only-parity"]) == 0
    assert capsys.readouterr().out == ""
    assert command.main(["run.pt", "--out", str(tmp_path), "--only-parity", "--parity", "scene"]) == 2
    assert capsys.readouterr().out == "Error: there is no scene\n"


def test_an_export_hands_on_where_its_weights_come_from_and_tiles_alone_are_added(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    state: dict[str, Any] = {"training": {"data": ["plots"], "seed": 3}, "step": 700, "spent_s": 59.6}
    told: dict[str, Any] = {}

    def export_model(model: object, out: Path, **given: Any) -> Path:
        told.update(given, model=model, out=out)
        graphs = {"features": {"file": "paper-features.onnx", "difference_p999_over_largest": 2e-5}}
        (out / "paper.json").write_text(json.dumps({"graphs": graphs}))
        return out / "paper.json"

    monkeypatch.setattr(command, "load_checkpoint", lambda _: (PAPER, state))
    monkeypatch.setattr(command, "export_model", export_model)
    monkeypatch.setattr(command, "add_tiles", lambda *given: told.update(tiles=given))
    assert command.main(["run.pt", "--out", str(tmp_path), "--confidence-threshold", "0.4"]) == 0
    provenance = {"data": ["plots"], "seed": 3, "preset": "paper", "steps": 700, "seconds": 60}
    assert told == {"model": PAPER, "out": tmp_path, "provenance": provenance, "confidence_threshold": 0.4}
    assert capsys.readouterr().out == "paper-features.onnx: features, difference to PyTorch 2.0e-05\n"
    told.clear()
    assert command.main(["run.pt", "--out", str(tmp_path), "--only-tiles"]) == 0
    assert told == {"tiles": (PAPER, tmp_path / "paper.json")}
    assert capsys.readouterr().out == ""


SHAPE = (20, 50)


@dataclass
class Trained:
    """Stands for the network: the same depth and confidence for every view."""

    seen: list[tuple[int, ...]] = field(default_factory=list)
    dtype: torch.dtype = torch.float32

    def __deepcopy__(self, memo: dict[int, Any]) -> Trained:
        return self

    def to(self, dtype: torch.dtype) -> Trained:
        self.dtype = dtype
        return self

    def eval(self) -> None:
        self.seen.append(())

    def __call__(self, images: Any, intrinsics: Any, poses: Any, depth_range: Any) -> SimpleNamespace:
        assert images.dtype == self.dtype == torch.float64
        self.seen.append((*images.shape, len(intrinsics), len(poses)))
        return SimpleNamespace(depth=torch.full(SHAPE, 2.0), confidence=torch.linspace(0, 1, 1000).reshape(SHAPE))


@dataclass
class Deployed:
    """Stands for the ONNX files: ``off`` (h, w) is what its depth differs by, ``moved`` its confidence."""

    off: NDArray[np.float64]
    moved: NDArray[np.float64]
    manifest: Any = field(default_factory=lambda: SimpleNamespace(parity_confidence_threshold=0.4))
    views: list[int] = field(default_factory=list)

    def calibrated(self, confidence: NDArray[np.float32]) -> NDArray[np.float64]:
        return np.asarray(0.5 * confidence)

    def predict(self, images: list[Any], intrinsics: Any, poses: Any, depth_range: Any) -> SimpleNamespace:
        self.views.append(len(images))
        raw = 0.5 * np.linspace(0, 1, 1000).reshape(SHAPE)
        return SimpleNamespace(depth=2.0 * (1 + self.off), confidence=raw + self.moved)


def test_parity_tells_how_far_depth_and_mask_are_apart(tmp_path: Path) -> None:
    scene = read_scene(write_plane_scene(tmp_path, views=5))
    off = np.full(SHAPE, 1e-4)
    off.flat[:10] = -0.02  # one in a hundred
    moved = np.zeros(SHAPE)
    moved.flat[:5], moved.flat[-7:] = 1.0, -1.0  # on the other side of the threshold, both ways
    trained, deployed = Trained(), Deployed(off, moved)
    found = whole_parity(trained, deployed, scene, views=2, source_views=3)  # type: ignore[arg-type]
    assert (found.views, found.pixels) == (2, 2000)
    assert found.depth_rel_p50 == pytest.approx(1e-4, rel=1e-3)
    assert found.depth_rel_p999 == pytest.approx(0.02, rel=1e-3)
    assert found.mask_agreement == pytest.approx(1 - 12 / 1000)
    assert deployed.views == [4, 4]
    assert trained.seen[0] == ()
    assert trained.seen[1:] == [(4, 3, 108, 140, 4, 4)] * 2
    same = whole_parity(Trained(), Deployed(0 * off, 0 * moved), scene)  # type: ignore[arg-type]
    assert (same.views, same.depth_rel_p999, same.mask_agreement) == (3, 0.0, 1.0)


def test_parity_of_a_scene_without_sources_is_one_message(tmp_path: Path) -> None:
    folder = write_plane_scene(tmp_path, views=2)
    write_pairs(folder / "pair.txt", {0: [], 1: []})
    deployed = Deployed(np.zeros(SHAPE), np.zeros(SHAPE))
    with pytest.raises(SceneError, match="no view with a source"):
        whole_parity(Trained(), deployed, read_scene(folder))  # type: ignore[arg-type]
