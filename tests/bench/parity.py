"""Whole depth maps of the ONNX model against PyTorch: ``python -m tests.bench.parity SCENE --views 2``.

PyTorch computes in float64, and once more in float32, whose rounding adds to that of ONNX in that figure (``single``).

The same comparison as ``python -m export training/checkpoints/cascade.pt --only-parity --parity SCENE``, with a result
file.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import torch

from export.parity import whole_parity
from fsinfer.depth.model import DepthModel
from fsinfer.depth.settings import DepthSettings
from fsinfer.scene import read_scene
from tests.bench.results import ROOT, add_result_options, check_result_options, save_result
from training.checkpoint import load_checkpoint


def main(argv: list[str] | None = None) -> int:
    """Compare, print, write."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.parity", description=__doc__)
    parser.add_argument("scene", type=Path)
    parser.add_argument(
        "--checkpoint", type=Path, default=ROOT / "training" / "checkpoints" / f"{DepthSettings.model}.pt"
    )
    parser.add_argument("--views", type=int, default=2)
    add_result_options(parser)
    args = parser.parse_args(argv)
    check_result_options(parser, args)
    cv2.setNumThreads(1)
    model, _ = load_checkpoint(args.checkpoint)
    deployed = DepthModel.load(model.config.name, precision="float32")
    scene = read_scene(args.scene)
    found = whole_parity(model, deployed, scene, views=args.views)
    single = whole_parity(model, deployed, scene, views=args.views, dtype=torch.float32)
    figures = {
        "views": found.views,
        "pixels": found.pixels,
        "depth_rel_median": found.depth_rel_p50,
        "depth_rel_p999": found.depth_rel_p999,
        "depth_rel_p999_sure": found.depth_rel_p999_sure,
        "depth_rel_p999_single": single.depth_rel_p999,
        "mask_agreement_percent": 100 * found.mask_agreement,
    }
    for name, value in figures.items():
        print(f"{name:24s} {value:.6g}")
    save_result(args, figures, module="tests.bench.parity", arguments=argv)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
