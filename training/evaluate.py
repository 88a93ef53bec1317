"""Depth errors of a model on scenes with true depth: ``depths/*.pfm``, the DTU training set, BlendedMVS.

python -m training.evaluate SCENES --model field            the ONNX model, through fsinfer, as it is deployed
python -m training.evaluate SCENES --checkpoint RUN/checkpoint.pt   a checkpoint in PyTorch
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from fsinfer.depth.model import DepthModel
from fsinfer.depth.precision import FLOAT32, PRECISIONS
from fsinfer.depth.settings import DepthSettings
from fsinfer.depth.subpixel import normalised
from fsinfer.depth.view_maps import finish_depth, search_range
from fsinfer.errors import FsinferError, SceneError
from fsinfer.io.images import read_image
from fsinfer.scene import Scene, View
from training.data.confirmed import ConfirmedTruth
from training.data.find import find_true_scenes
from training.data.true_scene import SPLITS, DepthsFolder, TrueScene
from training.full_size import at_full_size, enlarged, on_truth_grid
from training.metrics import DepthErrors, PixelErrors, depth_errors, mean_errors, pixel_errors, pool, pooled_errors

Float32 = NDArray[np.float32]
#: (images, intrinsics, cam_from_world, depth_range) → depth, confidence, stride
Predict = Callable[
    [list[NDArray[np.uint8]], NDArray[np.float64], NDArray[np.float64], tuple[float, float]],
    tuple[Float32, Float32, int],
]


def onnx_predictor(
    model: str | Path,
    threads: int = 0,
    settings: DepthSettings | None = None,
    *,
    calibrate: bool = True,
    precision: str = FLOAT32,
) -> Predict:
    """Predict as :func:`fsinfer.depth.stage.estimate_depth` does; ``calibrate`` = False gives the network's own
    confidence.

    ``precision`` is float32 unless asked for, so that figures of models do not depend on the machine.
    Without calibration the network's depth is left alone: how sure a pixel is, is not known then.
    """
    settings = settings or DepthSettings()
    loaded = DepthModel.load(model, threads=threads, calibrate=calibrate, precision=precision)
    cv2.setNumThreads(1)

    def predict(
        images: list[NDArray[np.uint8]],
        intrinsics: NDArray[np.float64],
        cam_from_world: NDArray[np.float64],
        depth_range: tuple[float, float],
    ) -> tuple[Float32, Float32, int]:
        searched = search_range(*depth_range, settings, inverse_depth=loaded.manifest.inverse_depth)
        estimate = loaded.predict(images, intrinsics, cam_from_world, searched)
        depth, confidence = estimate.depth, estimate.confidence
        if calibrate:
            greys = [normalised(image, settings.subpixel) for image in images]
            depth, confidence = finish_depth(
                estimate,
                greys,
                intrinsics,
                cam_from_world,
                curves=loaded.manifest.photo_confidence,
                settings=settings,
                threads=loaded.threads,
            )
        return depth, confidence, estimate.stride

    return predict


def torch_predictor(checkpoint: Path, settings: DepthSettings | None = None) -> Predict:
    """Predict with PyTorch from a checkpoint."""
    from training.checkpoint import load_checkpoint

    model, _ = load_checkpoint(checkpoint)
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    model.to(device)

    @torch.no_grad()
    def predict(
        images: list[NDArray[np.uint8]],
        intrinsics: NDArray[np.float64],
        cam_from_world: NDArray[np.float64],
        depth_range: tuple[float, float],
    ) -> tuple[Float32, Float32, int]:
        nchw = torch.from_numpy(np.stack(images)).permute(0, 3, 1, 2).float().to(device)
        searched = search_range(*depth_range, settings or DepthSettings(), inverse_depth=model.config.inverse_depth)
        output = model(nchw, torch.from_numpy(intrinsics), torch.from_numpy(cam_from_world), searched)
        return output.depth.cpu().numpy(), output.confidence.cpu().numpy(), output.stride

    return predict


def evaluate_scene(
    predict: Predict,
    scene: Scene,
    *,
    source_views: int = 4,
    every: int = 1,
    min_depth: float = 0.0,
    max_depth: float = np.inf,
    pixels: list[PixelErrors] | None = None,
    true_depth: Callable[[View], Float32 | None] | None = None,
) -> dict[str, DepthErrors]:
    """Errors of every ``every``-th view of a scene, by view name.

    ``pixels`` is given those of each view, to be pooled (:func:`training.metrics.pool`).
    A view without a pixel of truth in the range of depths is left out, of many scenes maybe all of one.
    ``true_depth`` is that of a :class:`training.data.true_scene.TrueScene`; without it ``depths/NAME.pfm`` is read.
    """
    true_depth = true_depth or DepthsFolder(folder=scene.folder).true_depth
    rows = {}
    with_truth = 0
    for view in scene.views[::every]:
        sources = [scene.views[i] for i in view.sources[:source_views]]
        truth = true_depth(view) if sources else None
        if truth is None:
            continue
        with_truth += 1
        images = [read_image(v.image_path) for v in (view, *sources)]
        depth, confidence, stride = predict(
            images,
            np.stack([v.camera.intrinsic for v in (view, *sources)]),
            np.stack([v.camera.cam_from_world for v in (view, *sources)]),
            (view.camera.depth_min, view.camera.depth_max),
        )
        height, width = images[0].shape[:2]
        shape = (truth.shape[0], truth.shape[1])
        depth = on_truth_grid(at_full_size(depth, stride, (height, width)), shape)
        confidence = on_truth_grid(enlarged(confidence, stride, (height, width)), shape)
        errors = depth_errors(depth, confidence, truth, min_depth=min_depth, max_depth=max_depth)
        if pixels is not None:
            pixels.append(pixel_errors(depth, confidence, truth, min_depth=min_depth, max_depth=max_depth))
        if errors is not None:
            rows[f"{scene.folder.name}/{view.name}"] = errors
    if not with_truth:
        msg = f"{scene.folder} has no view with a true depth map and a source; nothing to evaluate"
        raise SceneError(msg)
    return rows


def confidence_curve(confidence: Float32, error: Float32, *, wanted: float = 0.9) -> tuple[list[str], float]:
    """Share of pixels within 1 % by tenths of confidence, and the least threshold above which ``wanted`` of them are.

    ``confidence`` and relative ``error`` (n,) of pixels. Returns the rows of the table and the threshold (1.0 where
    none reaches ``wanted``).
    """
    order = np.argsort(-confidence)
    good = error[order] < 0.01
    share = np.cumsum(good) / np.arange(1, len(good) + 1)
    enough = np.flatnonzero(share >= wanted)
    threshold = float(confidence[order[enough[-1]]]) if len(enough) else 1.0
    tenths = [part for part in np.array_split(order, 10) if len(part)]
    rows = [
        f"confidence {float(confidence[part].max()):.3f} to {float(confidence[part].min()):.3f}, "
        f"mean {float(confidence[part].mean()):.3f}: {100 * (error[part] < 0.01).mean():5.1f} % within 1 %"
        for part in tenths
    ]
    gap = sum(len(p) * abs(float(confidence[p].mean()) - float((error[p] < 0.01).mean())) for p in tenths) / len(order)
    return [*rows, f"mean distance of confidence and share: {gap:.3f}"], threshold


def main(arguments: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m training.evaluate", description=__doc__)
    parser.add_argument(
        "scenes", type=Path, nargs="+", help="folders that are scenes or hold scenes; roots of DTU, BlendedMVS"
    )
    parser.add_argument("--split", choices=SPLITS, default="validation", help="scenes of DTU or BlendedMVS to take")
    parser.add_argument("--model", default=DepthSettings.model, help="name of a shipped model or path of a manifest")
    parser.add_argument("--precision", choices=PRECISIONS, default=FLOAT32, help="of the ONNX regularizer")
    parser.add_argument("--checkpoint", type=Path, help="evaluate this checkpoint in PyTorch instead")
    parser.add_argument("--source-views", type=int, default=4)
    parser.add_argument("--every", type=int, default=1, help="every N-th view of a scene")
    parser.add_argument("--min-depth", type=float, default=0.0, help="ignore truth nearer than this, scene units")
    parser.add_argument("--max-depth", type=float, default=float("inf"), help="ignore truth beyond, scene units")
    parser.add_argument(
        "--min-far-over-near",
        type=float,
        default=DepthSettings().min_far_over_near,
        help="as in fsinfer depth; 1 keeps the camera files' far bound",
    )
    parser.add_argument(
        "--max-far-over-near",
        type=float,
        default=DepthSettings().max_far_over_near,
        help="as in fsinfer depth; inf keeps the camera files' near bound",
    )
    parser.add_argument(
        "--confirmed",
        type=int,
        default=0,
        metavar="N",
        help="judge by the true depth alone that the true maps of N neighbouring views confirm",
    )
    unsure = DepthSettings().unsure
    parser.add_argument("--unsure-below", type=float, default=unsure.below, help="0 leaves unsure pixels alone (ONNX)")
    parser.add_argument("--unsure-radius-px", type=int, default=unsure.radius_px)
    parser.add_argument("--unsure-power", type=float, default=unsure.power)
    after = DepthSettings().unsure_after
    parser.add_argument(
        "--unsure-after-below", type=float, default=after.below, help="likewise after the sub-pixel step"
    )
    subpixel = DepthSettings().subpixel
    parser.add_argument("--subpixel-rounds", type=int, default=subpixel.rounds, help="0 leaves the network's (ONNX)")
    parser.add_argument("--confidence", action="store_true", help="print how the error falls with the confidence")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    args = parser.parse_args(arguments)
    try:
        settings = DepthSettings(
            min_far_over_near=args.min_far_over_near,
            max_far_over_near=args.max_far_over_near,
            unsure=replace(unsure, below=args.unsure_below, radius_px=args.unsure_radius_px, power=args.unsure_power),
            unsure_after=replace(after, below=args.unsure_after_below),
            subpixel=replace(subpixel, rounds=args.subpixel_rounds),
        )
        predict = (
            torch_predictor(args.checkpoint, settings)
            if args.checkpoint
            else onnx_predictor(args.model, settings=settings, precision=args.precision)
        )
        scenes: list[TrueScene] = list(find_true_scenes(args.scenes, args.split))
        if args.confirmed:
            scenes = [ConfirmedTruth(scene=scene, votes=args.confirmed) for scene in scenes]
        if not scenes:
            msg = f"no scene with pair.txt and depths/ in {[str(p) for p in args.scenes]}"
            raise SceneError(msg)
        rows: dict[str, DepthErrors] = {}
        pixels: list[PixelErrors] = []
        for true_scene in scenes:
            found = evaluate_scene(
                predict,
                true_scene.read(),
                source_views=args.source_views,
                every=args.every,
                min_depth=args.min_depth,
                max_depth=args.max_depth,
                pixels=pixels,
                true_depth=true_scene.true_depth,
            )
            rows.update(found)
            if not args.json:
                for name, errors in found.items():
                    print(_line(name, errors.to_dict()), flush=True)
        pooled = pool(pixels)
    except FsinferError as error:
        print(f"Error: {error}")
        return 2
    asked, confirmed = (sum(s.counts[i] for s in scenes if isinstance(s, ConfirmedTruth)) for i in (0, 1))
    share = {"confirmed": confirmed / asked} if asked else {}
    mean = mean_errors(list(rows.values()))
    flying = {key: mean[key] for key in ("flying", "flying_sure")}
    together = pooled_errors(pooled) | flying
    if args.json:
        views = {name: e.to_dict() for name, e in rows.items()}
        print(json.dumps({"mean": mean, "pooled": together, "views": views} | share, indent=1))
    else:
        print(_line(f"mean of {len(rows)} views", mean))
        print(_line("all their pixels together", together))
        if share:
            print(f"{100 * share['confirmed']:.1f} % of the true depth are confirmed")
        if args.confidence:
            table, threshold = confidence_curve(pooled.confidence, pooled.relative)
            print("\n".join([*table, f"90 % are within 1 % from a confidence of {threshold:.3f}"]))
    return 0


def _line(name: str, e: dict[str, float]) -> str:
    return (
        f"{name:28s} median {100 * e['median_rel']:6.3f} %  within 1 %: {100 * e['within_1pct']:5.1f} %  "
        f"surer 70 %: {100 * e['within_1pct_sure']:5.1f} %  abs {e['median_abs']:.4f}  "
        f"sure {e['median_abs_sure']:.4f}  "
        f"sure within 0.03: {100 * e['within_3cm_sure']:5.1f} %  "
        f"flying {100 * e['flying']:4.1f} %, sure {100 * e['flying_sure']:4.1f} %"
    )


if __name__ == "__main__":
    raise SystemExit(main())
