"""Turn a model's confidence into the probability that a depth is within 1 %, and write it into the manifest.

python -m training.calibration models/field.json VALIDATION_WALKS

Fitted on validation scenes; whether it holds elsewhere is what ``python -m training.evaluate TEST --confidence`` shows.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import isotonic_regression

from fsinfer.depth.manifest import read_manifest
from fsinfer.errors import FsinferError, SceneError
from fsinfer.io.files import write_text
from training.data.find import find_true_scenes
from training.evaluate import confidence_curve, evaluate_scene, onnx_predictor
from training.metrics import PixelErrors, pool

Float32 = NDArray[np.float32]


def fit_calibration(confidence: Float32, good: NDArray[np.bool_], *, knots: int = 33) -> tuple[Float32, Float32]:
    """Raw confidences (k,) and the share of good pixels at each (k,), both rising: isotonic regression on quantiles.

    ``confidence`` (n,) and ``good`` (n,) are pixels; ``knots`` bins of equally many pixels are averaged first, so that
    the regression (Zadrozny and Elkan 2002) cannot follow single pixels.
    """
    order = np.argsort(confidence, kind="stable")
    bins = [part for part in np.array_split(order, knots) if len(part)]
    raw = np.array([confidence[part].mean(dtype=np.float64) for part in bins]).astype(np.float32)
    share = isotonic_regression(
        [float(good[part].mean()) for part in bins], weights=[float(len(part)) for part in bins]
    ).x
    raw, first = np.unique(np.maximum(raw, np.float32(1e-6)), return_index=True)
    # A little slope keeps the ranking where the regression is flat: fusion takes a percentile of the confidences.
    share = np.clip(share[first] + 1e-4 * np.arange(len(raw)), 0, 1)
    # From 0, where nothing is known, to 1; in between, the bins.
    return (
        np.concatenate([[0.0], raw, [1.0 + 1e-6]]).astype(np.float32),
        np.concatenate([[0.0], share, [share[-1]]]).astype(np.float32),
    )


def main(arguments: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m training.calibration", description=__doc__)
    parser.add_argument("manifest", type=Path, help="NAME.json beside the ONNX files")
    parser.add_argument("scenes", type=Path, nargs="+", help="validation scenes with true depth")
    parser.add_argument("--every", type=int, default=1, help="every so-manieth view of a scene")
    args = parser.parse_args(arguments)
    try:
        path = read_manifest(args.manifest).folder / args.manifest.name
        predict = onnx_predictor(args.manifest, calibrate=False)
        scenes = find_true_scenes(args.scenes, "validation")
        if not scenes:
            msg = f"no scene with pair.txt and depths/ in {[str(p) for p in args.scenes]}"
            raise SceneError(msg)
        pixels: list[PixelErrors] = []
        for scene in scenes:
            evaluate_scene(predict, scene.read(), every=args.every, pixels=pixels, true_depth=scene.true_depth)
        pooled = pool(pixels)
    except FsinferError as error:
        print(f"Error: {error}")
        return 2
    confidence = pooled.confidence
    raw, share = fit_calibration(confidence, pooled.relative < 0.01)
    data = json.loads(path.read_text(encoding="utf-8"))
    data["confidence_calibration"] = {
        "raw": [round(float(v), 6) for v in raw],
        "within_1pct": [round(float(v), 5) for v in share],
        "scenes": len(scenes),
        "pixels": len(confidence),
    }
    if data.pop("photo_confidence", None) is not None:
        print(
            "photo_confidence was fitted on another calibration and is gone; again: python -m training.photo_confidence"
        )
    write_text(path, json.dumps(data, indent=1) + "\n")
    calibrated = np.interp(confidence, raw, share).astype(np.float32)
    print("\n".join(confidence_curve(calibrated, pooled.relative)[0]))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
