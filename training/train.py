"""Train a preset of FS-MVSNet on any mix of scene folders; stops by time or steps and resumes.

python -m training.train --data SCENES --out RUN --preset field --minutes 60
torchrun --standalone --nproc-per-node 4 -m training.train --data SCENES --out RUN --preset field --minutes 60

Under torchrun every process trains on samples of its own, and a step is the mean over all of them.
"""

from __future__ import annotations

import json
import math
import os
import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import IO, Any

import numpy as np
import torch
from torch import nn
from torch.optim import Optimizer
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn
from torch.utils.data import DataLoader, IterableDataset

from fsinfer.errors import FsinferError, ModelError, SceneError
from training.checkpoint import read_state
from training.data.find import find_true_scenes, in_both
from training.data.samples import Sample, SamplingSettings, SceneSamples, load_sample
from training.losses import at_stride, compute_loss
from training.metrics import depth_errors, mean_errors
from training.model import CONFIGS, FSMVSNet, ModelConfig
from training.model.config import DEPTH_PLANES
from training.model.fsmvsnet import Window
from training.processes import Processes, join_processes, leave_processes
from training.train_settings import TrainSettings, parse_arguments

#: Samples that each worker has ready. Source: numerics.
_PREFETCHED = 8


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
        if given == self.checkpoint:
            self._refuse_another_network(state)
        try:
            if given == self.checkpoint:
                self._load(state)
            else:
                self._begin_with(state)
        except (KeyError, TypeError, ValueError, AttributeError, RuntimeError) as error:
            msg = f"{given} does not fit the preset {settings.preset} ({error}); give a checkpoint of this network"
            raise ModelError(msg) from error

    def _refuse_another_network(self, state: dict[str, Any]) -> None:
        """Presets whose losses alone differ have weights of one shape: a run would go on as if it were another."""
        config = state.get("config")
        name = config.get("name") if isinstance(config, dict) else None
        if name not in (None, self.config.name):
            msg = (
                f"{self.checkpoint} is a run of the preset {name}, not {self.config.name}; go on with --preset {name}, "
                "or give another --out and this checkpoint as --init"
            )
            raise ModelError(msg)

    def _begin_with(self, state: dict[str, Any]) -> None:
        for model in (self.model, self.average.module):
            missing, unknown = model.load_state_dict(state["average"], strict=False)
            # A network that has a head more may begin with the weights of one without it.
            if unknown or any(not name.startswith("candidate_head.") for name in missing):
                msg = f"it lacks {missing}, and has {unknown} which this network has not"
                raise ValueError(msg)
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
                    "first_part": self.settings.first_part,
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
        in_first_part = fraction < self.settings.first_part
        config = replace(self.config, loss="plane") if in_first_part else self.config
        planes = self.settings.planes if in_first_part or not self.settings.first_part else DEPTH_PLANES
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
                    planes,
                )
            truth = sample.depth.to(self.device)
            loss, parts = compute_loss(output, truth, (window.x, window.y, window.width, window.height), config)
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
    known = in_both(settings.data, settings.validation)
    if known:
        msg = (
            f"{known[0]} is in --data and in --validation{f', and {len(known) - 1} more' if known[1:] else ''}; "
            "errors on scenes that were trained on tell nothing: keep those of --validation in a folder outside --data"
        )
        raise SceneError(msg)
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
            _Told(data),
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
            parts = trainer.train_step([_taken(loader) for _ in range(settings.accumulate)], rng)
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


class _Told(IterableDataset[Sample | FsinferError]):
    """Samples, and the error that ends them as the last: raised in a worker it comes with a traceback for a message."""

    def __init__(self, samples: SceneSamples) -> None:
        super().__init__()
        self._samples = samples

    def __iter__(self) -> Iterator[Sample | FsinferError]:
        try:
            yield from self._samples
        except FsinferError as error:
            yield error


def _taken(loader: Iterator[Sample | FsinferError]) -> Sample:
    """The next sample; raises the error that came in its place."""
    found = next(loader)
    if isinstance(found, FsinferError):
        raise found
    return found


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
