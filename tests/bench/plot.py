"""A rendered plot through the whole pipeline: ``python -m tests.bench.plot PLOT OUT``.

PLOT is what ``training.synthesize --kind plot`` writes; only its photographs are given to ``fsinfer run``. Printed: the
error of the camera positions and of the scale, and the trees against ``truth.csv`` (positions aligned by the camera
positions, so that the match owes nothing to the diameters).
"""

from __future__ import annotations

import argparse
import csv
import json
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from fsinfer.depth.precision import AUTO, FLOAT32, PRECISIONS
from fsinfer.depth.settings import DepthSettings
from fsinfer.evaluation.figure import plot_evaluation
from fsinfer.evaluation.measured import read_measured
from fsinfer.evaluation.metrics import Evaluation, evaluate
from fsinfer.fusion.fuse import FusionSettings
from fsinfer.io.exif import camera_exif
from fsinfer.io.images import read_image
from fsinfer.io.photo_folders import list_images
from fsinfer.poses.pairs import PairSettings
from fsinfer.poses.settings import DOUBLED, PoseSettings
from fsinfer.progress import silent_stages
from fsinfer.scale.request import ScaleRequest
from fsinfer.scene import read_scene
from fsinfer.threads import in_order, photo_threads
from fsinfer.trees import Tree
from fsinfer.trees.outputs.table import read_trees
from fsinfer.workflow.pipeline import run
from fsinfer.workflow.settings import RunSettings
from tests.bench.classes import MeasuredStem, class_figures, class_lines, nearest_m, truth_of_stems
from tests.bench.results import add_result_options, check_result_options, save_result
from tests.bench.steps import StepClock

# Photos doubled before looking for features, as COLMAP does, and half as many neighbours again; six source views in
# float32. (COLMAP's 8,192 features of doubled photos, 12,300 with their directions, match 1.4 pairs a second.)
SLOW_POSES = PoseSettings(
    enlarge_below_px=100_000,
    enlargement=DOUBLED,
    max_enlarged_features=3000,
    max_features=4096,
    pairs=PairSettings(overlap=12),
)
SLOW_DEPTH = DepthSettings(source_views=6, precision=FLOAT32)
#: Of the JPEG that a phone writes, about.
_PHONE_QUALITY = 92


def similarity(
    source: NDArray[np.float64], target: NDArray[np.float64]
) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
    """Scale, rotation and shift that take points (N, 3) to others in the least-squares sense (Umeyama 1991)."""
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    u, s, vt = np.linalg.svd(b.T @ a)
    sign = np.array([1, 1, np.sign(np.linalg.det(u @ vt))])
    rotation = u @ np.diag(sign) @ vt
    scale = float((s * sign).sum() / (a**2).sum())
    return scale, rotation, target.mean(axis=0) - scale * rotation @ source.mean(axis=0)


def source_errors(path: Path, measured_cm: dict[str, float]) -> dict[str, float]:
    """Errors of the points alone and of the photographs' edges alone; printed too."""
    figures: dict[str, float] = {}
    if not path.is_file():
        return figures
    with path.open(encoding="utf-8", newline="") as stream:
        rows = [row for row in csv.DictReader(stream) if row["tree_id"] in measured_cm]
    for name in ("points", "edges"):
        errors = np.array([float(r[f"{name}_cm"]) - measured_cm[r["tree_id"]] for r in rows if r[f"{name}_cm"]])
        if len(errors):
            rmse, bias, worst = np.sqrt((errors**2).mean()), errors.mean(), np.abs(errors).max()
            print(f"{name} alone: n {len(errors)}, RMSE {rmse:.2f} cm, bias {bias:+.2f} cm, worst {worst:.2f} cm")
            figures |= {
                f"{name}_alone": len(errors),
                f"{name}_alone_rmse_cm": rmse,
                f"{name}_alone_bias_cm": bias,
                f"{name}_alone_worst_cm": worst,
            }
    return figures


