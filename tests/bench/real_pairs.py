"""Pairs of real photographs against a semi-global matcher: ``python -m tests.bench.real_pairs SCENE``.

Each photograph of SCENE (``depths/*.pfm``) with the one that stands nearest beside it: depth as ``fsinfer depth``
writes it from two views, and that of OpenCV's StereoSGBM on the rectified pair (:mod:`tests.bench.sgm`). Errors are
those of where a pixel comes to lie in the other photograph, in pixels of it. Judged are the pixels whose truth the
other's truth confirms within 1 %: they are seen in both. What SGBM leaves open counts as wrong in its shares and not in
its median. SGBM cannot see nearer than its greatest disparity; ``--most-percent`` bounds the baselines so that it need
not.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fsinfer.io.pfm import read_pfm
from fsinfer.scene import Scene, View, read_scene, read_view_image
from tests.bench.results import add_result_options, check_result_options, save_result
from tests.bench.sgm import depth_of_pair, rectify
from training.data.confirmed import agree
from training.evaluate import Predict, onnx_predictor
from training.full_size import at_full_size, on_truth_grid

Float32 = NDArray[np.float32]
Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class RealPair:
    """A view and the one beside it, their true depths (h, w), 0 unknown, and the baseline over the median depth."""

    view: View
    other: View
    truth: Float32
    their_truth: Float32
    percent: float


def pairs_of(scene: Scene, most_percent: float) -> Iterator[RealPair]:
    """Each view with truth and its nearest neighbour that can be rectified, where that is near enough."""
    truths = {view.name: read_pfm(scene.folder / "depths" / f"{view.name}.pfm") for view in scene.views}
    for view in scene.views:
        truth = truths[view.name]
        height, width = read_view_image(view).shape[:2]
        middle = float(np.median(truth[truth > 0]))
        beside = [
            (100 * float(np.linalg.norm(other.camera.center - view.camera.center)) / middle, index)
            for index, other in enumerate(scene.views)
            if other is not view and rectify(view.camera, other.camera, (width, height)) is not None
        ]
        percent, index = min(beside, default=(np.inf, -1))
        if percent <= most_percent:
            other = scene.views[index]
            yield RealPair(view=view, other=other, truth=truth, their_truth=truths[other.name], percent=float(percent))


def there(depth: Float32, pair: RealPair, shape: tuple[int, int]) -> Floats:
    """(h, w, 2) pixels of the other photograph at which depths (h, w) of the view's, whose shape is given, lie."""
    (h, w), (height, width) = depth.shape, shape
    v, u = np.mgrid[:h, :w]
    pixels = np.stack([(u + 0.5) * width / w - 0.5, (v + 0.5) * height / h - 0.5, np.ones(depth.shape)], axis=-1)
    one, other = pair.view.camera, pair.other.camera
    relative = other.cam_from_world @ np.linalg.inv(one.cam_from_world)
    points = pixels @ np.linalg.inv(one.intrinsic).T * depth[..., None] @ relative[:3, :3].T + relative[:3, 3]
    lying = points @ other.intrinsic.T
    return np.asarray(lying[..., :2] / lying[..., 2:])


def depth_of_views(predict: Predict, views: Sequence[View]) -> Float32:
    """Depth (H, W) of the first of some views, compared with the others, as the depth stage writes it, at full size."""
    images = [read_view_image(view) for view in views]
    depth, _, stride = predict(
        images,
        np.stack([view.camera.intrinsic for view in views]),
        np.stack([view.camera.cam_from_world for view in views]),
        (views[0].camera.depth_min, views[0].camera.depth_max),
    )
    return at_full_size(depth, stride, images[0].shape[:2])


def semi_global(pair: RealPair) -> Float32:
    """Depth (H, W) by StereoSGBM, 0 where it is left open."""
    images = read_view_image(pair.view), read_view_image(pair.other)
    depth = depth_of_pair(images, (pair.view.camera, pair.other.camera))
    return np.nan_to_num(depth, nan=0.0).astype(np.float32)


def errors_of(found: Float32, pair: RealPair) -> Floats:
    """(n,) pixels between where the found depths (H, W) and the confirmed true ones lie, inf where none is found."""
    seen = agree(pair.truth, pair.view, pair.their_truth, pair.other)
    depth = on_truth_grid(found, pair.truth.shape)
    known = seen & (depth > 0)
    shape = (found.shape[0], found.shape[1])
    at = there(np.where(known, depth, np.float32(1)), pair, shape)
    true = there(np.where(seen, pair.truth, np.float32(1)), pair, shape)
    return np.where(known, np.linalg.norm(at - true, axis=-1), np.inf)[seen]


def main(argv: list[str] | None = None) -> int:
    """Match, print, write."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.bench.real_pairs",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("scene", type=Path)
    parser.add_argument("--most-percent", type=float, default=13.0, help="longest baseline, per cent of the depth")
    parser.add_argument("--model", default="cascade", help="name of a shipped model")
    add_result_options(parser)
    args = parser.parse_args(argv)
    check_result_options(parser, args)
    predict = onnx_predictor(args.model)
    errors: dict[str, list[Floats]] = {args.model: [], "sgbm": []}
    percents = []
    for pair in pairs_of(read_scene(args.scene), args.most_percent):
        percents.append(pair.percent)
        for side, found in (
            (args.model, depth_of_views(predict, (pair.view, pair.other))),
            ("sgbm", semi_global(pair)),
        ):
            error = errors_of(found, pair)
            errors[side].append(error)
            print(
                f"{pair.view.name} and {pair.other.name}, {pair.percent:.0f} %, {side:8s}: median "
                f"{np.median(error[np.isfinite(error)]):.3f} px, within 1 px {100 * np.mean(error < 1):.1f} %",
                flush=True,
            )
    if not percents:
        parser.error(f"no two photographs of {args.scene} stand within {args.most_percent:g} % of the depth")
    figures: dict[str, float] = {
        "pairs": len(percents),
        "least_baseline_percent": min(percents),
        "greatest_baseline_percent": max(percents),
    }
    for side, parts in errors.items():
        error = np.concatenate(parts)
        figures[f"{side}_pixels"] = len(error)
        figures[f"{side}_median_px"] = float(np.median(error[np.isfinite(error)]))
        figures[f"{side}_within_quarter_px_percent"] = 100 * float(np.mean(error < 0.25))
        figures[f"{side}_within_1px_percent"] = 100 * float(np.mean(error < 1))
        figures[f"{side}_open_percent"] = 100 * float(np.mean(~np.isfinite(error)))
    for name, value in figures.items():
        print(f"{name:36s} {value:.4g}")
    save_result(args, figures, module="tests.bench.real_pairs", arguments=argv)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
