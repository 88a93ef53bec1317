r"""Train variants of the network alike and compare them: the paper's ablation (Table 8, Table 6) on our data.

python -m tests.bench.ablation --data SCENES --test WALKS --plot PLOT --out RUNS --steps 8000 --planes 64 \
    --first-part 0.75

Every variant sees as many samples of the same stream, in windows of one size: with ``--first-part`` it begins with the
cross-entropy over ``--planes``, whatever its own loss is. It is exported and judged as deployed: depth on views held
out (nearer than ``--max-depth``), and on a plot with true cameras the fused cloud's density and the diameters. A run
that was stopped goes on where it was; finished variants are not trained again. ``--stop-after`` trains so many minutes,
to go on another day, and ends with exit code 3 while a variant is not finished.
"""

from __future__ import annotations

import argparse
import json
import logging
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from export.onnx_export import export_model
from fsinfer.depth.settings import DepthSettings
from fsinfer.depth.stage import estimate_depth
from fsinfer.errors import CloudError, FsinferError, SceneError
from fsinfer.evaluation.measured import read_measured
from fsinfer.evaluation.metrics import evaluate
from fsinfer.fusion.fuse import fuse
from fsinfer.io.files import write_text
from fsinfer.placement.place import density_per_m2
from fsinfer.scene import read_scene
from fsinfer.trees import measure_trees
from tests.bench.results import add_result_options, check_result_options, save_result
from training.checkpoint import load_checkpoint
from training.data.find import find_true_scenes
from training.evaluate import evaluate_scene, onnx_predictor
from training.metrics import mean_errors
from training.model import CONFIGS
from training.train import train
from training.train_settings import TrainSettings

PAPER_TABLE = ("mvsnet", "paper-no-bfpn", "paper-no-se", "paper-no-hybrid", "paper", "field")
#: Exit code while a variant is not finished.
UNFINISHED = 3
#: For depth maps: in tiles, which do not change them, ``mvsnet`` takes two to four times as long.
MEMORY_GB = 8.0


@dataclass(frozen=True, kw_only=True)
class AblationRow:
    """One variant: its size and cost, its depth errors, and what a plot looks like through it.

    Attributes
    ----------
    seconds_per_step: of training, on the machine that trained it.
    depth: means over the test views, see :class:`training.metrics.DepthErrors`.
    density_per_m2, r, rmse_cm: of the plot; ``None`` where no cloud or no tree came out.
    """

    name: str
    parameters: int
    steps: int
    seconds_per_step: float
    depth: dict[str, float]
    density_per_m2: float | None = None
    r: float | None = None
    rmse_cm: float | None = None


def run_variant(
    base: TrainSettings, *, test: tuple[Path, ...], plot: Path | None, every: int, max_depth: float
) -> AblationRow | None:
    """Train ``base.preset`` in ``base.out``, export it and judge it; the finished row is kept in ``row.json``.

    ``None`` where ``base.stop_after`` came first.
    """
    kept = base.out / "row.json"
    key = {"steps": base.steps, "crop": list(base.crop), "seed": base.seed, "every": every, "max_depth": max_depth}
    key |= {"planes": base.planes, "first_part": base.first_part}
    # What it is judged on: with a plot that was not asked for before, a kept row had no diameters.
    key |= {"test": [str(folder.resolve()) for folder in test], "plot": None if plot is None else str(plot.resolve())}
    if kept.is_file():
        record = json.loads(kept.read_text(encoding="utf-8"))
        if record["key"] == key:
            return AblationRow(**record["row"])
    model, state = load_checkpoint(train(base))
    if state["step"] < base.steps:
        return None
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    manifest = export_model(model, base.out / "onnx", provenance=state["training"])
    predict = onnx_predictor(manifest)
    errors = [
        row
        for scene in find_true_scenes(test, "test")
        for row in evaluate_scene(
            predict, scene.read(), every=every, max_depth=max_depth, true_depth=scene.true_depth
        ).values()
    ]
    if not errors:
        msg = f"no view of {[str(folder) for folder in test]} has a true depth below --max-depth {max_depth}"
        raise SceneError(msg)
    result = AblationRow(
        name=base.preset,
        parameters=sum(p.numel() for p in model.parameters()),
        steps=state["step"],
        seconds_per_step=state["spent_s"] / max(1, state["step"]),
        depth=mean_errors(errors),
    )
    if plot is not None:
        result = replace(result, **judge_plot(manifest, plot, base.out / "plot"))
    write_text(kept, json.dumps({"key": key, "row": asdict(result)}, indent=1) + "\n")
    return result


def judge_plot(manifest: Path, plot: Path, out: Path) -> dict[str, Any]:
    """Depth, fusion and trees of a rendered plot with its true cameras; its world is in metres with z up."""
    scene = read_scene(plot)
    estimate_depth(scene, out, settings=DepthSettings(model=str(manifest), memory_gb=MEMORY_GB))
    try:
        cloud = fuse(scene, out)
        trees = measure_trees(cloud.xyz)
    except CloudError:
        return {}
    result = evaluate(read_measured(plot / "truth.csv"), trees, align="never", area_margin_m=1.0)
    return {"density_per_m2": density_per_m2(cloud.xyz), "r": result.r, "rmse_cm": result.rmse_cm}


