"""Pairs with small baselines against a semi-global matcher: ``python -m tests.bench.stereo --pairs 8``.

Each world gives a reference photograph and one source beside it, at 1, 2, 3 and 6 % of the median depth, as a phone
takes them (exposure of its own, noise, blur; no JPEG). Truth is exact. Judged are the pixels that both photographs
show: the disparity of the depth map of ``field`` with two views, as ``fsinfer depth`` writes it, and that of OpenCV's
StereoSGBM (blocks of five pixels, all eight directions). What SGBM leaves open counts as wrong in its shares and not in
its median.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from fsinfer.depth.settings import DepthSettings
from tests.bench.results import add_result_options, check_result_options, save_result
from training.evaluate import Predict, onnx_predictor
from training.full_size import at_full_size
from training.synthesize.__main__ import parse
from training.synthesize.asked import texture_photos
from training.synthesize.cameras.camera_path import make_camera
from training.synthesize.cameras.photo import expose, random_sensor
from training.synthesize.forest.world import build_world
from training.synthesize.render import Caster
from training.synthesize.scene_writer import with_depth_range
from training.synthesize.small_scenes import walk_cameras, walk_settings

Float32 = NDArray[np.float32]
WIDTH, HEIGHT = 1280, 720
BASELINES_PERCENT = (1.0, 2.0, 3.0, 6.0)
#: A pixel is hidden in the source where something stands so much nearer there, share of the depth.
HIDDEN = 0.01
#: SGBM as OpenCV's documentation proposes for colour pictures, with blocks of five pixels.
BLOCK = 5


@dataclass(frozen=True, kw_only=True)
class Pair:
    """Photographs, intrinsics and depth range of the reference, true depth, baseline in metres, what both show."""

    images: tuple[NDArray[np.uint8], NDArray[np.uint8]]
    intrinsic: NDArray[np.float64]
    depth_range: tuple[float, float]
    depth: Float32
    baseline_m: float
    percent: float
    seen: NDArray[np.bool_]

    @property
    def disparity(self) -> Float32:
        """True disparity (H, W), pixels; 0 for the sky."""
        scale = np.float32(self.intrinsic[0, 0] * self.baseline_m)
        return np.divide(scale, self.depth, out=np.zeros_like(self.depth), where=self.depth > 0)


def pairs_of(seed: int, synthesis: argparse.Namespace) -> list[Pair]:
    """The pairs of one world, from one place of its walk."""
    rng = np.random.default_rng([seed, 1])
    settings = walk_settings(rng, texture_photos(synthesis), synthesis)
    world = build_world(rng, settings)
    caster = Caster.of(world)
    rng = np.random.default_rng([seed, 2])
    cameras = walk_cameras(rng, world, settings.radius_m, photos=60, size=(WIDTH, HEIGHT))
    camera = cameras[int(rng.integers(len(cameras)))]
    depth = caster.depth(camera, WIDTH, HEIGHT)
    picture = caster.picture(camera, WIDTH, HEIGHT, 2)
    sensor = random_sensor(rng, picture)
    reference = expose(rng, sensor, picture)
    ranged = with_depth_range(camera, depth, 30.0)
    middle = float(np.median(depth[depth > 0]))
    pairs = []
    for percent in BASELINES_PERCENT:
        baseline = middle * percent / 100
        pose = camera.cam_from_world.copy()
        pose[0, 3] -= baseline  # to the right
        source = make_camera(camera.intrinsic, pose)
        beside = caster.depth(source, WIDTH, HEIGHT)
        image = expose(rng, sensor, caster.picture(source, WIDTH, HEIGHT, 2))
        pairs.append(
            Pair(
                images=(reference, image),
                intrinsic=camera.intrinsic,
                depth_range=(ranged.depth_min, ranged.depth_max),
                depth=depth,
                baseline_m=baseline,
                percent=percent,
                seen=in_both(depth, beside, float(camera.intrinsic[0, 0]) * baseline),
            )
        )
    return pairs


def in_both(depth: Float32, beside: Float32, scale: float) -> NDArray[np.bool_]:
    """Pixels (H, W) of the reference that the source shows too: nothing nearer stands where they come to lie."""
    disparity = np.divide(scale, depth, out=np.zeros_like(depth), where=depth > 0)
    x, y = np.meshgrid(np.arange(depth.shape[1], dtype=np.float32), np.arange(depth.shape[0], dtype=np.float32))
    there = cv2.remap(beside, x - disparity, y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
    return np.asarray((depth > 0) & (there > depth * (1 - HIDDEN)) & (there < depth * (1 + HIDDEN)))


def ours(predict: Predict, pair: Pair) -> Float32:
    """Disparity (H, W) of the depth that the depth stage would write."""
    intrinsics, poses = np.stack([pair.intrinsic] * 2), np.stack([np.eye(4)] * 2)
    poses[1, 0, 3] = -pair.baseline_m
    depth, _, stride = predict(list(pair.images), intrinsics, poses, pair.depth_range)
    full = at_full_size(depth, stride, pair.depth.shape)
    scale = np.float32(pair.intrinsic[0, 0] * pair.baseline_m)
    return np.divide(scale, full, out=np.zeros_like(full), where=full > 0)


def semi_global(pair: Pair) -> Float32:
    """Disparity (H, W) of StereoSGBM, NaN where it leaves it open."""
    most = 16 * int(np.ceil((pair.intrinsic[0, 0] * pair.baseline_m / pair.depth_range[0] + 1) / 16))
    matcher = cv2.StereoSGBM.create(
        minDisparity=0,
        numDisparities=most,
        blockSize=BLOCK,
        P1=8 * 3 * BLOCK**2,
        P2=32 * 3 * BLOCK**2,
        disp12MaxDiff=1,
        uniquenessRatio=10,
        speckleWindowSize=100,
        speckleRange=2,
        mode=cv2.STEREO_SGBM_MODE_HH,
    )
    # SGBM cannot look beyond the left border: there a wider picture gives it room.
    left, right = (cv2.copyMakeBorder(image, 0, 0, most, 0, cv2.BORDER_REPLICATE) for image in pair.images)
    found = matcher.compute(left, right)[:, most:].astype(np.float32) / 16
    return np.where(found >= 0, found, np.float32(np.nan))


def main(argv: list[str] | None = None) -> int:
    """Render, match, print, write."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.bench.stereo", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--pairs", type=int, default=8, help="worlds, a pair of each baseline in each")
    parser.add_argument("--first-seed", type=int, default=630000)
    parser.add_argument("--textures", help="as of training.synthesize")
    parser.add_argument("--texture-names", help="as of training.synthesize")
    subpixel = DepthSettings().subpixel
    parser.add_argument("--rounds", type=int, default=subpixel.rounds, help="0 leaves the network's depth")
    parser.add_argument("--model", default=DepthSettings.model, help="name of a shipped model")
    add_result_options(parser)
    args = parser.parse_args(argv)
    check_result_options(parser, args)
    options = [
        f"--{name.replace('_', '-')}={v}" for name in ("textures", "texture_names") if (v := getattr(args, name))
    ]
    synthesis = parse(["unused", *options])
    predict = onnx_predictor(args.model, settings=DepthSettings(subpixel=replace(subpixel, rounds=args.rounds)))
    errors: dict[str, dict[float, list[Float32]]] = {
        side: {p: [] for p in BASELINES_PERCENT} for side in (args.model, "sgbm")
    }
    ratio = []
    for seed in range(args.first_seed, args.first_seed + args.pairs):
        for pair in pairs_of(seed, synthesis):
            for side, found in ((args.model, ours(predict, pair)), ("sgbm", semi_global(pair))):
                error = np.abs(found - pair.disparity)[pair.seen]
                errors[side][pair.percent].append(error)
                print(
                    f"seed {seed}, {pair.percent:g} %, {side:5s}: median {np.nanmedian(error):.3f} px, "
                    f"within 1 px {100 * np.mean(error < 1):.1f} %",
                    flush=True,
                )
        known = pair.depth[pair.depth > 0]
        ratio.append(float(np.percentile(known, 99.5) / np.percentile(known, 0.5)))
    figures: dict[str, float] = {"worlds": args.pairs, "greatest_far_over_near": max(ratio)}
    for side, of_side in errors.items():
        for percent, parts in (*of_side.items(), ("all", [e for some in of_side.values() for e in some])):
            error = np.concatenate(parts)
            name = f"{side}_{percent:g}percent" if isinstance(percent, float) else f"{side}_all"
            figures[f"{name}_median_px"] = float(np.nanmedian(error))
            figures[f"{name}_within_1px_percent"] = 100 * float(np.mean(error < 1))
    for name, value in figures.items():
        print(f"{name:36s} {value:.4g}")
    save_result(args, figures, module="tests.bench.stereo", arguments=argv)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
