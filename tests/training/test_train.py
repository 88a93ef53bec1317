"""Training and evaluation end to end on a scene whose truth is known."""

from __future__ import annotations

import dataclasses
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from fsinfer.errors import ModelError, SceneError
from fsinfer.io.pfm import read_pfm, write_pfm
from fsinfer.scene import read_scene, write_pairs
from tests.support.plane_scene import PLANE_DEPTH, write_plane_scene
from training.checkpoint import main as slim_command
from training.data.find import in_both
from training.data.samples import (
    Sample,
    SamplingSettings,
    SceneSamples,
    disturbed_poses,
    jitter_colour,
    load_sample,
    mirrored,
    turned,
)
from training.evaluate import confidence_curve, evaluate_scene, main
from training.full_size import at_full_size, on_truth_grid
from training.model import ModelConfig
from training.train import Trainer, pick_window, train
from training.train import main as train_command
from training.train_settings import TrainSettings, parse_arguments


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scenes")
    for seed in range(2):
        write_plane_scene(folder / f"s{seed}", seed=seed)
    return folder


def test_samples_are_drawn_from_every_scene(scenes: Path) -> None:
    stream = iter(SceneSamples([scenes], seed=0, settings=SamplingSettings(min_sources=1, max_sources=2)))
    drawn = [next(stream) for _ in range(20)]
    assert {sample.name.split("/")[0] for sample in drawn} == {"s0", "s1"}
    assert {len(sample.images) for sample in drawn} == {2, 3}
    near, far = drawn[0].depth_range
    assert 0.5 < near <= 1.5
    assert far >= 12


def test_no_scene_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"training\.synthesize"):
        next(iter(SceneSamples([tmp_path], seed=0)))


def test_a_quarter_size_depth_map_is_spread(tmp_path: Path) -> None:
    folder = write_plane_scene(tmp_path)
    small = np.arange(27 * 35, dtype=np.float32).reshape(27, 35) + 1
    write_pfm(folder / "depths" / "0.pfm", small)
    sample = load_sample(read_scene(folder), 0, [1])
    np.testing.assert_array_equal(sample.depth[::4, ::4].numpy(), small)


def test_colour_jitter_keeps_the_range() -> None:
    images = torch.rand(3, 3, 8, 8) * 255
    changed = jitter_colour(images, 0.2, np.random.default_rng(0))
    assert 0 <= float(changed.min()) <= float(changed.max()) <= 255
    assert not torch.allclose(images, changed)


def test_windows_start_on_even_pixels_where_there_is_truth(scenes: Path) -> None:
    sample = load_sample(read_scene(scenes / "s0"), 0, [1])
    depth = torch.zeros_like(sample.depth)
    depth[:, 100:] = 3.0
    half = dataclasses.replace(sample, depth=depth)
    rng = np.random.default_rng(0)
    for _ in range(20):
        window = pick_window(half, (16, 12), rng)
        assert window.x % 2 == 0
        assert window.y % 2 == 0
        assert window.x + 16 <= 35
        assert window.y + 12 <= 27


def test_training_runs_stops_and_resumes(scenes: Path, tmp_path: Path) -> None:
    settings = TrainSettings(
        data=(scenes,),
        out=tmp_path,
        validation=(write_plane_scene(tmp_path / "validation", seed=9),),
        steps=2,
        crop=(16, 12),
        min_sources=1,
        max_sources=2,
        checkpoint_every=1,
        validate_every=2,
    )
    checkpoint = train(settings)
    first = Trainer(dataclasses.replace(settings, steps=3))
    assert first.step == 2
    train(dataclasses.replace(settings, steps=3))
    assert torch.load(checkpoint, weights_only=True)["step"] == 3
    rows = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert any("val_median_rel" in row for row in rows)


def test_a_resumed_run_goes_on_as_if_it_had_not_stopped(scenes: Path, tmp_path: Path) -> None:
    sample = load_sample(read_scene(scenes / "s0"), 0, [1])
    settings = TrainSettings(data=(scenes,), out=tmp_path / "whole", steps=100, crop=(16, 12))
    whole = Trainer(settings)
    part = Trainer(dataclasses.replace(settings, out=tmp_path / "part"))
    for trainer in (whole, part):
        trainer.train_step([sample], np.random.default_rng(0))
    part.save()
    resumed = Trainer(part.settings)
    # Adam's means are half of what decides the next step.
    for trainer in (whole, resumed):
        trainer.train_step([sample], np.random.default_rng(1))
    assert resumed.step == whole.step == 2
    for name in ("model", "average"):
        ours, theirs = (getattr(trainer, name).state_dict() for trainer in (resumed, whole))
        for key, value in theirs.items():
            torch.testing.assert_close(ours[key], value, rtol=1e-5, atol=1e-7)


