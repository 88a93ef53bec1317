"""Depth as it is installed, with an environment set by hand, and beside a busy program.

``python -m tests.bench.busy SCENE WORK [--views 12] [--rounds 3] [--result NAME --result-set development]``

SCENE is a scene in MVSNet format (such as ``OUT/scene`` of a run); its first views are taken, each with the next of
them as its sources. ``fsinfer depth`` is run on them in a clean environment, with each set of variables that a user
might try, and beside one program that does nothing but count, in turns; the least time of each way counts. Nothing
else may run. ``installed_to_best`` is the time as installed over that of the best environment, ``hog_ratio`` that
beside the busy program over that as installed. The least of several ways is less than one of them by chance alone, the
more the runs differ: ``medians_to_best`` is the same of the medians, and ``*_most_s`` are the longest runs.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median

from tests.bench.demo import user_environment
from tests.bench.results import add_result_options, check_result_options, save_result
from tests.bench.same import busy_programs, few_views

#: What a user might set, by name; the threads of BLAS and OpenMP, and how threads wait for work.
BY_HAND: Mapping[str, Mapping[str, str]] = {
    "one_blas_thread": {"OPENBLAS_NUM_THREADS": "1"},
    "one_omp_thread": {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"},
    "all_blas_threads": {"OPENBLAS_NUM_THREADS": str(os.cpu_count()), "OMP_WAIT_POLICY": "PASSIVE"},
}


def main(argv: list[str] | None = None) -> int:
    """Run in turns, print."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.busy", description=__doc__)
    parser.add_argument("scene", type=Path)
    parser.add_argument("work", type=Path)
    parser.add_argument("--views", type=int, default=12)
    parser.add_argument("--rounds", type=int, default=3)
    add_result_options(parser)
    args = parser.parse_args(argv)
    check_result_options(parser, args)
    few = args.work / "few"
    few_views(args.scene, few, args.views)
    seconds: dict[str, list[float]] = {name: [] for name in ("installed", *BY_HAND, "hog")}
    for number in range(args.rounds):
        for name, taken in seconds.items():
            taken.append(depth_seconds(few, args.work / "out", BY_HAND.get(name, {}), hogs=int(name == "hog")))
            print(f"round {number + 1}, {name}: {taken[-1]:.1f} s", flush=True)
    figures = figures_of(seconds)
    figures |= {"views": args.views, "rounds": args.rounds}
    for name, value in figures.items():
        print(f"{name:24s} {value:.3f}")
    save_result(args, figures, module="tests.bench.busy", arguments=argv)
    return 0


def figures_of(taken: Mapping[str, Sequence[float]]) -> dict[str, float | None]:
    """Least and greatest seconds of each way, the two ratios, and that of the medians."""
    least = {name: min(seconds) for name, seconds in taken.items()}
    middle = {name: median(seconds) for name, seconds in taken.items()}
    figures: dict[str, float | None] = {f"{name}_s": seconds for name, seconds in least.items()}
    figures |= {f"{name}_most_s": max(seconds) for name, seconds in taken.items()}
    figures["installed_to_best"] = least["installed"] / _best(least)
    figures["medians_to_best"] = middle["installed"] / _best(middle)
    figures["hog_ratio"] = least["hog"] / least["installed"]
    return figures


def _best(seconds: Mapping[str, float]) -> float:
    """Of all ways without a busy program beside them."""
    return min(value for name, value in seconds.items() if name != "hog")


def depth_seconds(scene: Path, out: Path, variables: Mapping[str, str], *, hogs: int) -> float:
    """``fsinfer depth`` from nothing, seconds by the clock."""
    shutil.rmtree(out, ignore_errors=True)
    command = [str(Path(sys.executable).with_name("fsinfer")), "depth", str(scene), str(out), "--quiet"]
    with busy_programs(hogs):
        start = time.perf_counter()
        subprocess.run(command, env=user_environment() | dict(variables), check=True)
        return time.perf_counter() - start


if __name__ == "__main__":
    raise SystemExit(main())
