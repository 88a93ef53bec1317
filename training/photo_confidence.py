"""Fit the curves of :mod:`fsinfer.depth.photo_confidence` and write them into the manifest of a calibrated model.

python -m training.photo_confidence models/cascade.json CALIBRATION_SCENES ...

Fitted on validation scenes; whether it holds elsewhere is what ``python -m training.evaluate TEST --confidence`` shows.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fsinfer.depth.manifest import read_manifest
from fsinfer.depth.model import DepthModel
from fsinfer.depth.photo_confidence import QUANTITIES, ConfidenceCurves, probability, quantities
from fsinfer.depth.precision import FLOAT32
from fsinfer.depth.settings import DepthSettings
from fsinfer.depth.subpixel import normalised
from fsinfer.depth.view_maps import search_range, settled_and_refined
from fsinfer.errors import FsinferError, SceneError
from fsinfer.io.files import write_text
from fsinfer.io.images import read_image
from fsinfer.scene import Scene, View
from training.data.find import find_true_scenes
from training.data.true_scene import TrueScene

Float32 = NDArray[np.float32]

#: Places of a curve, at quantiles of what was seen, and the quantiles of the first and the last.
PLACES, ENDS = 9, (0.005, 0.995)
#: Ridge on what the places add, in pixels: far less than lie at each, so that only what nothing tells stays at 0.
RIDGE = 1.0
#: Steps of the iteratively reweighted least squares; four more change nothing in the fourth digit.
STEPS = 12
#: So much of the weight of a pixel at even odds one that is all but certain keeps at least.
LEAST_WEIGHT = 1e-4


def fit_curves(found: Mapping[str, Float32], good: NDArray[np.bool_], *, places: int = PLACES) -> ConfidenceCurves:
    """Curves for the probability that a pixel is ``good`` (n,), from its quantities (n,) each.

    A logistic regression on piecewise linear curves, by iteratively reweighted least squares with a small ridge.
    """
    at = {name: _places(found[name], places) for name in QUANTITIES}
    columns = [np.ones((len(good), 1), np.float32), *(_hats(found[name], at[name]) for name in QUANTITIES)]
    design = np.concatenate(columns, axis=1)
    penalty = RIDGE * np.eye(design.shape[1])
    penalty[0, 0] = 0.0
    weights = np.zeros(design.shape[1])
    for _ in range(STEPS):
        share = 1 / (1 + np.exp(-(design @ weights)))
        spread = np.maximum(share * (1 - share), LEAST_WEIGHT).astype(np.float32)
        slope = design.T @ (good - share).astype(np.float32) - penalty @ weights
        bend = (design * spread[:, None]).T @ design + penalty
        weights = weights + np.linalg.solve(bend.astype(np.float64), slope.astype(np.float64))
    ends = np.cumsum([1, *(len(at[name]) for name in QUANTITIES)])
    values = {
        name: weights[first:last].astype(np.float32)
        for name, first, last in zip(QUANTITIES, ends[:-1], ends[1:], strict=True)
    }
    return ConfidenceCurves(places=at, values=values, constant=float(weights[0]))


def _places(values: Float32, count: int) -> Float32:
    at = np.unique(np.quantile(values, np.linspace(*ENDS, count)).astype(np.float32))
    return at if len(at) > 1 else np.array([at[0], at[0] + 1], np.float32)


def _hats(values: Float32, at: Float32) -> Float32:
    """(n, K): how much of each of the two places round a value counts; beyond the ends all of the last."""
    clipped = np.clip(values, at[0], at[-1])
    left = np.clip(np.searchsorted(at, clipped, side="right") - 1, 0, len(at) - 2)
    share = (clipped - at[left]) / (at[left + 1] - at[left])
    result = np.zeros((len(values), len(at)), np.float32)
    rows = np.arange(len(values))
    result[rows, left], result[rows, left + 1] = 1 - share, share
    return result


def quantities_of(
    model: DepthModel, scene: Scene, view: View, sources: Sequence[View], settings: DepthSettings
) -> tuple[dict[str, Float32], Float32, int]:
    """What is seen of a view, its depth (h, w), and the stride of both, as the depth stage computes them."""
    images = [read_image(v.image_path) for v in (view, *sources)]
    intrinsics = np.stack([v.camera.intrinsic for v in (view, *sources)])
    poses = np.stack([v.camera.cam_from_world for v in (view, *sources)])
    near, far = view.camera.depth_min, view.camera.depth_max
    searched = search_range(near, far, settings, inverse_depth=model.manifest.inverse_depth)
    estimate = model.predict(images, intrinsics, poses, searched)
    greys = [normalised(image, settings.subpixel) for image in images]
    refined = settled_and_refined(estimate, greys, intrinsics, poses, settings=settings, threads=model.threads)
    if refined.last is None:
        msg = "the curves are of what the sub-pixel step sees, and the settings have none"
        raise ValueError(msg)
    return quantities(estimate.confidence, refined.last), refined.depth, estimate.stride


def truth_of_map(truth: Float32, depth: Float32, stride: int, view: View) -> Float32:
    """The true depth (H, W) of a view at the pixels of its map (h, w); raises :class:`SceneError` if it is smaller."""
    there = truth[::stride, ::stride][: depth.shape[0], : depth.shape[1]]
    if there.shape != depth.shape:
        msg = f"the true depth of {view.name} has not the size of its photograph; scenes of that size are needed"
        raise SceneError(msg)
    return there


def pixels_of(
    model: DepthModel, scenes: Sequence[TrueScene], settings: DepthSettings, *, max_depth: float, share: float
) -> tuple[dict[str, Float32], NDArray[np.bool_]]:
    """Quantities (n,) of a ``share`` of the pixels of all views whose true depth is known and below ``max_depth``, and
    which of them are within 1 % of it."""
    rng = np.random.default_rng(0)
    parts: list[dict[str, Float32]] = []
    good: list[NDArray[np.bool_]] = []
    for true_scene in scenes:
        scene = true_scene.read()
        for view in scene.views:
            sources = [scene.views[i] for i in view.sources[: settings.source_views]]
            truth = true_scene.true_depth(view) if sources else None
            if truth is None:
                continue
            found, depth, stride = quantities_of(model, scene, view, sources, settings)
            there = truth_of_map(truth, depth, stride, view)
            chosen = (there > 0) & (there < max_depth) & (depth > 0) & (rng.random(depth.shape) < share)
            parts.append({name: values[chosen] for name, values in found.items()})
            good.append(np.abs(depth[chosen] / there[chosen] - 1) < 0.01)
    if not good:
        msg = "no view with a true depth map and a source"
        raise SceneError(msg)
    if not any(len(part) for part in good):
        msg = f"no pixel of {len(good)} views has a true depth below {max_depth:g}; give a greater --max-depth"
        raise SceneError(msg)
    return {name: np.concatenate([part[name] for part in parts]) for name in QUANTITIES}, np.concatenate(good)


def main(arguments: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m training.photo_confidence", description=__doc__)
    parser.add_argument("manifest", type=Path, help="NAME.json beside the ONNX files, calibrated")
    parser.add_argument(
        "scenes", type=Path, nargs="+", help="validation scenes with true depth at the photographs' size"
    )
    parser.add_argument("--max-depth", type=float, default=12.0, help="ignore truth beyond, scene units")
    parser.add_argument("--share", type=float, default=0.25, help="of the pixels that are taken")
    args = parser.parse_args(arguments)
    cv2.setNumThreads(1)
    try:
        path = read_manifest(args.manifest).folder / args.manifest.name
        model = DepthModel.load(args.manifest, threads=0, precision=FLOAT32)
        scenes = find_true_scenes(args.scenes, "validation")
        found, good = pixels_of(model, scenes, DepthSettings(), max_depth=args.max_depth, share=args.share)
    except FsinferError as error:
        print(f"Error: {error}")
        return 2
    curves = fit_curves(found, good)
    data = json.loads(path.read_text(encoding="utf-8"))
    data["photo_confidence"] = {
        "constant": round(curves.constant, 5),
        **{
            name: {
                "at": [round(float(v), 5) for v in curves.places[name]],
                "adds": [round(float(v), 5) for v in curves.values[name]],
            }
            for name in QUANTITIES
        },
        "scenes": len(scenes),
        "pixels": len(good),
    }
    write_text(path, json.dumps(data, indent=1) + "\n")
    sure = probability(found, curves)
    order = np.argsort(-sure)[: int(0.7 * len(sure))]
    print(
        f"{len(good)} pixels, {100 * good.mean():.1f} % within 1 %, of the surer 70 % {100 * good[order].mean():.1f} %"
    )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
