"""fsinfer beside dendromatics (the engine of 3DFin) on the same simulated plots, accuracy and time.

``python -m tests.bench.dendromatics --python /path/to/venv/bin/python --kind photo --plots 4``, where the other
environment holds ``pip install dendromatics``. Its parameters are tuned to the clouds first: every setting of a grid
runs on the plot before the first one, and the one with the most trees found (then the most diameters, then the least
RMSE) is used. Times are without reading files, that of the processor (all threads) and that of the clock, the median of
``--repeats``; the two take turns, run by run, on the same cores, and dendromatics may use as many threads as it likes.
``--cloud FILE`` compares on a file instead, whose truth is unknown: the setting with the most diameters is timed.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from fsinfer import read_cloud
from fsinfer.trees import analyse_plot
from tests.bench.results import add_result_options, check_result_options, save_result
from training.simulate.stem_cloud import KINDS, CloudSpec, StemCloud, simulate

Floats = NDArray[np.float64]
MAX_DISTANCE_M = 0.3
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
GRID = tuple(
    {"n_points": n, "h_range": h, "section_width": w, "vert_threshold": v}
    for n in (200, 1000)
    for h in (0.7,)
    for w in (0.02, 0.05)
    for v in (0.6, 0.7)
)
# Runs in the other environment: -c, because a script of this name would hide the package.
WORKER = """
import sys, json, time, io, contextlib, numpy as np, dendromatics as d
data, result, settings = sys.argv[1], sys.argv[2], json.loads(sys.argv[3])
cloud = np.load(data)
answers = []
for p in settings:
    start, wall = time.process_time(), time.perf_counter()
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            cloth = d.generate_dtm(d.clean_ground(cloud))
            z0 = d.normalize_heights(cloud, d.clean_cloth(cloth))
            coords = np.column_stack([cloud, z0])
            stripe = coords[(z0 > 0.7) & (z0 < 3.5)]
            clusters = d.verticality_clustering(stripe, n_points=p["n_points"], vert_threshold=p["vert_threshold"])
            assigned, vector, heights = d.individualize_trees(coords, clusters, h_range=p["h_range"])
            sections = np.arange(0.5, 2.6, 0.2)
            sections = np.sort(np.append(sections, 1.3))
            sections = np.unique(sections.round(3))
            x, y, r, _, _, sector, _ = d.compute_sections(
                assigned, sections, section_width=p["section_width"], n_points_section=15)
            outliers = d.tilt_detection(x, y, r, sections)
            dbh, where = d.tree_locator(sections, x, y, vector, sector, r, outliers)
        trees = [[float(a) for a in (*w[:2], 100 * b)] for w, b in zip(where, np.ravel(dbh))]
        answers.append({"trees": trees, "seconds": time.process_time() - start,
                        "wall": time.perf_counter() - wall, "error": ""})
    except Exception as error:
        answers.append({"trees": [], "seconds": time.process_time() - start,
                        "wall": time.perf_counter() - wall, "error": repr(error)[:200]})
