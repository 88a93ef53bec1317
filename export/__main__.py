"""Command line: ``python -m export CHECKPOINT --out models --parity SCENE``."""

from __future__ import annotations

import argparse
import json
import logging
from dataclasses import asdict
from pathlib import Path

import cv2

from export.onnx_export import add_tiles, export_model
from export.parity import whole_parity
from fsinfer.depth.model import DepthModel
from fsinfer.errors import FsinferError
from fsinfer.scene import read_scene
from training.checkpoint import load_checkpoint


def main(arguments: list[str] | None = None) -> int:
    """Export a checkpoint, or with ``--parity`` compare it with what was exported; exit code 1 beyond tolerance."""
    parser = argparse.ArgumentParser(prog="python -m export", description="Export FS-MVSNet to ONNX and prove parity.")
    parser.add_argument("checkpoint", type=Path, help="checkpoint.pt of training.train")
    parser.add_argument("--out", type=Path, default=Path("models"), help="folder of the ONNX files and the manifest")
    parser.add_argument("--confidence-threshold", type=float, default=0.3, help="of the parity of the masks")
    parser.add_argument("--parity", type=Path, metavar="SCENE", help="compare whole depth maps on this scene")
    parser.add_argument("--views", type=int, default=3, help="reference views of the comparison")
    parser.add_argument("--only-parity", action="store_true", help="compare with the files already in --out")
    parser.add_argument("--only-tiles", action="store_true", help="add the regularizer for tiles to those in --out")
    args = parser.parse_args(arguments)
    logging.basicConfig(level=logging.WARNING, format="%(message)s")
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    try:
        model, state = load_checkpoint(args.checkpoint)
        manifest = args.out / f"{model.config.name}.json"
        if args.only_tiles:
            add_tiles(model, manifest)
        elif not args.only_parity:
            provenance = {
                **state.get("training", {}),
                "preset": model.config.name,
                "steps": state["step"],
                "seconds": round(state["spent_s"]),
            }
            manifest = export_model(
                model, args.out, provenance=provenance, confidence_threshold=args.confidence_threshold
            )
            graphs = json.loads(manifest.read_text(encoding="utf-8"))["graphs"]
            difference = "difference_p999_over_largest"
            for role, graph in graphs.items():
                print(f"{graph['file']}: {role}, difference to PyTorch {graph[difference]:.1e}")
        if args.parity is None:
            return 0
        deployed = DepthModel.load(manifest, precision="float32")
        cv2.setNumThreads(1)
        parity = whole_parity(model, deployed, read_scene(args.parity), views=args.views)
    except FsinferError as error:
        print(f"Error: {error}")
        return 2
    print(json.dumps(asdict(parity), indent=1))
    return 0 if parity.passes() else 1


if __name__ == "__main__":
    raise SystemExit(main())
