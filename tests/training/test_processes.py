"""Several processes that train one model, started by torchrun, on the processor."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from tests.support.places import ROOT
from tests.support.plane_scene import write_plane_scene
from training.processes import Processes, join_processes
from training.train import main

#: What each process does in the test of one step: everything that two processes share goes through files.
_ONE_STEP = """
import sys
from pathlib import Path
import numpy as np
import torch
import training.train
from fsinfer.scene import read_scene
from training.model.fsmvsnet import Window
from training.data.samples import load_sample
from training.processes import join_processes, leave_processes
from training.train import Trainer
from training.train_settings import TrainSettings

scenes, out = Path(sys.argv[1]), Path(sys.argv[2])
processes = join_processes("cpu")
torch.set_num_threads(1)
settings = TrainSettings(data=(scenes,), out=out, preset="mvsnet", steps=9, crop=(16, 12), device="cpu")
trainer = Trainer(settings, processes)
samples = [load_sample(read_scene(scenes / f"s{i}"), 0, [1]) for i in range(2)]
mine = samples if processes.count == 1 else [samples[processes.rank]]
# The same window of a sample whichever process takes it.
training.train.pick_window = lambda *_: Window(x=8, y=6, width=16, height=12)
trainer.train_step(mine, np.random.default_rng(0))
state = {
    "weights": trainer.model.state_dict(),
    "gradients": {n: p.grad for n, p in trainer.model.named_parameters() if p.grad is not None},
    "mean": processes.mean(float(processes.rank), trainer.device),
}
torch.save(state, out / f"{processes.count}-{processes.rank}.pt")
processes.wait()
leave_processes()
"""


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scenes")
    for seed in range(2):
        write_plane_scene(folder / f"s{seed}", seed=seed)
    return folder


def torchrun(*arguments: object, processes: int = 2) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", f"--nproc-per-node={processes}"]
    environment = os.environ | {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
    return subprocess.run(
        [*command, *(str(a) for a in arguments)], env=environment, capture_output=True, text=True, check=False, cwd=ROOT
    )


@pytest.fixture(scope="module")
def one_step(tmp_path_factory: pytest.TempPathFactory, scenes: Path) -> Path:
    out = tmp_path_factory.mktemp("out")
    (out / "step.py").write_text(_ONE_STEP, encoding="utf-8")
    for processes in (1, 2):
        done = torchrun(out / "step.py", scenes, out, processes=processes)
        assert done.returncode == 0, done.stderr
    return out


def test_a_step_is_the_mean_over_the_processes(one_step: Path) -> None:
    alone, first, second = (torch.load(one_step / f"{name}.pt", weights_only=True) for name in ("1-0", "2-0", "2-1"))
    assert (first["mean"], second["mean"], alone["mean"]) == (0.5, 0.5, 0.0)
    # The heads of the coarser scales have no gradient in any process, and keep none.
    assert alone["gradients"].keys() == first["gradients"].keys()
    for name, gradient in alone["gradients"].items():
        torch.testing.assert_close(first["gradients"][name], second["gradients"][name], rtol=0, atol=0)
        # One process takes the two samples one after the other, and adds up in another order.
        torch.testing.assert_close(first["gradients"][name], gradient, rtol=1e-3, atol=1e-5)
    for name, weights in first["weights"].items():
        torch.testing.assert_close(second["weights"][name], weights, rtol=0, atol=0)


def test_torchrun_trains(scenes: Path, tmp_path: Path) -> None:
    given = ["-m", "training.train", "--data", scenes, "--out", tmp_path, "--preset", "mvsnet", "--device", "cpu"]
    given += ["--crop", 16, 12, "--max-sources", 2, "--checkpoint-every", 1]
    given += ["--validation", write_plane_scene(tmp_path / "validation", seed=9)]
    done = torchrun(*given, "--steps", 2, "--validate-every", 1)
    assert done.returncode == 0, done.stderr
    state = torch.load(tmp_path / "checkpoint.pt", weights_only=True)
    assert state["step"] == 2
    assert state["training"]["samples_per_step"] == 2
    # Only one of them writes: each row once.
    rows = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text(encoding="utf-8").splitlines()]
    assert [row["step"] for row in rows] == [1, 2]


def test_alone_there_is_nothing_to_share(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("WORLD_SIZE", raising=False)
    alone = join_processes("cpu")
    assert alone == Processes()
    assert alone.leads
    assert alone.mean(3.0, torch.device("cpu")) == 3.0


def test_processes_share_out_the_gpus(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    devices = [str(Processes(rank=i, count=4, local_rank=i).device("auto")) for i in range(4)]
    assert devices == ["cuda:0", "cuda:1", "cuda:0", "cuda:1"]
    assert str(Processes().device("auto")) == "cuda"
    assert str(Processes(rank=1, count=2, local_rank=1).device("cpu")) == "cpu"


@pytest.mark.parametrize(("device", "gpus"), [("cuda", 0), ("cuda:0", 0), ("cuda:1", 1), ("gpu", 1)])
@pytest.mark.parametrize("processes", [1, 2])
def test_a_device_that_is_not_there_is_one_message(
    device: str,
    gpus: int,
    processes: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: gpus > 0)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: gpus)
    for name, value in (("WORLD_SIZE", processes), ("RANK", 0), ("LOCAL_RANK", 0)):
        monkeypatch.setenv(name, str(value))
    monkeypatch.setattr(
        sys, "argv", ["train", "--data", str(tmp_path), "--out", str(tmp_path / "run"), "--device", device]
    )
    assert main() == 2
    assert f"Error: --device {device}: PyTorch finds no such device" in capsys.readouterr().out
    assert not (tmp_path / "run").exists()
