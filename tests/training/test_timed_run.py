"""Minutes on a machine that is there for a while: what is started, and that it ends with a checkpoint."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from tests.support.plane_scene import write_plane_scene
from training import timed_run
from training.synthesize.__main__ import parse as parse_synthesize
from training.train_settings import parse_arguments


def test_the_worlds_are_shared_out_without_gap_or_overlap(tmp_path: Path) -> None:
    args = timed_run.parse([str(tmp_path), "--scenes", "10", "--render-processes", "3", "--seed", "3100"])
    commands = timed_run.render_commands(args)
    given = [parse_synthesize(command[3:]) for command in commands]
    assert [command[1:3] for command in commands] == [["-m", "training.synthesize"]] * 3
    assert sorted(g.seed + i for g in given for i in range(g.scenes)) == list(range(3100, 3110))
    assert {g.kind for g in given} == {"cluster"}


def test_what_trains_is_the_training_command_with_the_time_that_is_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    monkeypatch.setattr("os.cpu_count", lambda: 16)
    args = timed_run.parse([str(tmp_path), "--minutes", "10", "--total-minutes", "60", "--preset", "paper"])
    command = timed_run.train_command(args, left_minutes=8.25)
    assert command[1:5] == ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node=4"]
    settings = parse_arguments(command[command.index("training.train") + 1 :])
    assert (settings.minutes, settings.stop_after, settings.preset) == (60.0, 8.25, "paper")
    assert (settings.crop, settings.workers, settings.amp) == ((96, 72), 2, None)
    assert settings.data == (tmp_path / "scenes",)
    assert settings.out == tmp_path / "run"


def test_it_trains_on_given_scenes_until_the_time_is_over(tmp_path: Path) -> None:
    for seed in range(2):
        write_plane_scene(tmp_path / "scenes" / f"s{seed}", seed=seed)
    out = tmp_path / "out"
    options = ["--scenes", "0", "--data", str(tmp_path / "scenes"), "--minutes", "0.001", "--total-minutes", "5"]
    options += ["--preset", "mvsnet", "--crop", "16", "12", "--processes", "1", "--workers", "1"]
    assert timed_run.main([str(out), *options]) == 0
    state = torch.load(out / "run" / "checkpoint.pt", weights_only=True)
    assert state["step"] >= 1
    assert state["spent_s"] < 60


def test_without_scenes_there_is_an_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    empty = tmp_path / "empty"
    empty.mkdir()
    assert timed_run.main([str(tmp_path / "out"), "--scenes", "0", "--data", str(empty), "--minutes", "0.001"]) == 2
    assert "0 scenes" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        timed_run.parse([str(tmp_path), "--scenes", "0"])
