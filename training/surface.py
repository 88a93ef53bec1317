"""Train the network of :mod:`fsinfer.depth.surface` on the depth maps of an exported model.

python -m training.surface models/cascade.json SCENES ... --out training/checkpoints/cascade_surface.pt

The model computes the depth of every view as it is deployed, with one to four sources drawn at random. A pixel is
right where its depth is within 2 % of the true one, and wrong where it is not or where nothing is within reach: in the
sky and the far wood of rendered photographs (a true depth of 0), where the map carries stems on beyond their
silhouettes.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel

from fsinfer.depth.manifest import ModelManifest, read_manifest
from fsinfer.depth.model import DepthModel
from fsinfer.depth.precision import AUTO, PRECISIONS
from fsinfer.depth.settings import DepthSettings
from fsinfer.depth.view_maps import search_range
from fsinfer.errors import FsinferError, ModelError, SceneError
from fsinfer.io.images import read_image
from fsinfer.scene import Scene, View
from training.checkpoint import read_state
from training.data.find import find_true_scenes
from training.data.true_scene import TrueScene
from training.model.surface import SurfaceHead, surface_inputs
from training.photo_confidence import truth_of_map

Float32 = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class SurfaceTraining:
    """Constants of the training. Source of all: judgement, except where said otherwise.

    Attributes
    ----------
    right_within: relative error of a depth that is of the right surface; a stem is farther than that from what stands
        behind it.
    sources: numbers of sources, one of which is drawn for each view; four are usual.
    near_share, near_pull: of so many views the near bound is drawn in by up to so many times, as that of camera files.
    width: channels of the network. Source: 16, 24 and 32 were compared (docs/trials-accuracy.md).
    window_px: height and width of a window of the map; windows: of each step.
    learning_rate, weight_decay: of AdamW, with one cycle (Smith and Topin 2019).
    edge_px, edge_planes: where the index within so many pixels spans so many planes a pixel counts more,
        ``else_weight`` elsewhere.
    gain, noise: of the features, standard deviations of a factor and of what is added, share of their mean size.
    average: of the weights, from step to step.
    """

    right_within: float = 0.02
    sources: tuple[int, ...] = (1, 2, 3, 4, 4, 4)
    near_share: float = 0.3
    near_pull: float = 4.0
    width: int = 16
    window_px: tuple[int, int] = (192, 320)
    windows: int = 2
    learning_rate: float = 2e-3
    weight_decay: float = 1e-3
    edge_px: int = 2
    edge_planes: float = 3.0
    else_weight: float = 0.3
    gain: float = 0.1
    noise: float = 0.05
    average: float = 0.998


@dataclass(frozen=True, kw_only=True)
class Sample:
    """A view: ``features`` (C, H, W) float16, ``index``, ``confidence`` (H, W) float32, ``right`` (H, W) bool."""

    features: NDArray[np.float16]
    index: Float32
    confidence: Float32
    right: NDArray[np.bool_]


def sample_of(
    model: DepthModel, view: View, sources: Sequence[View], truth: Float32, near_pull: float, within: float
) -> Sample:
    """What the network is given of a view, and where its depth is right; maps are cut to even sizes."""
    group = [view, *sources]
    features = model.features_of([read_image(v.image_path) for v in group])
    settings = DepthSettings()
    near, far = search_range(view.camera.depth_min, view.camera.depth_max, settings, inverse_depth=True)
    near /= near_pull
    estimate = model.predict_from_features(
        features,
        np.stack([v.camera.intrinsic for v in group]),
        np.stack([v.camera.cam_from_world for v in group]),
        (near, far),
    )
    half = features[0].half
    if half is None:
        msg = f"model {model.manifest.name} has no features at half of the resolution"
        raise ModelError(msg)
    there = truth_of_map(truth, estimate.depth, estimate.stride, view)
    height, width = (size - size % 2 for size in there.shape)
    depth, there = estimate.depth[:height, :width], there[:height, :width]
    planes = np.float32((model.manifest.planes - 1) / (1 / near - 1 / far))
    index = np.asarray((np.float32(1) / depth - np.float32(1 / far)) * planes, np.float32)
    error = np.abs(depth / np.maximum(there, np.float32(1e-6)) - 1)
    return Sample(
        features=half.to_chw()[:, :height, :width].astype(np.float16),
        index=index,
        confidence=estimate.confidence[:height, :width],
        right=(there > 0) & (error < within),
    )


def samples_of(
    model: DepthModel, scenes: Sequence[TrueScene], settings: SurfaceTraining, rng: np.random.Generator
) -> Iterator[Sample]:
    """Every view of the scenes that has a true depth and a source."""
    for true_scene in scenes:
        scene: Scene = true_scene.read()
        for view in scene.views:
            near_by = rng.permutation(view.sources[: DepthSettings().source_views + 1])
            sources = [scene.views[i] for i in near_by[: rng.choice(settings.sources)]]
            pull = rng.uniform(1, settings.near_pull) if rng.random() < settings.near_share else 1.0
            truth = true_scene.true_depth(view) if sources else None
            if truth is not None:
                yield sample_of(model, view, sources, truth, pull, settings.right_within)


def at_edges(index_nhw: Tensor, settings: SurfaceTraining) -> Tensor:
    """(N, H, W) bool: where the index spans several planes within a few pixels."""
    side = 2 * settings.edge_px + 1
    most, least = (F.max_pool2d(sign * index_nhw[:, None], side, 1, settings.edge_px)[:, 0] for sign in (1, -1))
    return most + least > settings.edge_planes


def loss_of(logits_n4hw: Tensor, index_nhw: Tensor, right_nhw: Tensor, settings: SurfaceTraining) -> Tensor:
    """Cross-entropy of the probability that a pixel is right, weighted towards the steps of the depth."""
    logits = F.pixel_shuffle(logits_n4hw, 2)[:, 0]
    weight = settings.else_weight + at_edges(index_nhw, settings).float()
    entropy = F.binary_cross_entropy_with_logits(logits, right_nhw.float(), reduction="none")
    return (entropy * weight).sum() / weight.sum()


def train_surface(
    samples: Sequence[Sample], *, steps: int, settings: SurfaceTraining | None = None, seed: int = 1
) -> SurfaceHead:
    """Train on windows drawn from the samples; the weights are a moving average, in evaluation mode."""
    s = settings or SurfaceTraining()
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    head = SurfaceHead(features=len(samples[0].features), width=s.width)
    head.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    average = AveragedModel(head, avg_fn=partial(_towards, share=s.average), use_buffers=True)
    optimizer = torch.optim.AdamW(head.parameters(), lr=s.learning_rate, weight_decay=s.weight_decay)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, s.learning_rate, total_steps=steps, pct_start=0.05)
    started, losses = time.monotonic(), []
    for step in range(steps):
        chosen = [_window(samples[int(rng.integers(len(samples)))], s.window_px, rng) for _ in range(s.windows)]
        features, index, confidence, right = (torch.stack(part) for part in zip(*chosen, strict=True))
        features = features * torch.exp(s.gain * torch.randn(len(chosen), 1, 1, 1))
        features = features + s.noise * torch.rand(1) * features.abs().mean() * torch.randn_like(features)
        inputs = surface_inputs(features, index, confidence).contiguous(memory_format=torch.channels_last)
        loss = loss_of(head(inputs), index, right, s)
        optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(head.parameters(), 5.0)
        optimizer.step()
        schedule.step()
        average.update_parameters(head)
        losses.append(float(loss.detach()))
        if (step + 1) % 500 == 0 or step + 1 == steps:
            left = (time.monotonic() - started) * (steps / (step + 1) - 1)
            print(f"step {step + 1} of {steps}, loss {np.mean(losses[-500:]):.4f}, {left:.0f} s left", flush=True)
    return cast(SurfaceHead, average.module).eval()


def _towards(average: Tensor, value: Tensor, steps: Tensor, *, share: float) -> Tensor:
    """The average after a step, which keeps ``share`` of itself, and less while the first steps are in it."""
    kept = min(share, (int(steps) + 1) / (int(steps) + 20))
    return kept * average + (1 - kept) * value


def _window(sample: Sample, window_px: tuple[int, int], rng: np.random.Generator) -> list[Tensor]:
    """A window of the maps, which begins at an even row and column."""
    cuts = []
    for size, wanted in zip(sample.index.shape, window_px, strict=True):
        length = min(wanted, size)
        first = 2 * int(rng.integers(0, (size - length) // 2 + 1))
        cuts.append(slice(first, first + length))
    return _maps(sample, *cuts)


def _maps(sample: Sample, rows: slice = slice(None), columns: slice = slice(None)) -> list[Tensor]:
    """Features, index, confidence and what is right, of all of a view or of a part."""
    parts = (sample.features, sample.index, sample.confidence, sample.right)
    return [torch.from_numpy(np.ascontiguousarray(part[..., rows, columns])).float() for part in parts]


def save_surface(head: SurfaceHead, path: Path, model: ModelManifest, training: dict[str, Any]) -> None:
    """Write the weights, of whose depth maps they tell, and how they were trained."""
    path.parent.mkdir(parents=True, exist_ok=True)
    state = {
        "config": {"features": head.features, "width": head.width},
        "average": head.state_dict(),
        "model_weights_sha256": model.details["weights_sha256"],
        "training": training,
    }
    torch.save(state, path)


def load_surface(path: Path) -> tuple[SurfaceHead, dict[str, Any]]:
    """The network in evaluation mode, and the other entries of its checkpoint; raises :class:`ModelError`."""
    state = read_state(path)
    try:
        head = SurfaceHead(features=int(state["config"]["features"]), width=int(state["config"]["width"]))
        head.load_state_dict(state["average"])
        found = {key: state[key] for key in ("model_weights_sha256", "training")}
    except Exception as error:  # of any kind that a wrong architecture or wrong weights raise in torch
        msg = f"{path} is not a checkpoint of training.surface ({error})"
        raise ModelError(msg) from error
    return head.eval(), found


@torch.no_grad()
def right_of_surer(head: SurfaceHead, samples: Sequence[Sample], settings: SurfaceTraining) -> tuple[float, float]:
    """Of the pixels at steps of the depth, how many of the surer half are right: by the confidence alone, and by that
    times what the network says. Means of the samples that have steps, NaN without one.
    """
    alone: list[float] = []
    both: list[float] = []
    for sample in samples:
        features, index, confidence, right = (part[None] for part in _maps(sample))
        logits = F.pixel_shuffle(head(surface_inputs(features, index, confidence)), 2)[:, 0]
        chosen = at_edges(index, settings)
        if not chosen.any():
            continue
        for shares, sure in ((alone, confidence), (both, confidence * torch.sigmoid(logits))):
            order = torch.argsort(sure[chosen], descending=True)
            shares.append(float(right[chosen][order[: len(order) // 2]].mean()))
    return (float(np.mean(alone)), float(np.mean(both))) if alone else (math.nan, math.nan)


def main(arguments: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m training.surface", description=__doc__)
    parser.add_argument("manifest", type=Path, help="NAME.json beside the ONNX files")
    parser.add_argument(
        "scenes", type=Path, nargs="+", help="rendered scenes with true depth, photographs at full size"
    )
    parser.add_argument(
        "--validation", action="extend", type=Path, nargs="*", default=[], help="other scenes, which are only looked at"
    )
    parser.add_argument("--out", type=Path, required=True, help="checkpoint")
    parser.add_argument("--steps", type=int, default=6000)
    parser.add_argument("--width", type=int, default=SurfaceTraining.width)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--precision", choices=PRECISIONS, default=AUTO, help="of the model's graphs")
    args = parser.parse_args(arguments)
    cv2.setNumThreads(1)
    settings = SurfaceTraining(width=args.width)
    started = time.monotonic()
    try:
        manifest = read_manifest(args.manifest)
        model = DepthModel.load(args.manifest, calibrate=False, precision=args.precision)
        scenes = find_true_scenes(args.scenes)
        rng = np.random.default_rng(args.seed)
        samples = list(samples_of(model, scenes, settings, rng))
        held_out = list(samples_of(model, find_true_scenes(args.validation, "validation"), settings, rng))
        if not samples:
            msg = f"no view with a true depth map and a source in {[str(p) for p in args.scenes]}"
            raise SceneError(msg)
    except FsinferError as error:
        print(f"Error: {error}")
        return 2
    print(f"{len(samples)} views of {len(scenes)} scenes, {time.monotonic() - started:.0f} s", flush=True)
    head = train_surface(samples, steps=args.steps, settings=settings, seed=args.seed)
    training = {
        "scenes": len(scenes),
        "views": len(samples),
        "steps": args.steps,
        "seed": args.seed,
        "seconds": round(time.monotonic() - started),
    }
    save_surface(head, args.out, manifest, training)
    for name, part in (("training", samples[::10]), ("validation", held_out)):
        if part:
            alone, both = right_of_surer(head, part, settings)
            print(f"{name}: right of the surer half at steps of the depth: {100 * alone:.1f} %, now {100 * both:.1f} %")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
