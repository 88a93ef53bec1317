"""Train a preset of FS-MVSNet on any mix of scene folders; stops by time or steps and resumes.

python -m training.train --data SCENES --out RUN --preset field --minutes 60
torchrun --standalone --nproc-per-node 4 -m training.train --data SCENES --out RUN --preset field --minutes 60

Under torchrun every process trains on samples of its own, and a step is the mean over all of them.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
import torch
from torch import nn
from torch.optim import Optimizer
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn
from torch.utils.data import DataLoader

from fsinfer.errors import FsinferError, ModelError
from training.checkpoint import read_state
from training.data.find import find_true_scenes
from training.data.samples import Sample, SamplingSettings, SceneSamples, load_sample
from training.losses import at_stride, compute_loss
from training.metrics import depth_errors, mean_errors
from training.model import CONFIGS, FSMVSNet, ModelConfig
from training.model.config import DEPTH_PLANES
from training.model.fsmvsnet import Window
from training.processes import Processes, join_processes, leave_processes

#: Samples that each worker has ready. Source: numerics.
_PREFETCHED = 8


@dataclass(frozen=True, kw_only=True)
class TrainSettings:
    """One training run.

    Attributes
    ----------
    data, validation: folders of scenes; out: of the checkpoints. Source: option.
    preset: key of :data:`training.model.config.PRESETS`. Source: option.
    minutes, steps: the run ends with whichever comes first. Source: option.
    stop_after: minutes after which this call stops with a checkpoint to go on from; the learning rate falls towards the
        end of ``minutes`` all the same. 0 for none. Source: option.
    learning_rate, weight_decay: of Adam. Source: FS-MVSNet, Forests 2025, 16, 927.
    crop: width and height of the window at quarter resolution. Source: numerics; what a laptop trains on.
    planes: of the wide volume, a multiple of 8; with fewer than the network's 192, for the first part of a long
        training, a step takes a share of the time. Source: option.
    accumulate: samples of a step. Source: numerics.
    min_sources, max_sources: of a sample, see :class:`training.data.samples.SamplingSettings`.
    ema_decay: of the mean of the weights over the steps. Source: judgement.
    freeze_norm_from: share of the run after which batch-norm statistics stay fixed. Source: judgement.
    checkpoint_every, validate_every: steps. Source: numerics.
    seed, threads, device: of the run; init: a checkpoint to begin from. Source: option.
    amp: compute the networks in bfloat16; ``None`` does so on a GPU. Source: option.
    workers: processes that read samples, for each process that trains. Source: option.
    """

    data: tuple[Path, ...]
    out: Path
    preset: str = "field"
    validation: tuple[Path, ...] = ()
    minutes: float = 60.0
    steps: int = 10**9
    stop_after: float = 0.0
    learning_rate: float = 1e-3
    weight_decay: float = 1e-5
    crop: tuple[int, int] = (64, 48)
    planes: int = DEPTH_PLANES
    accumulate: int = 1
    min_sources: int = SamplingSettings.min_sources
    max_sources: int = SamplingSettings.max_sources
    ema_decay: float = 0.998
    freeze_norm_from: float = 0.75
    checkpoint_every: int = 200
    validate_every: int = 500
    seed: int = 1
    threads: int = 0
    device: str = "auto"
    init: Path | None = None
    amp: bool | None = None
    workers: int = 1


def make_optimizer(parameters: Iterable[nn.Parameter], config: ModelConfig, settings: TrainSettings) -> Optimizer:
    """Adam as in the paper, or AdamW (Loshchilov and Hutter 2019), as the preset says."""
    kind = torch.optim.Adam if config.optimizer == "adam" else torch.optim.AdamW
    return kind(parameters, lr=settings.learning_rate, weight_decay=settings.weight_decay)


def freeze_batch_norm(model: nn.Module) -> None:
    """Use the running statistics: the crops of one sample are too few for what a whole image will show."""
    for module in model.modules():
        if isinstance(module, nn.BatchNorm2d | nn.BatchNorm3d):
            module.eval()


def pick_window(sample: Sample, crop: tuple[int, int], rng: np.random.Generator) -> Window:
    """Choose a random window with truth in at least a third of it (the best of a few draws otherwise)."""
    height, width = (math.ceil(s / 4) for s in sample.depth.shape)
    w, h = min(crop[0], width), min(crop[1], height)
    known = at_stride(sample.depth, 4) > 0
    best, best_share = Window(x=0, y=0, width=w, height=h), -1.0
    for _ in range(6):
        # even offsets, as the half-resolution window starts at exactly twice the offset
        x, y = (int(rng.integers(0, (limit - size) // 2 + 1)) * 2 for limit, size in ((width, w), (height, h)))
        share = float(known[y : y + h, x : x + w].float().mean())
        if share > best_share:
            best, best_share = Window(x=x, y=y, width=w, height=h), share
        if share > 1 / 3:
            break
    return best


class Trainer:
    """State of a run: model, moving average, optimizer, step and time spent."""

    def __init__(self, settings: TrainSettings, processes: Processes | None = None) -> None:
        self.settings = settings
        self.processes = processes or Processes()
        self.device = self.processes.device(settings.device)
        self.amp = self.device.type == "cuda" if settings.amp is None else settings.amp
        if settings.threads:
            torch.set_num_threads(settings.threads)
        torch.manual_seed(settings.seed)
        self.config: ModelConfig = CONFIGS[settings.preset]
        self.model = FSMVSNet(self.config).to(self.device)
        self.average = AveragedModel(
            self.model, multi_avg_fn=get_ema_multi_avg_fn(settings.ema_decay), use_buffers=True
        )
        self.optimizer = make_optimizer(self.model.parameters(), self.config, settings)
        self.step = 0
        self.spent_s = 0.0
        self.before: list[dict[str, Any]] = []
        settings.out.mkdir(parents=True, exist_ok=True)
        self.checkpoint = settings.out / "checkpoint.pt"
        given = self.checkpoint if self.checkpoint.is_file() else settings.init
        if given is None:
            return
        state = read_state(given, self.device)
        try:
            if given == self.checkpoint:
                self._load(state)
            else:
                self._begin_with(state)
        except (KeyError, TypeError, ValueError, AttributeError, RuntimeError) as error:
            msg = f"{given} does not fit the preset {settings.preset} ({error}); give a checkpoint of this network"
            raise ModelError(msg) from error

    def _begin_with(self, state: dict[str, Any]) -> None:
        self.model.load_state_dict(state["average"])
        self.average.module.load_state_dict(state["average"])
        earlier = dict(state["training"])
        self.before = [*earlier.pop("before", []), {**earlier, "steps": state["step"], "spent_s": state["spent_s"]}]

    def _load(self, state: dict[str, Any]) -> None:
        self.model.load_state_dict(state["model"])
        self.average.module.load_state_dict(state["average"])
        self.average.n_averaged.fill_(state["averaged"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.step, self.spent_s = state["step"], state["spent_s"]
        self.before = state["training"].get("before", [])

    def save(self) -> None:
        """Write the checkpoint, atomically; of several processes the first one does."""
        if not self.processes.leads:
            return
        temporary = self.checkpoint.with_suffix(".part")
        torch.save(
            {
                "config": self.config.to_dict(),
                "model": self.model.state_dict(),
                "average": self.average.module.state_dict(),
                "averaged": int(self.average.n_averaged),
                "optimizer": self.optimizer.state_dict(),
                "step": self.step,
                "spent_s": self.spent_s,
                "training": {
                    "data": [path.name for path in self.settings.data],
                    "seed": self.settings.seed,
                    "learning_rate": self.settings.learning_rate,
                    "samples_per_step": self.settings.accumulate * self.processes.count,
                    "planes": self.settings.planes,
                    "preset": self.settings.preset,
                    # The runs whose weights this one began with, the oldest first.
                    "before": self.before,
                },
            },
            temporary,
        )
        temporary.replace(self.checkpoint)

    def fraction(self) -> float:
        """Share of the run that is done, by time or by steps, whichever is further."""
        return min(1.0, max(self.spent_s / (60 * self.settings.minutes), self.step / self.settings.steps))

    def train_step(self, samples: list[Sample], rng: np.random.Generator) -> dict[str, float]:
        """One optimizer step over ``samples``; returns the parts of the loss."""
        fraction = self.fraction()
        warm = min(1.0, (self.step + 1) / 100)
        rate = self.settings.learning_rate * warm * (0.02 + 0.98 * 0.5 * (1 + math.cos(math.pi * fraction)))
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        self.model.train()
        if fraction > self.settings.freeze_norm_from:
            freeze_batch_norm(self.model)
        self.optimizer.zero_grad(set_to_none=True)
        logged: dict[str, float] = {}
        for sample in samples:
            window = pick_window(sample, self.settings.crop, rng)
            with torch.autocast(self.device.type, dtype=torch.bfloat16, enabled=self.amp):
                output = self.model(
                    sample.images.to(self.device),
                    sample.intrinsics,
                    sample.cam_from_world,
                    sample.depth_range,
                    window,
                    self.settings.planes,
                )
            truth = sample.depth.to(self.device)
            loss, parts = compute_loss(output, truth, (window.x, window.y, window.width, window.height), self.config)
            if not torch.isfinite(loss):
                continue
            (loss / len(samples)).backward()
            for name, value in parts.items():
                logged[name] = logged.get(name, 0.0) + value / len(samples)
        self.processes.average_gradients(self.model)
        norm = nn.utils.clip_grad_norm_(self.model.parameters(), 5.0)
        if torch.isfinite(norm):
            self.optimizer.step()
            self.average.update_parameters(self.model)
        self.step += 1
        return {**logged, "grad": float(norm), "lr": rate}

    @torch.no_grad()
    def validate(self, limit: int = 6) -> dict[str, float]:
        """Errors of the moving average on whole validation views."""
        self.average.eval()
        rows = []
        scenes = find_true_scenes(self.settings.validation, "validation")
        for true_scene in scenes[:: max(1, len(scenes) // limit)][:limit]:
            scene = true_scene.read()
            sample = load_sample(scene, 0, scene.views[0].sources[:4], true_scene.true_depth(scene.views[0]))
            output = self.average(
                sample.images.to(self.device), sample.intrinsics, sample.cam_from_world, sample.depth_range
            )
            truth = at_stride(sample.depth, output.stride).numpy()
            errors = depth_errors(output.depth.cpu().numpy(), output.confidence.cpu().numpy(), truth)
            if errors is not None:
                rows.append(errors)
        return mean_errors(rows)


def train(settings: TrainSettings) -> Path:
    """Run until the time or the steps are used up, or until it is to stop; returns the checkpoint."""
    processes = join_processes(settings.device)
    try:
        return _train(settings, processes)
    finally:
        leave_processes()


def _train(settings: TrainSettings, processes: Processes) -> Path:
    trainer = Trainer(settings, processes)
    processes.wait()  # before the first checkpoint is written all have read the one that was there
    sampling = SamplingSettings(min_sources=settings.min_sources, max_sources=settings.max_sources)
    data = SceneSamples(settings.data, seed=settings.seed + 1000 * trainer.step, rank=processes.rank, settings=sampling)
    loader = iter(
        DataLoader(
            data,
            batch_size=None,
            num_workers=settings.workers,
            prefetch_factor=_PREFETCHED if settings.workers else None,
        )
    )
    rng = np.random.default_rng([settings.seed, trainer.step, processes.rank])
    board = _tensorboard(settings.out) if processes.leads else None
    running: dict[str, float] = {}
    began_s = trainer.spent_s
    with _log_file(settings.out, processes) as log:
        while trainer.fraction() < 1:
            start = time.monotonic()
            parts = trainer.train_step([next(loader) for _ in range(settings.accumulate)], rng)
            # The same in all processes: the time decides on the learning rate and on the end.
            trainer.spent_s += processes.mean(time.monotonic() - start, trainer.device)
            for name, value in parts.items():
                running[name] = 0.98 * running.get(name, value) + 0.02 * value
            if processes.leads and trainer.step % 50 == 0:
                row: dict[str, float | int] = {"step": trainer.step, "spent_s": round(trainer.spent_s, 1), **running}
                _log(row, log, board, trainer.step)
            if processes.leads and settings.validation and trainer.step % settings.validate_every == 0:
                _log(
                    {"step": trainer.step, **{f"val_{k}": v for k, v in trainer.validate().items()}},
                    log,
                    board,
                    trainer.step,
                )
            if trainer.step % settings.checkpoint_every == 0:
                trainer.save()
            if settings.stop_after and trainer.spent_s - began_s >= 60 * settings.stop_after:
                break
    trainer.save()
    processes.wait()
    return trainer.checkpoint


def _log_file(folder: Path, processes: Processes) -> IO[str]:
    """Of several processes the first one writes; what the others would say is the same, or of no interest."""
    path = folder / "log.jsonl" if processes.leads else Path(os.devnull)
    return path.open("a", encoding="utf-8")


def _tensorboard(folder: Path) -> Any:
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        return None
    return SummaryWriter(str(folder / "tensorboard"))


def _log(row: Mapping[str, float | int], log: Any, board: Any, step: int) -> None:
    line = json.dumps({k: round(v, 5) if isinstance(v, float) else v for k, v in row.items()})
    log.write(line + "\n")
    log.flush()
    print(line, flush=True)
    if board is not None:
        for name, value in row.items():
            board.add_scalar(name, value, step)


def parse_arguments(arguments: list[str] | None = None) -> TrainSettings:
    """Read the command line."""
    default = TrainSettings(data=(), out=Path("run"))
    parser = argparse.ArgumentParser(prog="python -m training.train", description=__doc__)
    data_help = "folders with training scenes, the DTU training set, BlendedMVS"
    parser.add_argument("--data", type=Path, nargs="+", required=True, help=data_help)
    parser.add_argument("--validation", type=Path, nargs="*", default=[], help="likewise; there the validation split")
    parser.add_argument("--out", type=Path, required=True, help="folder of the run; resumes from its checkpoint")
    parser.add_argument("--preset", choices=sorted(CONFIGS), default=default.preset)
    parser.add_argument("--minutes", type=float, default=default.minutes, help="training time in all, resumes counted")
    parser.add_argument("--steps", type=int, default=default.steps)
    parser.add_argument(
        "--stop-after", type=float, default=default.stop_after, metavar="MINUTES", help="to go on later"
    )
    parser.add_argument("--learning-rate", type=float, default=default.learning_rate)
    parser.add_argument("--weight-decay", type=float, default=default.weight_decay)
    parser.add_argument("--crop", type=int, nargs=2, default=list(default.crop), metavar=("W", "H"))
    parser.add_argument("--planes", type=int, default=default.planes, help="of the wide volume, a multiple of 8")
    parser.add_argument("--accumulate", type=int, default=default.accumulate, help="samples per optimizer step")
    parser.add_argument("--min-sources", type=int, default=default.min_sources)
    parser.add_argument("--max-sources", type=int, default=default.max_sources)
    parser.add_argument("--checkpoint-every", type=int, default=default.checkpoint_every, metavar="STEPS")
    parser.add_argument("--validate-every", type=int, default=default.validate_every, metavar="STEPS")
    parser.add_argument("--freeze-norm-from", type=float, default=default.freeze_norm_from)
    parser.add_argument("--seed", type=int, default=default.seed)
    parser.add_argument("--threads", type=int, default=default.threads)
    parser.add_argument("--device", default=default.device, help="auto, cpu or cuda")
    parser.add_argument(
        "--amp", action=argparse.BooleanOptionalAction, help="compute the networks in bfloat16; default: on a GPU"
    )
    parser.add_argument("--workers", type=int, default=default.workers, help="processes that read samples")
    parser.add_argument("--init", type=Path, help="start from the weights of this checkpoint")
    values = vars(parser.parse_args(arguments))
    if values["planes"] < 16 or values["planes"] % 8:
        parser.error(
            f"--planes {values['planes']}: the networks halve the planes three times; give a multiple of 8 from 16 on"
        )
    for name in ("data", "validation", "crop"):
        values[name] = tuple(values[name])
    return TrainSettings(**values)


def main() -> int:
    """Command line; a user's error is one message and exit code 2."""
    settings = parse_arguments()
    try:
        checkpoint = train(settings)
    except FsinferError as error:
        print(f"Error: {error}")
        return 2
    print(f"checkpoint: {checkpoint}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
