"""Time and memory of ``fsinfer trees`` against the size of the cloud: ``python -m tests.bench.cloud_size WORK_FOLDER``.

Simulated plots (:mod:`training.simulate.stem_cloud`) are laid side by side, turned and jittered, until a LAS file has
the points asked for; each file is measured in a process of its own, whose seconds (wall clock, processor) and peak
resident memory are recorded beside the errors against the truth. Writes ``cloud_size.csv`` into the work folder and the
figure where ``--figure`` says. The 10^8 points take 3 GB of disk; a file is removed after it was measured.
"""

from __future__ import annotations

import argparse
import csv
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fsinfer.io.las_writing import las_writer
from fsinfer.trees.outputs.table import read_trees
from tests.bench.results import add_result_options, check_result_options, save_result
from training.simulate.stem_cloud import KINDS, CloudSpec, simulate

Floats = NDArray[np.float64]
SIZES = (1_000_000, 3_000_000, 10_000_000, 30_000_000, 100_000_000)
TILE_M = 15.0  # a simulated plot is 12.2 m wide, with a metre of ground around it
SEEDS = 4
POLL_S = 0.1
SPACING_M = 0.004  # of a dense terrestrial scan: 10^8 points are a plot of 70 x 70 m with 550 stems
MAX_DISTANCE_M = 0.3
TURNS = tuple(np.array([[c, -s], [s, c]], dtype=np.float64) for c, s in ((1, 0), (0, 1), (-1, 0), (0, -1)))


