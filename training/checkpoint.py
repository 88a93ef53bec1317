"""Reduce a checkpoint to what export, evaluation and ``--init`` need: the averaged weights and where they come from.

python -m training.checkpoint RUN/checkpoint.pt training/checkpoints/field.pt
"""

from __future__ import annotations

import argparse
from pathlib import Path

import torch

KEPT = ("config", "average", "step", "spent_s", "training")


def slim(checkpoint: Path, out: Path) -> None:
    """Write ``out`` with the entries of :data:`KEPT`: a quarter of the size, without the optimizer's state."""
    state = torch.load(checkpoint, map_location="cpu", weights_only=True)
    out.parent.mkdir(parents=True, exist_ok=True)
    torch.save({key: state[key] for key in KEPT}, out)


def main(arguments: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m training.checkpoint", description=__doc__)
    parser.add_argument("checkpoint", type=Path)
    parser.add_argument("out", type=Path)
    args = parser.parse_args(arguments)
    slim(args.checkpoint, args.out)
    print(f"{args.out}: {args.out.stat().st_size / 1e6:.1f} MB")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