def test_the_time_limit_ends_a_run(scenes: Path, tmp_path: Path) -> None:
    train(TrainSettings(data=(scenes,), out=tmp_path, minutes=1e-6, crop=(16, 12), max_sources=2))
    assert torch.load(tmp_path / "checkpoint.pt", weights_only=True)["step"] == 1


def seen_in_source(sample: Sample, u: int, v: int) -> tuple[torch.Tensor, torch.Tensor]:
    """World point of a reference pixel, and the colour at the nearest pixel of view 1 that shows it."""
    ray = torch.linalg.inv(sample.intrinsics[0]) @ torch.tensor([u, v, 1.0], dtype=torch.float64)
    point = torch.cat([ray * float(sample.depth[v, u]), torch.ones(1, dtype=torch.float64)])
    world = torch.linalg.inv(sample.cam_from_world[0]) @ point
    pixel = sample.intrinsics[1] @ (sample.cam_from_world[1] @ world)[:3]
    x, y = (round(float(c / pixel[2])) for c in pixel[:2])
    return world[:3], sample.images[1, :, y, x]


def test_mirrored_and_turned_samples_are_as_consistent_as_the_sample(scenes: Path) -> None:
    sample = load_sample(read_scene(scenes / "s0"), 0, [1])
    height, width = sample.depth.shape
    sample = dataclasses.replace(sample, depth=sample.depth + torch.arange(width) * 1e-3)  # which pixel is which
    u, v = 20, 33
    world, colour = seen_in_source(sample, u, v)
    mirror_world, mirror_colour = seen_in_source(mirrored(sample), width - 1 - u, v)
    torch.testing.assert_close(mirror_world, world * torch.tensor([-1.0, 1, 1], dtype=torch.float64))
    torch.testing.assert_close(mirror_colour, colour)
    for clockwise, place in ((True, (height - 1 - v, u)), (False, (v, width - 1 - u))):
        turn = turned(sample, clockwise=clockwise)
        assert turn.depth.shape == (width, height)
        turned_world, turned_colour = seen_in_source(turn, *place)
        torch.testing.assert_close(turned_world, world)
        torch.testing.assert_close(turned_colour, colour)
        back = turned(turn, clockwise=not clockwise)
        torch.testing.assert_close(back.images, sample.images)
        torch.testing.assert_close(back.intrinsics, sample.intrinsics)
        torch.testing.assert_close(back.cam_from_world, sample.cam_from_world)


def test_disturbed_poses_move_pixels_by_as_much_as_asked(scenes: Path) -> None:
    sample = load_sample(read_scene(scenes / "s0"), 0, [1])
    rng = np.random.default_rng(0)
    point = torch.tensor([0.2, 0.1, PLANE_DEPTH, 1.0], dtype=torch.float64)
    k = sample.intrinsics[1]

    def pixel(pose: torch.Tensor) -> torch.Tensor:
        seen = k @ (pose @ point)[:3]
        return seen[:2] / seen[2]

    moves = []
    for _ in range(200):
        poses = disturbed_poses(sample, 0.3, rng)
        torch.testing.assert_close(poses[0], sample.cam_from_world[0])
        moves.append(pixel(poses[1]) - pixel(sample.cam_from_world[1]))
    assert float(torch.stack(moves).std()) == pytest.approx(0.3, rel=0.15)


def test_estimates_are_read_at_the_centres_of_the_truth_pixels() -> None:
    values = np.arange(16 * 24, dtype=np.float32).reshape(16, 24)
    np.testing.assert_array_equal(on_truth_grid(values, (16, 24)), values)
    np.testing.assert_array_equal(on_truth_grid(values, (4, 6)), values[2::4, 2::4])


def test_between_the_pixels_of_a_half_size_map_a_slope_goes_on_and_a_silhouette_steps() -> None:
    x = np.arange(24, dtype=np.float32)
    slope = np.tile(1.0 / (0.5 - 0.002 * x), (16, 1)).astype(np.float32)
    full = at_full_size(np.ascontiguousarray(slope[::2, ::2]), 2, slope.shape)
    np.testing.assert_allclose(full[:, :23], slope[:, :23], rtol=1e-5)
    step = np.where(x < 12, np.float32(2.0), np.float32(4.0))[None].repeat(16, axis=0)
    full = at_full_size(np.ascontiguousarray(step[::2, ::2]), 2, step.shape)
    assert set(np.unique(full.round(4))) == {2.0, 4.0}


