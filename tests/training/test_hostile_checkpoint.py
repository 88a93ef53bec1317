"""A checkpoint of somebody else runs no code, and takes no more memory than a network has."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
import torch

from fsinfer.errors import ModelError
from training.checkpoint import KEPT, load_checkpoint, slim
from training.model import FSMVSNet, ModelConfig
from training.train import Trainer
from training.train_settings import TrainSettings

CONFIG = ModelConfig(name="tiny", feature_channels=8, base_channels=4, width=4)


class Hostile:
    """Runs a command when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, (str(self.path),)


@pytest.fixture
def state() -> dict[str, Any]:
    average = FSMVSNet(CONFIG).state_dict()
    return {"config": CONFIG.to_dict(), "average": average, "step": 1, "spent_s": 0.5, "training": {}}


def refused(path: Path, tmp_path: Path) -> None:
    for read in (load_checkpoint, lambda path: slim(path, tmp_path / "slim.pt")):
        with pytest.raises(ModelError, match=rf"{path.name} .*checkpoint"):
            read(path)


def test_code_in_a_checkpoint_is_not_run(tmp_path: Path, state: dict[str, Any]) -> None:
    path, made = tmp_path / "checkpoint.pt", tmp_path / "made"
    torch.save(state | {"step": Hostile(made)}, path)
    refused(path, tmp_path)
    (tmp_path / "run").mkdir()
    with pytest.raises(ModelError, match=r"checkpoint\.pt"):
        Trainer(TrainSettings(data=(tmp_path,), out=tmp_path / "run", init=path))
    path.rename(tmp_path / "run" / "checkpoint.pt")
    with pytest.raises(ModelError, match=r"checkpoint\.pt"):
        Trainer(TrainSettings(data=(tmp_path,), out=tmp_path / "run"))
    assert not made.exists()


@pytest.mark.parametrize("content", [b"", b"no checkpoint", b"PK\x03\x04" + bytes(40)])
def test_files_that_are_none(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "checkpoint.pt"
    path.write_bytes(content)
    refused(path, tmp_path)


def test_another_content(tmp_path: Path, state: dict[str, Any]) -> None:
    path = tmp_path / "checkpoint.pt"
    torch.save([1, 2, 3], path)
    refused(path, tmp_path)
    torch.save({key: value for key, value in state.items() if key != "average"}, path)
    refused(path, tmp_path)
    torch.save(state, path)
    assert load_checkpoint(path)[1]["step"] == 1
    slim(path, tmp_path / "slim.pt")
    assert sorted(torch.load(tmp_path / "slim.pt", weights_only=True)) == sorted(KEPT)


def test_a_network_that_no_memory_holds(tmp_path: Path, state: dict[str, Any]) -> None:
    path = tmp_path / "checkpoint.pt"
    torch.save(state | {"config": {**state["config"], "base_channels": 10**6}}, path)
    with pytest.raises(ModelError, match="base_channels = 1000000"):
        load_checkpoint(path)


def test_weights_of_another_network_to_begin_with(tmp_path: Path, state: dict[str, Any]) -> None:
    torch.save(state, tmp_path / "other.pt")
    with pytest.raises(ModelError, match=r"other\.pt does not fit the preset"):
        Trainer(TrainSettings(data=(tmp_path,), out=tmp_path / "run", init=tmp_path / "other.pt"))