def tree_figures(result: Evaluation, inside: Sequence[bool]) -> dict[str, float | None]:
    """The trees against their truth; ``inside`` says of each tree with a DBH whether its interval holds the truth."""
    return {
        "trees": result.n,
        "detected": result.detected,
        "matched": result.matched,
        "completeness_percent": 100 * result.r,
        "omitted": result.omitted,
        "false": result.false,
        "outside": result.outside,
        "rmse_cm": result.rmse_cm,
        "bias_cm": result.bias_cm,
        "mae_cm": result.mae_cm,
        "ae_percent": None if result.ae is None else 100 * result.ae,
        "worst_cm": max((abs(p.extracted_cm - p.measured_cm) for p in result.pairs if p.extracted_cm), default=None),
        "inside_interval": sum(inside),
        "with_interval": len(inside),
    }


def run_figures(summary: dict[str, Any]) -> dict[str, float | None]:
    """What ``plot.json`` says of a run: photographs, depth, seconds of each stage, memory."""
    seconds = {name: float(value) for name, value in summary["seconds"].items()}
    difference = summary["depth_vs_sfm_median_rel"]
    return {
        "photos": summary["photos"],
        "photos_registered": summary["registered"],
        "photos_not_registered": summary["photos"] - summary["registered"],
        "depth_vs_sfm_percent": None if difference is None else 100 * difference,
        "minutes": seconds["total"] / 60,
        "peak_mib": summary["peak_rss_mb"],
        **{f"{name}_s": value for name, value in seconds.items()},
    }


def plot_settings(plot: Path) -> dict[str, Any]:
    """How a rendered plot was drawn: the options of ``training.synthesize``, without folders."""
    path = plot / "synth.json"
    return dict(json.loads(path.read_text(encoding="utf-8"))["options"]) if path.is_file() else {}


def _photos_beside(out: Path) -> Path:
    """An empty folder beside ``out``."""
    folder = out.with_name(f"{out.name}-photos")
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return folder


def torn(photos: Path, out: Path, stretches: Sequence[str]) -> Path:
    """A folder beside ``out`` with the photographs of these stretches, both ends included."""
    folder = _photos_beside(out)
    found = sorted(photos.iterdir())
    for stretch in stretches:
        first, last = (int(number) for number in stretch.split(":"))
        for path in found[first : last + 1]:
            shutil.copy(path, folder)
    return folder


def enlarged(photos: Path, out: Path, side_px: int) -> Path:
    """A folder beside ``out`` with the photographs made ``side_px`` on their longer side: files as large as a phone's.

    They show no more than before: what they tell is what such photographs cost.
    """
    folder = _photos_beside(out)

    def write(path: Path) -> None:
        pixels = read_image(path)
        factor = side_px / max(pixels.shape[:2])
        size = (round(pixels.shape[1] * factor), round(pixels.shape[0] * factor))
        large = np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_CUBIC), np.uint8)
        Image.fromarray(large).save(
            folder / f"{path.stem}.jpg", quality=_PHONE_QUALITY, subsampling=2, exif=camera_exif(path) or b""
        )

    for _ in in_order(write, list_images(photos), photo_threads()):
        pass
    return folder


@dataclass(frozen=True, kw_only=True)
class PlacedTrees:
    """What a run found, in the frame of the truth.

    ``summary`` is the content of ``plot.json``; ``scale`` the factor that its metres still lack; ``residual_m`` (K,)
    how far its cameras lie from ``true_cameras`` (K, 3).
    """

    summary: dict[str, Any]
    trees: list[Tree]
    scale: float
    residual_m: NDArray[np.float64]
    true_cameras: NDArray[np.float64]
    evaluation: Evaluation


