"""Settings of a training run, and its command line."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

from training.data.samples import SamplingSettings
from training.model import CONFIGS
from training.model.config import DEPTH_PLANES

DESCRIPTION = """Train a preset of FS-MVSNet on any mix of scene folders; stops by time or steps and resumes.

python -m training.train --data SCENES --out RUN --preset field --minutes 60
torchrun --standalone --nproc-per-node 4 -m training.train --data SCENES --out RUN --preset field --minutes 60

Under torchrun every process trains on samples of its own, and a step is the mean over all of them."""

#: Planes of which a quarter, those of the coarsest scale, holds the seven of the local soft-argmin. Source: numerics.
LEAST_PLANES = 32


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
    first_part: share of the run whose loss is the cross-entropy over the planes (that of ``field``), whatever the
        preset's own is; what follows has the preset's own loss and all 192 planes. A soft-argmin over all planes
        learns next to nothing while no plane stands out. 0 for none. Source: option.
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
    first_part: float = 0.0
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


def parse_arguments(arguments: list[str] | None = None) -> TrainSettings:
    """Read the command line."""
    default = TrainSettings(data=(), out=Path("run"))
    parser = argparse.ArgumentParser(
        prog="python -m training.train", description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    data_help = "folders with training scenes, the DTU training set, BlendedMVS"
    parser.add_argument("--data", action="extend", type=Path, nargs="+", required=True, help=data_help)
    parser.add_argument(
        "--validation", action="extend", type=Path, nargs="*", default=[], help="likewise; there the validation split"
    )
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
    first_part = "share of the run, its first, with the cross-entropy over --planes; then the preset's own loss and 192"
    parser.add_argument("--first-part", type=float, default=default.first_part, metavar="SHARE", help=first_part)
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
    if values["planes"] < LEAST_PLANES or values["planes"] % 8:
        parser.error(
            f"--planes {values['planes']}: the networks halve the planes three times, and a depth is read off seven of "
            f"those at a quarter; give a multiple of 8 from {LEAST_PLANES} on"
        )
    for name, given in (("--crop", min(values["crop"])), ("--min-sources", values["min_sources"])):
        if given < 1:
            parser.error(f"{name} {given}: give 1 or more")
    for name in ("steps", "minutes", "accumulate", "checkpoint_every", "validate_every"):
        if not values[name] > 0:
            parser.error(f"--{name.replace('_', '-')} {values[name]}: give more than 0")
    if values["max_sources"] < values["min_sources"]:
        parser.error(f"--max-sources {values['max_sources']} is below --min-sources {values['min_sources']}")
    for name in ("data", "validation", "crop"):
        values[name] = tuple(values[name])
    return TrainSettings(**values)