def write_tiled(path: Path, points: int, kind: str) -> Floats:
    """A LAS file of ``points`` points; returns the truth (T, 3): x, y, DBH in cm of all stems."""
    rng = np.random.default_rng(0)
    # The ground is level on average, so that the tiles fit.
    spec = CloudSpec(kind=kind, slope_deg=(0.0, 0.0), spacing_m=(SPACING_M, SPACING_M))
    tiles = [simulate(seed, spec) for seed in range(5000, 5000 + SEEDS)]
    middle = 0.5 * float(np.sqrt(25 * CloudSpec().area_per_tree_m2))
    sizes: list[int] = []
    while sum(sizes) < points:
        sizes.append(len(tiles[len(sizes) % SEEDS].points))
    side = int(np.ceil(np.sqrt(len(sizes))))
    share = points / sum(sizes)
    truth: list[Floats] = []
    left = points
    high = np.array([side * TILE_M, side * TILE_M, 10.0])
    with las_writer(path, np.array([0.0, 0.0, -1.0]), high, colour=False, kinds={}) as append:
        for number, size in enumerate(sizes):
            tile, turn = tiles[number % SEEDS], TURNS[rng.integers(4)]
            shift = TILE_M * (np.array([number % side, number // side]) + 0.5)
            count = left if number == len(sizes) - 1 else min(round(share * size), left)
            chosen = rng.choice(size, min(count, size), replace=False)
            xyz = tile.points[np.sort(chosen)] + rng.normal(0.0, 0.0005, (len(chosen), 3))
            xyz[:, :2] = (xyz[:, :2] - middle) @ turn.T + shift
            append(xyz, None, {})
            left -= len(chosen)
            for stem in tile.stems:
                at = turn @ (np.array([stem.x_m, stem.y_m]) - middle) + shift
                truth.append(np.array([*at, stem.dbh_cm]))
    return np.array(truth)


def measure(path: Path, out: Path) -> dict[str, float]:
    """Run ``fsinfer trees`` in a process of its own: wall and processor seconds, peak resident memory in MB."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    start = time.perf_counter()
    command = [
        sys.executable,
        "-c",
        "from fsinfer.cli import main; main()",
        "trees",
        str(path),
        str(out),
        "--quiet",
    ]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    peak_kb = 0
    # Not ru_maxrss: a child starts with the high-water mark of the process that it was forked from.
    while process.poll() is None:
        peak_kb = max(peak_kb, high_water_kb(process.pid))
        time.sleep(POLL_S)
    if process.returncode != 0:
        raise SystemExit(f"{path}: fsinfer trees ended with {process.returncode}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return {
        "seconds": time.perf_counter() - start,
        "cpu_seconds": after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime,
        "peak_rss_mb": peak_kb / 1024,
    }


def high_water_kb(pid: int) -> int:
    """Largest resident memory of a process so far; 0 when it has just ended."""
    try:
        lines = (Path("/proc") / str(pid) / "status").read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:
        return 0
    return max((int(line.split()[1]) for line in lines if line.startswith("VmHWM:")), default=0)


def judge(truth: Floats, out: Path) -> dict[str, float]:
    """Stems, those found within 0.3 m, false ones, those measured, RMSE and bias in cm."""
    trees = read_trees(out / "trees.csv")
    distance, nearest = cKDTree(truth[:, :2]).query([[t.x_m, t.y_m] for t in trees])
    near = distance < MAX_DISTANCE_M
    error = np.array(
        [t.dbh_cm - truth[i, 2] for t, i, ok in zip(trees, nearest, near, strict=True) if ok and t.dbh_cm is not None]
    )
    return {
        "stems": len(truth),
        "found": len(np.unique(nearest[near])),
        "false": int((~near).sum()),
        "measured": len(error),
        "rmse_cm": float(np.sqrt((error**2).mean())),
        "median_error_cm": float(np.median(np.abs(error))),
        "bias_cm": float(error.mean()),
    }


def plot(rows: list[dict[str, Any]], path: Path) -> None:
    """Seconds and memory against points, with the line through the origin that the largest cloud sets."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    millions = np.array([row["points"] for row in rows]) / 1e6
    figure = Figure(figsize=(9.0, 3.8), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    left.loglog(millions, [row["cpu_seconds"] for row in rows], "o-", color="#2b5c8a", label="fsinfer trees")
    left.loglog(millions, rows[-1]["cpu_seconds"] * millions / millions[-1], ":", color="0.5", label="linear")
    left.set(xlabel="million points", ylabel="processor seconds")
    right.semilogx(millions, [row["peak_rss_mb"] / 1024 for row in rows], "o-", color="#2b5c8a")
    right.axhline(4.0, color="#d1495b", linestyle="--", label="4 GB")
    right.set(xlabel="million points", ylabel="peak resident memory, GB", ylim=(0.0, 4.4))
    for axes in (left, right):
        axes.grid(color="0.93", which="both")
        axes.set_axisbelow(True)
        axes.legend(frameon=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=130)


def main(argv: list[str] | None = None) -> int:
    """Make, measure, print, draw."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.cloud_size", description=__doc__)
    parser.add_argument("work", type=Path, help="folder for clouds and results")
    parser.add_argument("--kind", choices=KINDS, default="lidar")
    parser.add_argument("--points", type=float, nargs="+", default=list(SIZES))
    parser.add_argument("--figure", type=Path, help="PNG of time and memory against points")
    parser.add_argument("--keep", action="store_true", help="keep the clouds")
    add_result_options(parser)
    args = parser.parse_args(argv)
    check_result_options(parser, args)
    args.work.mkdir(parents=True, exist_ok=True)
    table = args.work / "cloud_size.csv"
    rows: list[dict[str, Any]] = []
    for points in (round(p) for p in args.points):
        cloud, out = args.work / f"cloud_{points}.las", args.work / f"trees_{points}"
        truth = write_tiled(cloud, points, args.kind)
        row = {"points": points, "kind": args.kind, **measure(cloud, out), **judge(truth, out)}
        rows.append(row)
        print(", ".join(f"{k} {v:.3g}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items()), flush=True)
        (out / "trees.laz").unlink(missing_ok=True)
        if not args.keep:
            cloud.unlink()
        with table.open("w", newline="", encoding="utf-8") as handle:
            writer = csv.DictWriter(handle, list(row))
            writer.writeheader()
            writer.writerows(rows)
    figures = {
        f"{name}_{row['points']}": value
        for row in rows
        for name, value in row.items()
        if name not in ("points", "kind")
    }
    save_result(args, figures, module="tests.bench.cloud_size", arguments=argv, settings={"kind": args.kind})
    if args.figure:
        plot(sorted(rows, key=lambda row: int(row["points"])), args.figure)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