json.dump(answers, open(result, "w"))
"""


def dendromatics(
    python: Path, points: Floats, settings: list[dict[str, float]], threads: int = 0
) -> list[dict[str, Any]]:
    """Trees (x_m, y_m, dbh_cm; 0 = none), seconds and error of each setting; ``threads`` 0: as many as it likes."""
    with tempfile.TemporaryDirectory() as folder:
        data, result = Path(folder) / "cloud.npy", Path(folder) / "trees.json"
        np.save(data, points)
        command = [str(python), "-W", "ignore", "-c", WORKER, str(data), str(result), json.dumps(settings)]
        environment = {name: value for name, value in os.environ.items() if name not in THREADS}
        if threads:
            environment |= dict.fromkeys(THREADS, str(threads))
        subprocess.run(command, check=True, capture_output=True, env=environment)
        return list(json.loads(result.read_text(encoding="utf-8")))


def ours(points: Floats) -> dict[str, Any]:
    """The same of fsinfer."""
    start, wall = time.process_time(), time.perf_counter()
    result = analyse_plot(points)
    trees = [[t.x_m, t.y_m, t.dbh_cm or 0.0] for t in result.trees]
    return {"trees": trees, "seconds": time.process_time() - start, "wall": time.perf_counter() - wall, "error": ""}


def in_turn(
    python: Path, points: Floats, setting: dict[str, float], repeats: int, threads: int
) -> dict[str, dict[str, Any]]:
    """Both on the same points, run by run in turn: the last answer of each, with the medians of its times."""
    answers: dict[str, list[dict[str, Any]]] = {"dendromatics": [], "fsinfer": []}
    for _ in range(repeats):
        answers["dendromatics"].append(dendromatics(python, points, [setting], threads)[0])
        answers["fsinfer"].append(ours(points))
    return {
        name: {**runs[-1], **{key: float(np.median([run[key] for run in runs])) for key in ("seconds", "wall")}}
        for name, runs in answers.items()
    }


def compare(cloud: StemCloud, trees: list[list[float]]) -> tuple[int, int, int, list[float]]:
    """True stems, found, false, and the errors in cm of those with a diameter."""
    truth = np.array([[s.x_m, s.y_m] for s in cloud.stems])
    found = np.array(trees, dtype=np.float64).reshape(-1, 3)
    distance = np.linalg.norm(truth[:, None] - found[None, :, :2], axis=2)
    rows, columns = linear_sum_assignment(np.where(distance < MAX_DISTANCE_M, distance, 1e3))
    links = [(i, j) for i, j in zip(rows, columns, strict=True) if distance[i, j] < MAX_DISTANCE_M]
    errors = [float(found[j, 2] - cloud.stems[i].dbh_cm) for i, j in links if found[j, 2] > 0]
    return len(truth), len(links), len(found) - len(links), errors


def line(name: str, rows: list[tuple[int, int, int, list[float]]], seconds: float, wall: float, points: int) -> str:
    """One line of the table."""
    stems, found, false = (sum(column) for column in list(zip(*rows, strict=True))[:3])
    error = np.array([e for r in rows for e in r[3]] or [np.nan])
    return (
        f"{name:>13}: stems {stems}, found {100 * found / stems:.1f} %, false {false}, with DBH {len(error)}, "
        f"RMSE {np.sqrt((error**2).mean()):.2f} cm, median |error| {np.median(np.abs(error)):.2f} cm, "
        f"bias {error.mean():+.2f} cm, processor {seconds:.2f} s, {1e6 * seconds / points:.2f} s per million points, "
        f"clock {wall:.2f} s"
    )


def tuned(python: Path, kind: str, seed: int) -> dict[str, float]:
    """The setting of the grid that does best on one simulated plot."""
    tuning = simulate(seed, CloudSpec(kind=kind))
    setting, best_score = dict(GRID[0]), (-1.0, 0, 0.0)
    for tried, answer in zip(GRID, dendromatics(python, tuning.points, list(GRID)), strict=True):
        _, found, false, errors = compare(tuning, answer["trees"])
        rmse = float(np.sqrt(np.mean(np.square(errors)))) if errors else 99.0
        score = (float(found - false), len(errors), -rmse)
        if score > best_score:
            setting, best_score = dict(tried), score
    return setting


def faster(theirs: dict[str, Any], mine: dict[str, Any]) -> str:
    """How many times less time fsinfer took."""
    return (
        f"fsinfer takes {theirs['seconds'] / mine['seconds']:.1f} times less of the processor, "
        f"{theirs['wall'] / mine['wall']:.1f} times less by the clock"
    )


def time_figures(name: str, answer: dict[str, Any]) -> dict[str, float | None]:
    """Seconds of the processor and by the clock."""
    return {f"{name}_processor_s": float(answer["seconds"]), f"{name}_clock_s": float(answer["wall"])}


def main(argv: list[str] | None = None) -> int:
    """Compare and print."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.dendromatics", description=__doc__)
    parser.add_argument("--python", type=Path, required=True, help="of an environment with dendromatics")
    parser.add_argument("--kind", choices=KINDS, default="lidar")
    parser.add_argument("--plots", type=int, default=4)
    parser.add_argument("--first-seed", type=int, default=2000)
    parser.add_argument("--repeats", type=int, default=3, help="runs of each, in turn, of which the median time counts")
    parser.add_argument(
        "--setting", type=int, choices=range(len(GRID)), help="this setting of the grid, without tuning"
    )
    parser.add_argument("--threads", type=int, default=0, help="of dendromatics; 0: as many as it likes")
    parser.add_argument("--cloud", type=Path, help="a cloud file instead of simulated plots")
    add_result_options(parser)
    args = parser.parse_args(argv)
    check_result_options(parser, args)
    if args.cloud:
        points = read_cloud(args.cloud).xyz
        points = points - np.floor(points.min(axis=0))
        settings = [*GRID] if args.setting is None else [GRID[args.setting]]
        best = 0
        if len(settings) > 1:
            tried = dendromatics(args.python, points, settings)
            for setting, answer in zip(settings, tried, strict=True):
                measured = sum(t[2] > 0 for t in answer["trees"])
                print(setting, len(answer["trees"]), "trees,", measured, "with DBH", answer["error"])
            best = max(range(len(settings)), key=lambda k: sum(t[2] > 0 for t in tried[k]["trees"]))
        print(f"{args.cloud}, {len(points)} points: timed with {settings[best]}")
        both = in_turn(args.python, points, settings[best], args.repeats, args.threads)
        figures: dict[str, float | None] = {"points": len(points)}
        for name, answer in both.items():
            measured = sum(t[2] > 0 for t in answer["trees"])
            print(
                f"{name:>13}: {len(answer['trees'])} trees, {measured} with DBH, "
                f"processor {answer['seconds']:.2f} s, clock {answer['wall']:.2f} s"
            )
            figures |= {f"{name}_found": len(answer["trees"]), f"{name}_measured": measured}
            figures |= time_figures(name, answer)
        print(faster(both["dendromatics"], both["fsinfer"]))
        chosen = {"setting": settings[best]}
        save_result(args, figures, module="tests.bench.dendromatics", arguments=argv, settings=chosen)
        return 0
    setting = tuned(args.python, args.kind, args.first_seed - 1) if args.setting is None else GRID[args.setting]
    print(f"{args.kind}: {setting}")
    rows: dict[str, list[tuple[int, int, int, list[float]]]] = {"dendromatics": [], "fsinfer": []}
    times = {name: {"seconds": 0.0, "wall": 0.0} for name in rows}
    points_total = 0
    for seed in range(args.first_seed, args.first_seed + args.plots):
        cloud = simulate(seed, CloudSpec(kind=args.kind))
        points_total += len(cloud.points)
        for name, answer in in_turn(args.python, cloud.points, setting, args.repeats, args.threads).items():
            if answer["error"]:
                print(f"  seed {seed}: {name}: {answer['error']}", file=sys.stderr)
            rows[name].append(compare(cloud, answer["trees"]))
            for key in times[name]:
                times[name][key] += answer[key]
    figures = {"points": points_total}
    for name, result in rows.items():
        print(line(name, result, times[name]["seconds"], times[name]["wall"], points_total))
        error = np.array([e for row in result for e in row[3]])
        figures |= {
            "stems": sum(row[0] for row in result),
            f"{name}_found": sum(row[1] for row in result),
            f"{name}_false": sum(row[2] for row in result),
            f"{name}_measured": len(error),
            f"{name}_rmse_cm": float(np.sqrt((error**2).mean())) if len(error) else None,
            f"{name}_bias_cm": float(error.mean()) if len(error) else None,
            f"{name}_median_error_cm": float(np.median(np.abs(error))) if len(error) else None,
        }
        figures |= time_figures(name, times[name])
    print(faster(times["dendromatics"], times["fsinfer"]))
    chosen = {"setting": setting, "kind": args.kind, "first_seed": args.first_seed, "plots": args.plots}
    save_result(args, figures, module="tests.bench.dendromatics", arguments=argv, settings=chosen)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