def figures_of(row: AblationRow) -> dict[str, float | None]:
    """A variant's figures, its name before each."""
    return {
        f"{row.name.replace('-', '_')}_{key}": value
        for key, value in {
            "parameters": row.parameters,
            "median_cm": 100 * row.depth["median_abs"],
            "within_1pct_percent": 100 * row.depth["within_1pct"],
            "median_sure_cm": 100 * row.depth["median_abs_sure"],
            "within_3cm_sure_percent": 100 * row.depth["within_3cm_sure"],
            "flying_percent": 100 * row.depth["flying"],
            "density_per_m2": row.density_per_m2,
            "completeness_percent": None if row.r is None else 100 * row.r,
            "rmse_cm": row.rmse_cm,
        }.items()
    }


def table(rows: list[AblationRow]) -> str:
    """The rows in Markdown."""
    lines = [
        "| variant | parameters | s/step | median, cm | within 1 % | surer 70 %: median, cm | within 3 cm | flying "
        "| points/m² | r | RMSE, cm |",
        "|" + "---|" * 11,
    ]
    for row in rows:
        d = row.depth
        cells = [
            row.name,
            f"{row.parameters:,}",
            f"{row.seconds_per_step:.2f}",
            f"{100 * d['median_abs']:.2f}",
            f"{100 * d['within_1pct']:.1f} %",
            f"{100 * d['median_abs_sure']:.2f}",
            f"{100 * d['within_3cm_sure']:.1f} %",
            f"{100 * d['flying']:.1f} %",
            "-" if row.density_per_m2 is None else f"{row.density_per_m2:.0f}",
            "-" if row.r is None else f"{100 * row.r:.0f} %",
            "-" if row.rmse_cm is None or np.isnan(row.rmse_cm) else f"{row.rmse_cm:.2f}",
        ]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    """Command line."""
    default = TrainSettings(data=(), out=Path())
    parser = argparse.ArgumentParser(prog="python -m tests.bench.ablation", description=__doc__)
    parser.add_argument(
        "--data", action="extend", type=Path, nargs="+", required=True, help="folders with training scenes"
    )
    parser.add_argument(
        "--test", action="extend", type=Path, nargs="+", required=True, help="folders with held-out scenes"
    )
    parser.add_argument("--plot", type=Path, help="a rendered plot (--kind plot) for density and diameters")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--variants", nargs="+", choices=sorted(CONFIGS), default=list(PAPER_TABLE))
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--planes", type=int, default=default.planes, help="as of training.train")
    parser.add_argument("--first-part", type=float, default=default.first_part, metavar="SHARE", help="likewise")
    parser.add_argument("--amp", action=argparse.BooleanOptionalAction, help="likewise")
    parser.add_argument("--stop-after", type=float, default=0.0, metavar="MINUTES", help="train no longer; go on later")
    parser.add_argument("--crop", type=int, nargs=2, default=(32, 24), metavar=("W", "H"))
    parser.add_argument("--every", type=int, default=1, help="every N-th view of a test scene")
    parser.add_argument("--max-depth", type=float, default=6.0)
    parser.add_argument("--seed", type=int, default=default.seed)
    parser.add_argument("--threads", type=int, default=default.threads)
    add_result_options(parser)
    args = parser.parse_args(arguments)
    check_result_options(parser, args)
    rows = []
    began = time.monotonic()
    try:
        for name in args.variants:
            left = args.stop_after - (time.monotonic() - began) / 60
            if args.stop_after and left <= 0:
                print(f"{name} is next")
                return UNFINISHED
            settings = TrainSettings(
                data=tuple(args.data),
                out=args.out / name,
                preset=name,
                steps=args.steps,
                minutes=1e6,
                stop_after=left if args.stop_after else 0.0,
                planes=args.planes,
                first_part=args.first_part,
                amp=args.amp,
                crop=tuple(args.crop),
                min_sources=2,
                max_sources=3,
                checkpoint_every=100,
                seed=args.seed,
                threads=args.threads,
            )
            row = run_variant(
                settings, test=tuple(args.test), plot=args.plot, every=args.every, max_depth=args.max_depth
            )
            if row is None:
                print(f"{name} is not finished")
                return UNFINISHED
            rows.append(row)
            print(table(rows), flush=True)
    except FsinferError as error:
        print(f"Error: {error}")
        return 2
    figures: dict[str, float | None] = {}
    for row in rows:
        figures |= figures_of(row)
    trained = {name: getattr(args, name) for name in ("steps", "planes", "first_part", "crop", "seed")}
    save_result(args, figures, module="tests.bench.ablation", arguments=arguments, settings=trained)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