def test_a_perfect_predictor_has_no_error(scenes: Path) -> None:
    scene = read_scene(scenes / "s0")
    truth = read_pfm(scenes / "s0" / "depths" / "0.pfm")
    rows = evaluate_scene(lambda *_: (truth[::2, ::2], truth[::2, ::2], 2), scene)
    assert len(rows) == 3
    assert all(errors.median_abs == 0 and errors.within_1pct == 1 for errors in rows.values())
    off = evaluate_scene(lambda *_: (truth[::2, ::2] * 1.02, truth[::2, ::2], 2), scene)
    assert all(e.median_abs == pytest.approx(0.02 * PLANE_DEPTH, rel=1e-3) for e in off.values())


def test_confidence_curve_finds_where_the_errors_begin() -> None:
    confidence = np.linspace(0, 1, 1001, dtype=np.float32)
    error = np.where(confidence > 0.5, 0.001, 0.1).astype(np.float32)
    rows, threshold = confidence_curve(confidence, error)
    assert len(rows) == 11
    assert "100.0 %" in rows[0]
    assert "  0.0 %" in rows[-2]
    assert float(rows[-1].split()[-1]) == pytest.approx(
        0.25, abs=2e-3
    )  # 0.5 to 1 where all are good, 0 to 0.5 where none is
    assert threshold == pytest.approx(0.5 - 0.5 / 9, abs=2e-3)  # 500 good among 500 / 0.9
    assert confidence_curve(confidence, np.ones_like(error))[1] == 1.0