@dataclass(frozen=True, kw_only=True)
class Alignment:
    """Similarity from the frame of a run's results to that of the truth, found from the cameras.

    ``target = scale * rotation @ point + shift``; ``residual_m`` (K,) how far the cameras lie from
    ``true_cameras`` (K, 3).
    """

    scale: float
    rotation: NDArray[np.float64]
    shift: NDArray[np.float64]
    residual_m: NDArray[np.float64]
    true_cameras: NDArray[np.float64]

    def placed(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points (N, 3) of the run in the frame of the truth."""
        return np.asarray(self.scale * points @ self.rotation.T + self.shift)

    def evaluate(self, plot: Path, trees: Sequence[Tree]) -> tuple[list[Tree], Evaluation]:
        """The trees at their places in the frame of the truth, and how they compare with ``plot``'s."""
        moved = []
        for tree in trees:
            x, y, _ = self.placed(np.array([tree.x_m, tree.y_m, tree.z_ground_m]))
            moved.append(replace(tree, x_m=float(x), y_m=float(y)))
        return moved, evaluate(read_measured(plot / "truth.csv"), moved, align="never", area_margin_m=1.0)


def align_cameras(plot: Path, out: Path, cloud_from_scene: NDArray[np.float64]) -> Alignment:
    """Alignment of the cameras that a run on the photographs of ``plot`` left in ``out`` to the true ones."""
    truth = {view.name: view.camera.center for view in read_scene(plot).views}
    found = {view.name: view.camera.center for view in read_scene(out / "scene").views}
    names = sorted(found)
    centers = np.array([cloud_from_scene[:3, :3] @ found[n] + cloud_from_scene[:3, 3] for n in names])
    expected = np.array([truth[n] for n in names])
    scale, rotation, shift = similarity(centers, expected)
    residual = np.linalg.norm(scale * centers @ rotation.T + shift - expected, axis=1)
    return Alignment(scale=scale, rotation=rotation, shift=shift, residual_m=residual, true_cameras=expected)


def placed_trees(plot: Path, out: Path) -> PlacedTrees:
    """The trees that a run on the photographs of ``plot`` left in ``out`` against the truth, aligned by the cameras."""
    summary = json.loads((out / "plot.json").read_text(encoding="utf-8"))
    aligned = align_cameras(plot, out, np.array(summary["cloud_from_scene"]))
    trees, result = aligned.evaluate(plot, read_trees(out / "trees.csv"))
    return PlacedTrees(
        summary=summary,
        trees=trees,
        scale=aligned.scale,
        residual_m=aligned.residual_m,
        true_cameras=aligned.true_cameras,
        evaluation=result,
    )


def main(argv: list[str] | None = None) -> int:
    """Run and print the comparison."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.plot", description=__doc__)
    parser.add_argument("plot", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--aruco-length-m", type=float, default=0.25)
    parser.add_argument("--source-views", type=int, default=DepthSettings().source_views)
    parser.add_argument("--halo-ratio", type=float, default=FusionSettings().halo_ratio, help="0 = no halo filter")
    parser.add_argument("--model", default=DepthSettings.model, help="as of fsinfer run")
    parser.add_argument("--precision", choices=PRECISIONS, default=AUTO, help="of the depth network")
    parser.add_argument("--slow", action="store_true", help="spare no time: what the fast settings are held against")
    parser.add_argument(
        "--stretches",
        action="extend",
        nargs="*",
        metavar="FIRST:LAST",
        help="only these photographs, by number: a walk torn on purpose; they are copied to OUT-photos",
    )
    parser.add_argument(
        "--enlarged-px", type=int, metavar="PX", help="photographs enlarged to this longer side, for what they cost"
    )
    parser.add_argument("--judge", action="store_true", help="compare what OUT holds, and run nothing")
    add_result_options(parser)
    args = parser.parse_args(argv)
    check_result_options(parser, args)
    if args.enlarged_px and args.stretches:
        parser.error("give --enlarged-px or --stretches")
    settings = RunSettings(
        depth=DepthSettings(model=args.model, source_views=args.source_views, precision=args.precision),
        fusion=FusionSettings(halo_ratio=args.halo_ratio or None),
        scale=ScaleRequest(aruco_length_m=args.aruco_length_m),
    )
    if args.slow:
        settings = replace(settings, poses=SLOW_POSES, depth=SLOW_DEPTH)
    steps: dict[str, float] = {}
    if not args.judge:
        photos = args.plot / "images"
        given = torn(photos, args.out, args.stretches) if args.stretches else photos
        if args.enlarged_px:
            given = enlarged(photos, args.out, args.enlarged_px)
        # A run that goes on tells of its last steps only.
        clock = None if args.out.exists() else StepClock()
        run(given, args.out, settings=settings, progress=clock or silent_stages)
        steps = clock.figures() if clock else {}
    placed = placed_trees(args.plot, args.out)
    summary, trees, scale, residual, expected = (
        placed.summary, placed.trees, placed.scale, placed.residual_m, placed.true_cameras,
    )  # fmt: skip
    result = placed.evaluation
    by_id = {str(tree.tree_id): tree for tree in trees}
    inside = []
    stems = []
    true_stems = truth_of_stems(args.plot / "truth.csv")
    for pair in result.pairs:
        tree = by_id[pair.extracted_id]
        if pair.extracted_cm is None:
            print(f"tree {pair.measured_id:>3}: {pair.measured_cm:6.2f} cm, not measured: {tree.reason}")
            continue
        low, high = tree.dbh_lo95_cm or 0.0, tree.dbh_hi95_cm or 0.0
        lean_deg, place = true_stems[pair.measured_id]
        stem = MeasuredStem(
            true_cm=pair.measured_cm,
            found_cm=pair.extracted_cm,
            low_cm=low,
            high_cm=high,
            sides=tree.arc_coverage,
            lean_deg=lean_deg,
            camera_m=nearest_m(place, expected),
        )
        stems.append(stem)
        inside.append(stem.inside)
        print(
            f"tree {pair.measured_id:>3}: {pair.measured_cm:6.2f} cm, found {pair.extracted_cm:6.2f} "
            f"[{low:.2f}, {high:.2f}], error {pair.extracted_cm - pair.measured_cm:+5.2f}, "
            f"arc {tree.arc_coverage:.2f}, {tree.status} {tree.reason}"
        )
    for tree in trees:
        if str(tree.tree_id) not in {pair.extracted_id for pair in result.pairs}:
            print(f"without partner: ({tree.x_m:.1f}, {tree.y_m:.1f}), DBH {tree.dbh_cm}, {tree.status} {tree.reason}")
    print(
        f"photos registered: {len(residual)} of {summary['photos']}, "
        f"cameras rms {1000 * np.sqrt((residual**2).mean()):.1f} mm"
    )
    print(f"scale error {100 * (1 / scale - 1):+.3f} %, depth to SfM points {summary['depth_vs_sfm_median_rel']:.5f}")
    print(
        f"n {result.n}, r {100 * result.r:.1f} %, omitted {result.omitted}, false {result.false}, "
        f"outside {result.outside}, RMSE {result.rmse_cm or np.nan:.2f} cm, bias {result.bias_cm or np.nan:+.2f} cm, "
        f"MAE {result.mae_cm or np.nan:.2f} cm, AE {100 * (result.ae or np.nan):.1f} %, "
        f"in their interval {sum(inside)} of {len(inside)}"
    )
    by_class = class_figures(stems)
    print("\n".join(class_lines(by_class)))
    sources = source_errors(args.out / "dbh_sources.csv", {p.extracted_id: p.measured_cm for p in result.pairs})
    print("seconds", summary["seconds"], "peak MB", summary["peak_rss_mb"])
    print("\n".join(f"{name:40s} {value:8.1f}" for name, value in steps.items()))
    plot_evaluation(result, args.out / "evaluation.png")
    figures = {
        **run_figures(summary),
        **steps,
        "cameras_rms_mm": 1000 * float(np.sqrt((residual**2).mean())),
        "cameras_worst_mm": 1000 * float(residual.max()),
        "scale_error_percent": 100 * (1 / scale - 1),
        **tree_figures(result, inside),
        **by_class,
        **sources,
    }
    drawn = {"plot": plot_settings(args.plot), "precision": summary.get("model_precision")}
    save_result(args, figures, module="tests.bench.plot", arguments=argv, settings=drawn)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
