"""Where depth maps and their truth disagree, asked of other photographs: ``python -m tests.bench.judged SCENE``.

For a truth that was itself computed from photographs (``saharov32``). Each view's depth is estimated as ``fsinfer
depth`` does from its first sources; the next sources, which had no part in it, are the judges. Both depths, on the
truth's grid and where there is truth, say which places of a judge show the windows of the view: the depth whose windows
are more alike (mean of the normalised correlations with the best two judges, photographs at half size) by more than
``MARGIN`` is borne out. That is asked where the two differ by more than 1 %, and as a control where they agree within
0.3 %.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fsinfer.io.images import luminance
from fsinfer.scene import View, read_scene, read_view_image
from tests.bench.real_pairs import depth_of_views
from tests.bench.results import add_result_options, check_result_options, save_result
from training.data.confirmed import agree
from training.data.true_scene import DepthsFolder
from training.evaluate import onnx_predictor
from training.full_size import on_truth_grid

Float32 = NDArray[np.float32]
Floats = NDArray[np.float64]
#: Sources of the estimate, and those after them that judge.
SOURCES, JUDGES = 4, 4
#: Side of a window, pixels of the photographs at half size, and the least share of it with depth and in the picture.
WINDOW, LEAST_SHARE = 9, 0.3
#: Difference of the correlations that decides.
MARGIN = 0.05
#: Variance of grey values below which a window tells nothing.
LEAST_VARIANCE = 1.0
#: Relative differences from which on depths disagree, and up to which they agree; a step of the true depth.
WRONG, RIGHT, STEP = 0.01, 0.003, 0.02


def likeness(depth: Float32, view: View, judges: Sequence[View]) -> Float32:
    """(h, w) how alike the windows of a photograph at half size and of the two best judges are, -1 to 1.

    ``depth`` (h, w) belongs to the photograph at half size, 0 is none.
    """
    grey = _half(view)
    scores = np.sort(np.stack([_correlation(depth, grey, view, judge) for judge in judges]), axis=0)
    return np.asarray(scores[-2:].mean(axis=0), dtype=np.float32)


def _half(view: View) -> Float32:
    grey = luminance(read_view_image(view)).astype(np.float32)
    size = grey.shape[1] // 2, grey.shape[0] // 2
    return np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), dtype=np.float32)


def _correlation(depth: Float32, grey: Float32, view: View, judge: View) -> Float32:
    theirs = _half(judge)
    v, u = np.mgrid[: depth.shape[0], : depth.shape[1]]
    pixels = np.stack([2 * u + 0.5, 2 * v + 0.5, np.ones(depth.shape)], axis=-1)
    relative = judge.camera.cam_from_world @ np.linalg.inv(view.camera.cam_from_world)
    points = pixels @ np.linalg.inv(view.camera.intrinsic).T * depth[..., None] @ relative[:3, :3].T + relative[:3, 3]
    lying = points @ judge.camera.intrinsic.T
    ahead = (depth > 0) & (lying[..., 2] > 0)
    z = np.where(ahead, lying[..., 2], 1.0)
    x, y = (np.asarray((lying[..., i] / z - 0.5) / 2, dtype=np.float32) for i in (0, 1))
    known = ahead & (x >= 0) & (y >= 0) & (x <= theirs.shape[1] - 1) & (y <= theirs.shape[0] - 1)
    shown = cv2.remap(theirs, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    weight = known.astype(np.float64)
    share = cv2.blur(weight, (WINDOW, WINDOW))

    def mean(values: Floats) -> Floats:
        summed = cv2.blur(values * weight, (WINDOW, WINDOW))
        return np.asarray(summed / np.maximum(share, 1e-3), dtype=np.float64)

    a, b = grey.astype(np.float64), np.asarray(shown, dtype=np.float64)
    mean_a, mean_b = mean(a), mean(b)
    spread_a, spread_b = (np.maximum(mean(x * x) - m * m, LEAST_VARIANCE) for x, m in ((a, mean_a), (b, mean_b)))
    score = (mean(a * b) - mean_a * mean_b) / np.sqrt(spread_a * spread_b)
    return np.where(share >= LEAST_SHARE, score, -1.0).astype(np.float32)


def at_half_size(depth: Float32, shape: tuple[int, int]) -> Float32:
    """Depth (H, W) on a coarser grid at the size of the photographs at half size; steps stay, holes (0) stay."""
    known = (depth > 0).astype(np.float32)
    inverse = np.divide(1.0, depth, out=np.zeros_like(depth), where=depth > 0)
    size = shape[1], shape[0]
    nearest = cv2.resize(depth, size, interpolation=cv2.INTER_NEAREST)
    smooth = np.maximum(cv2.resize(inverse, size, interpolation=cv2.INTER_LINEAR), np.float32(1e-9))
    whole = cv2.resize(known, size, interpolation=cv2.INTER_LINEAR) > 0.999
    linear = np.where(whole, 1 / smooth, nearest)
    return np.where(np.abs(linear - nearest) > STEP * nearest, nearest, linear).astype(np.float32)


def verdict(depth: Float32, truth: Float32, view: View, judges: Sequence[View]) -> NDArray[np.int8]:
    """(h, w): 1 where the judges bear out the depth, -1 where the truth, 0 undecided; both (h, w) on one grid."""
    height, width = read_view_image(view).shape[:2]
    half = (height // 2, width // 2)
    size = truth.shape[1], truth.shape[0]
    scores = [
        cv2.resize(likeness(at_half_size(one, half), view, judges), size, interpolation=cv2.INTER_AREA)
        for one in (np.where(truth > 0, depth, np.float32(0)), truth)
    ]
    difference = scores[0] - scores[1]
    return np.where(difference > MARGIN, 1, np.where(difference < -MARGIN, -1, 0)).astype(np.int8)


def main(argv: list[str] | None = None) -> int:
    """Estimate, judge, print, write."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.bench.judged", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scene", type=Path)
    parser.add_argument("--model", default="cascade", help="name of a shipped model")
    add_result_options(parser)
    args = parser.parse_args(argv)
    check_result_options(parser, args)
    predict = onnx_predictor(args.model)
    scene = read_scene(args.scene)
    read = DepthsFolder(folder=scene.folder).true_depth
    truths = {view.name: read(view) for view in scene.views}
    counts: dict[str, int] = {}
    views = 0
    for view in scene.views:
        truth = truths[view.name]
        judges = [scene.views[i] for i in view.sources[SOURCES : SOURCES + JUDGES]]
        if truth is None or len(judges) < 2:
            continue
        views += 1
        views_compared = (view, *(scene.views[i] for i in view.sources[:SOURCES]))
        depth = on_truth_grid(depth_of_views(predict, views_compared), truth.shape)
        said = verdict(depth, truth, view, judges)
        votes = np.zeros(truth.shape, np.int64)
        for other in (scene.views[i] for i in view.sources):
            theirs = truths[other.name]
            if theirs is not None:
                votes += agree(truth, view, theirs, other)
        off = np.abs(depth - truth) / np.where(truth > 0, truth, 1)
        parts = {
            "wrong_confirmed": (truth > 0) & (off > WRONG) & (votes >= 2),
            "wrong_unconfirmed": (truth > 0) & (off > WRONG) & (votes < 2),
            "agreeing": (truth > 0) & (off < RIGHT),
        }
        counts["pixels"] = counts.get("pixels", 0) + int((truth > 0).sum())
        for name, part in parts.items():
            for suffix, chosen in (("", part), ("_ours", part & (said > 0)), ("_truth", part & (said < 0))):
                counts[name + suffix] = counts.get(name + suffix, 0) + int(chosen.sum())
    if not views:
        parser.error(f"no view of {args.scene} has a true depth and {SOURCES + 2} sources")
    figures: dict[str, float] = {"views": views, "pixels": counts["pixels"]}
    figures |= {f"{name}_percent": 100 * count / counts["pixels"] for name, count in counts.items() if name != "pixels"}
    for name, value in figures.items():
        print(f"{name:36s} {value:.4g}")
    save_result(args, figures, module="tests.bench.judged", arguments=argv)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