def test_evaluate_command(scenes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    settings = TrainSettings(data=(scenes,), out=tmp_path, steps=1, crop=(16, 12), max_sources=2)
    checkpoint = train(settings)
    capsys.readouterr()
    assert main([str(scenes / "s0"), "--checkpoint", str(checkpoint), "--every", "3", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["mean"]["pixels"] == 108 * 140
    assert found["pooled"]["median_abs"] == pytest.approx(found["mean"]["median_abs"])  # one view
    assert main([str(tmp_path / "nothing"), "--checkpoint", str(checkpoint)]) == 2
    assert "Error: no scene" in capsys.readouterr().out


def test_a_scene_without_truth_in_the_range_leaves_the_others_to_be_judged(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, far_m in (("a", 9.0), ("b", 3.0)):
        folder = write_plane_scene(tmp_path / "scenes" / name)
        write_pfm(folder / "depths" / "0.pfm", np.full((108, 140), far_m, np.float32))
    run = Trainer(_tiny(tmp_path / "scenes", tmp_path / "run"))
    run.save()
    arguments = [str(tmp_path / "scenes"), "--checkpoint", str(run.checkpoint), "--json"]
    capsys.readouterr()
    assert main([*arguments, "--min-depth", "6"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert list(found["views"]) == ["a/0"]
    assert found["mean"]["pixels"] == 108 * 140
    assert main([*arguments, "--min-depth", "50"]) == 2
    assert capsys.readouterr().out.startswith("Error: no pixel of 6 views has a true depth in the range")


def test_command_line_defaults_are_the_papers() -> None:
    settings = parse_arguments(["--data", "a", "b", "--out", "run"])
    assert settings.data == (Path("a"), Path("b"))
    assert (settings.learning_rate, settings.weight_decay) == (1e-3, 1e-5)


def test_a_slim_checkpoint_exports_the_same_weights(scenes: Path, tmp_path: Path) -> None:
    from training.checkpoint import load_checkpoint, slim

    checkpoint = train(TrainSettings(data=(scenes,), out=tmp_path, steps=1, crop=(16, 12), max_sources=2))
    slim(checkpoint, tmp_path / "slim.pt")
    assert (tmp_path / "slim.pt").stat().st_size < checkpoint.stat().st_size / 2
    whole, thin = (load_checkpoint(p)[0].state_dict() for p in (checkpoint, tmp_path / "slim.pt"))
    assert all(torch.equal(whole[key], thin[key]) for key in whole)
    resumed = Trainer(TrainSettings(data=(scenes,), out=tmp_path / "next", init=tmp_path / "slim.pt"))
    assert all(torch.equal(resumed.model.state_dict()[key], thin[key]) for key in thin)


def _tiny(scenes: Path, out: Path, **changes: Any) -> TrainSettings:
    """A run of a few seconds."""
    given: dict[str, Any] = {
        "data": (scenes,),
        "out": out,
        "steps": 2,
        "crop": (16, 12),
        "min_sources": 1,
        "max_sources": 1,
    }
    return TrainSettings(**(given | changes))


@pytest.mark.parametrize(
    ("preset", "kind"), [("paper", torch.optim.Adam), ("mvsnet", torch.optim.Adam), ("field", torch.optim.AdamW)]
)
def test_the_papers_presets_are_trained_with_adam(
    preset: str, kind: type[torch.optim.Optimizer], tmp_path: Path
) -> None:
    trainer = Trainer(_tiny(tmp_path, tmp_path / "run", preset=preset))
    assert type(trainer.optimizer) is kind
    (group,) = trainer.optimizer.param_groups
    assert (group["lr"], group["weight_decay"]) == (1e-3, 1e-5)


def test_a_checkpoint_without_the_field_was_trained_with_adamw() -> None:
    assert ModelConfig(name="field").optimizer == "adamw"


def test_a_resumed_run_has_its_optimizers_state(scenes: Path, tmp_path: Path) -> None:
    settings = _tiny(scenes, tmp_path, preset="mvsnet")
    trainer = Trainer(settings)
    for _ in range(2):
        for parameter in trainer.model.parameters():
            parameter.grad = torch.randn_like(parameter)
        trainer.optimizer.step()
    trainer.save()
    again = Trainer(settings)
    there, here = (t.optimizer.state_dict()["state"] for t in (trainer, again))
    assert there.keys() == here.keys()
    assert len(there) > 20
    for key, state in there.items():
        assert float(here[key]["step"]) == 2
        torch.testing.assert_close(here[key]["exp_avg"], state["exp_avg"], rtol=0, atol=0)
        torch.testing.assert_close(here[key]["exp_avg_sq"], state["exp_avg_sq"], rtol=0, atol=0)


def test_a_run_that_begins_with_weights_says_where_they_come_from(scenes: Path, tmp_path: Path) -> None:
    first = Trainer(_tiny(scenes, tmp_path / "1", preset="mvsnet", seed=5))
    first.step, first.spent_s = 7, 3.0
    first.save()
    second = Trainer(_tiny(scenes, tmp_path / "2", preset="mvsnet", init=tmp_path / "1" / "checkpoint.pt"))
    second.save()
    for trainer in (second, Trainer(_tiny(scenes, tmp_path / "2", preset="mvsnet"))):
        assert [(run["seed"], run["steps"], run["spent_s"]) for run in trainer.before] == [(5, 7, 3.0)]


def test_a_call_stops_early_and_the_next_one_goes_on(scenes: Path, tmp_path: Path) -> None:
    settings = _tiny(scenes, tmp_path, preset="mvsnet", steps=10**6, minutes=60.0, stop_after=1e-6, workers=2)
    for steps in (1, 2):
        checkpoint = train(settings)
        state = torch.load(checkpoint, weights_only=True)
        assert state["step"] == steps
    # The learning rate is still at the beginning of the hour.
    assert Trainer(settings).fraction() < 0.1


@pytest.mark.parametrize(("given", "amp"), [([], None), (["--amp"], True), (["--no-amp"], False)])
def test_amp_is_an_option(given: list[str], amp: bool | None) -> None:
    assert parse_arguments(["--data", "a", "--out", "b", *given]).amp is amp


def test_training_may_begin_with_fewer_planes(scenes: Path, tmp_path: Path) -> None:
    seen: list[int] = []
    for planes in (32, 192):
        given = [
            "--data",
            str(scenes),
            "--out",
            str(tmp_path / str(planes)),
            "--crop",
            "16",
            "12",
            "--max-sources",
            "2",
        ]
        given += ["--planes", str(planes)] if planes != 192 else []
        trainer = Trainer(parse_arguments(given))
        trainer.model.register_forward_hook(lambda *call: seen.append(call[-1].scales[0].scores_dhw.shape[0]))
        sample = load_sample(read_scene(scenes / "s0"), 0, [1, 2])
        trainer.train_step([sample], np.random.default_rng(0))
        trainer.save()
        assert torch.load(trainer.checkpoint, weights_only=True)["training"]["planes"] == planes
    assert seen == [32, 192]


def test_the_first_part_of_a_run_learns_planes_and_the_rest_what_the_preset_says(scenes: Path, tmp_path: Path) -> None:
    planes: list[int] = []
    settings = _tiny(scenes, tmp_path, preset="paper", steps=4, first_part=0.5, planes=32)
    trainer = Trainer(settings)
    trainer.model.register_forward_hook(lambda *call: planes.append(call[-1].scales[-1].scores_dhw.shape[0]))
    sample = load_sample(read_scene(scenes / "s0"), 0, [1, 2])
    losses = [set(trainer.train_step([sample], np.random.default_rng(0))) - {"grad", "lr"} for _ in range(4)]
    assert losses[0] == losses[1] == {"ce16", "sub16", "ce8", "sub8", "ce4", "sub4"}
    assert losses[2] == losses[3] == {"smooth", "multiscale", "attention"}
    assert planes == [32, 32, 192, 192]


@pytest.mark.parametrize("planes", ["24", "60"])
def test_planes_that_cannot_be_halved_are_refused(planes: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as refused:
        parse_arguments(["--data", "a", "--out", "b", "--planes", planes])
    assert refused.value.code == 2
    assert "multiple of 8" in capsys.readouterr().err


@pytest.mark.parametrize("preset", ["field", "paper"])
def test_amp_trains(preset: str, scenes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    trainer = Trainer(_tiny(scenes, tmp_path, preset=preset, amp=True))
    seen: list[torch.dtype] = []
    first = next(module for module in trainer.model.modules() if isinstance(module, torch.nn.Conv2d))
    first.register_forward_hook(lambda _module, _inputs, output: seen.append(output.dtype))
    parts = trainer.train_step([load_sample(read_scene(scenes / "s0"), 0, [1])], np.random.default_rng(0))
    assert seen == [torch.bfloat16]
    assert np.isfinite(list(parts.values())).all()
    assert parts["grad"] > 0
    assert all(parameter.dtype == torch.float32 for parameter in trainer.model.parameters())


def run_command(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    """``python -m training.train`` with these arguments."""
    monkeypatch.setattr(sys, "argv", ["training.train", *arguments])
    return train_command()


@pytest.mark.parametrize("workers", ["0", "1"])
def test_what_ends_the_samples_is_one_message(
    workers: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["--data", str(tmp_path), "--out", str(tmp_path / "run"), "--steps", "1", "--workers", workers]
    assert run_command(monkeypatch, *arguments) == 2
    (line,) = capsys.readouterr().out.splitlines()
    assert line.startswith("Error: no scene with pair.txt")


@pytest.mark.parametrize("lacks", ["sources", "depth"])
def test_scenes_without_a_sample_are_an_error_and_no_endless_search(lacks: str, tmp_path: Path) -> None:
    folder = write_plane_scene(tmp_path / "s", views=2)
    if lacks == "sources":
        write_pairs(folder / "pair.txt", {0: [], 1: []})
    else:
        for name in ("0", "1"):
            write_pfm(folder / "depths" / f"{name}.pfm", np.zeros((108, 140), np.float32))
    with pytest.raises(SceneError, match="none has a source"):
        next(iter(SceneSamples([tmp_path], seed=0, relist_every=10)))


def test_a_run_does_not_go_on_as_another_preset_whose_weights_have_the_same_shapes(
    scenes: Path, tmp_path: Path
) -> None:
    Trainer(_tiny(scenes, tmp_path, preset="paper-plane")).save()
    with pytest.raises(ModelError, match="a run of the preset paper-plane, not paper"):
        Trainer(_tiny(scenes, tmp_path, preset="paper"))
    begun = _tiny(scenes, tmp_path / "next", preset="paper", init=tmp_path / "checkpoint.pt")
    assert Trainer(begun).before[0]["preset"] == "paper-plane"


def test_scenes_that_are_trained_on_do_not_validate(scenes: Path, tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="s1 is in --data and in --validation"):
        train(_tiny(scenes, tmp_path, validation=(scenes / "s1",)))
    assert in_both([scenes], [tmp_path]) == []


@pytest.mark.parametrize(
    "wrong",
    [
        ["--steps", "0"],
        ["--minutes", "0"],
        ["--accumulate", "0"],
        ["--crop", "16", "0"],
        ["--min-sources", "3", "--max-sources", "2"],
    ],
)
def test_a_run_that_could_learn_nothing_is_refused(wrong: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        parse_arguments(["--data", "scenes", "--out", "run", *wrong])
    assert stopped.value.code == 2
    assert wrong[0] in capsys.readouterr().err.splitlines()[-1]


def test_what_is_no_checkpoint_is_not_reduced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert slim_command([str(tmp_path), str(tmp_path / "slim.pt")]) == 2
    assert capsys.readouterr().out.startswith(f"Error: {tmp_path} is not a checkpoint")
