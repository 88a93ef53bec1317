"""A GPU for some minutes, used well: scenes are rendered on the processors while the GPU trains on those there are.

python -m training.timed_run OUT --minutes 10

The same command again goes on with both: rendered scenes stay in OUT/scenes, the run in OUT/run. ``--total-minutes``
says how long the run is in all, over all calls; the learning rate falls over that time. Several processes share a GPU,
because a view by itself is too small to fill one; their gradients are averaged (:mod:`training.processes`).
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import torch

from fsinfer.errors import FsinferError, SceneError
from training.checkpoint import read_state
from training.data.find import find_true_scenes
from training.model import CONFIGS

#: Processes that train on a GPU, each with its own samples. Source: judgement; four queues of small kernels overlap.
PROCESSES_PER_GPU = 4
#: Whole views of 384x288 pixels on a GPU, windows on a processor; quarter-resolution pixels. Source: numerics.
GPU_CROP, CPU_CROP = (96, 72), (64, 48)
#: Scenes there have to be before training begins: with fewer it would see the same views again and again. Source:
#: judgement.
FIRST_SCENES = 12
#: First seed of the rendered worlds: apart from those of all sets in models/README.md. Source: layout.
FIRST_SEED = 3000


def render_commands(args: argparse.Namespace) -> list[list[str]]:
    """One command for each process that renders; together they make the worlds of all seeds that are not there yet."""
    blocks = min(args.render_processes, args.scenes)
    commands = []
    for block in range(blocks):
        first, last = (args.scenes * i // blocks for i in (block, block + 1))
        command = [sys.executable, "-m", "training.synthesize", str(args.out / "scenes")]
        command += ["--seed", str(args.seed + first), "--scenes", str(last - first), "--kind", "cluster"]
        command += ["--clusters-per-scene", "4", "--views", "6", "--wide-share", "0.3", "--clutter", "0.3"]
        command += ["--textures", str(args.textures)] if args.textures else []
        commands.append(command)
    return commands


def train_command(args: argparse.Namespace, *, left_minutes: float) -> list[str]:
    """The command that trains for what is left of the time; with several processes through torchrun."""
    alone = [sys.executable]
    together = [sys.executable, "-m", "torch.distributed.run", "--standalone", f"--nproc-per-node={args.processes}"]
    folders = [*([args.out / "scenes"] if args.scenes else []), *args.data]
    command = [*(alone if args.processes == 1 else together), "-m", "training.train"]
    command += ["--data", *(str(folder) for folder in folders), "--out", str(args.out / "run")]
    command += ["--validation", *(str(folder) for folder in args.validation)] if args.validation else []
    command += ["--preset", args.preset, "--minutes", str(args.total_minutes), "--stop-after", f"{left_minutes:.3f}"]
    command += ["--crop", *(str(size) for size in args.crop), "--workers", str(args.workers)]
    command += ["--min-sources", "1", "--max-sources", "5"]
    return command


def parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """Read the command line; what is not given follows from the machine."""
    parser = argparse.ArgumentParser(prog="python -m training.timed_run", description=__doc__)
    parser.add_argument("out", type=Path, metavar="OUT", help="folder of the scenes and of the run")
    parser.add_argument("--minutes", type=float, default=10.0, help="of this call, rendering included")
    parser.add_argument("--total-minutes", type=float, help="of training over all calls; default: --minutes")
    parser.add_argument("--preset", choices=sorted(CONFIGS), default="field")
    parser.add_argument("--data", action="extend", type=Path, nargs="*", default=[], help="more folders with scenes")
    parser.add_argument("--validation", action="extend", type=Path, nargs="*", default=[])
    parser.add_argument("--scenes", type=int, default=400, help="worlds to render in all; 0: --data alone")
    parser.add_argument("--seed", type=int, default=FIRST_SEED, help="of the first world")
    parser.add_argument("--textures", type=Path, help="see training.synthesize")
    parser.add_argument("--render-processes", type=int, help="default: half the cores")
    parser.add_argument("--processes", type=int, help="that train; default: four a GPU, one without")
    parser.add_argument("--workers", type=int, help="that read samples, for each that trains; default: the other cores")
    parser.add_argument("--crop", type=int, nargs=2, metavar=("W", "H"))
    args = parser.parse_args(arguments)
    cores, gpus = os.cpu_count() or 1, torch.cuda.device_count()
    defaults = {
        "total_minutes": args.minutes,
        "render_processes": max(1, cores // 2),
        "processes": PROCESSES_PER_GPU * gpus or 1,
        "crop": GPU_CROP if gpus else CPU_CROP,
    }
    for name, value in defaults.items():
        if getattr(args, name) is None:
            setattr(args, name, value)
    if args.workers is None:
        args.workers = max(1, (cores - args.render_processes) // args.processes)
    if not args.scenes and not args.data:
        parser.error("--scenes 0 needs --data")
    return args


def run(args: argparse.Namespace) -> Path:
    """Render and train until the time is over; returns the checkpoint.

    Raises
    ------
    SceneError
        The renderers ended without a scene, or the time was over before there were enough.
    """
    end = time.monotonic() + 60 * args.minutes
    args.out.mkdir(parents=True, exist_ok=True)
    # One thread each: they share out the cores themselves.
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    with (args.out / "render.log").open("a", encoding="utf-8") as log:
        renderers = [
            subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT, env=environment)
            for command in render_commands(args)
        ]
        try:
            folders = [args.out / "scenes", *args.data]
            while (found := len(find_true_scenes(folders, "train"))) < FIRST_SCENES:
                working = any(renderer.poll() is None for renderer in renderers)
                if found and not working:
                    break
                if not working or time.monotonic() > end:
                    msg = f"{found} scenes in {[str(f) for f in folders]}; see {log.name}, or give more --minutes"
                    raise SceneError(msg)
                time.sleep(0.5)
            left = max(0.0, end - time.monotonic()) / 60
            subprocess.run(train_command(args, left_minutes=left), env=environment, check=True)
        finally:
            for renderer in renderers:
                renderer.terminate()
            for renderer in renderers:
                renderer.wait()
    return Path(args.out / "run" / "checkpoint.pt")


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; a user's error is one message and exit code 2."""
    args = parse(arguments)
    try:
        checkpoint = run(args)
    except FsinferError as error:
        print(f"Error: {error}")
        return 2
    except subprocess.CalledProcessError as error:
        return int(error.returncode) or 1
    state = read_state(checkpoint)
    samples = state["step"] * state["training"]["samples_per_step"]
    print(f"{checkpoint}: {state['step']} steps, {samples / max(state['spent_s'], 1e-9):.1f} samples a second")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
