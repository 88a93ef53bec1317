"""A whole plot against the number of photographs: seconds of each stage and peak memory.

python -m tests.bench.plot_speed PLOT OUT --photos 50 100 200 --figure docs/figures/plot-speed.png

PLOT holds ``images/`` (``training.synthesize --kind plot``); its first so many photographs are a shorter walk. Each
number is a run of its own process, ``fsinfer run`` in OUT/NUMBER, and goes on where it was stopped. The exponent of a
stage is the slope of log seconds over log photographs: 1 is linear.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np

from fsinfer.io.photo_folders import list_images
from tests.bench.plot import plot_settings
from tests.bench.results import add_result_options, check_result_options, save_result


def run_first(plot: Path, out: Path, photos: int, arguments: list[str]) -> dict[str, dict[str, float]]:
    """Seconds and peak memory (MiB) of each stage of ``fsinfer run`` on the first so many photographs."""
    source = out / f"{photos}-photos"
    source.mkdir(parents=True, exist_ok=True)
    for path in list_images(plot / "images")[:photos]:
        if not (source / path.name).is_file():
            shutil.copy(path, source)
    folder = out / str(photos)
    command = [sys.executable, "-m", "fsinfer.cli.app", "run", str(source), str(folder), "--quiet", *arguments]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return {
        path.stem: {key: float(record[key] or 0) for key in ("seconds", "peak_rss_mb")}
        for path in (folder / ".fsinfer").glob("*.json")
        for record in [json.loads(path.read_text(encoding="utf-8"))]
    }


def exponent(photos: list[int], seconds: list[float]) -> float:
    """Slope of log seconds over log photographs, least squares."""
    return float(np.polyfit(np.log(photos), np.log(np.maximum(seconds, 1e-3)), 1)[0])


def draw(path: Path, photos: list[int], stages: dict[str, list[float]]) -> None:
    """Minutes over photographs, one line a stage, with the straight line through the largest run for comparison."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 4), layout="constrained")
    axes = figure.subplots()
    for name, seconds in stages.items():
        (line,) = axes.plot(photos, np.array(seconds) / 60, "o-", label=name)
        axes.plot([0, photos[-1]], [0, seconds[-1] / 60], ":", color=line.get_color(), linewidth=1)
    axes.set_xlabel("photographs")
    axes.set_ylabel("minutes")
    axes.legend()
    figure.savefig(path, dpi=150)


def main(argv: list[str] | None = None) -> int:
    """Run and print."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.bench.plot_speed",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("plot", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--photos", type=int, nargs="+", default=[50, 100, 200, 300])
    parser.add_argument("--aruco-length-m", default="0.25")
    parser.add_argument("--figure", type=Path)
    add_result_options(parser)
    args, more = parser.parse_known_args(argv)
    check_result_options(parser, args)
    counts = sorted(args.photos)
    runs = [run_first(args.plot, args.out, n, ["--aruco-length-m", args.aruco_length_m, *more]) for n in counts]
    stages = {name: [run[name]["seconds"] for run in runs] for name in runs[-1]}
    stages = dict(sorted(stages.items(), key=lambda item: -item[1][-1]))
    print("stage    " + "".join(f"{count:>8d}" for count in counts) + "  exponent")
    for name, seconds in stages.items():
        slope = f"{exponent(counts, seconds):10.2f}" if len(counts) > 1 else ""
        print(f"{name:9s}" + "".join(f"{value / 60:8.2f}" for value in seconds) + slope)
    print("minutes  " + "".join(f"{sum(s[i] for s in stages.values()) / 60:8.2f}" for i in range(len(counts))))
    print("peak MiB " + "".join(f"{max(stage['peak_rss_mb'] for stage in run.values()):8.0f}" for run in runs))
    if args.figure is not None:
        draw(args.figure, counts, stages)
    figures: dict[str, float | None] = {}
    for index, (count, run) in enumerate(zip(counts, runs, strict=True)):
        figures |= {f"{name}_{count}_minutes": seconds[index] / 60 for name, seconds in stages.items()}
        figures[f"all_{count}_minutes"] = sum(seconds[index] for seconds in stages.values()) / 60
        figures[f"peak_{count}_mib"] = max(stage["peak_rss_mb"] for stage in run.values())
    if len(counts) > 1:
        figures |= {f"{name}_exponent": exponent(counts, seconds) for name, seconds in stages.items()}
    save_result(args, figures, module="tests.bench.plot_speed", arguments=argv, settings=plot_settings(args.plot))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
