"""Reduce a checkpoint to what export, evaluation and ``--init`` need: the averaged weights and where they come from.

python -m training.checkpoint RUN/checkpoint.pt training/checkpoints/field.pt
"""

from __future__ import annotations

import argparse
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import torch

from fsinfer.errors import ModelError
from training.model import FSMVSNet, ModelConfig

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


def load_checkpoint(path: Path) -> tuple[FSMVSNet, dict[str, Any]]:
    """Rebuild the model of a checkpoint with its averaged weights; returns it and the checkpoint's other entries."""
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
        model = FSMVSNet(ModelConfig(**state["config"]))
        model.load_state_dict(state["average"])
    except (OSError, EOFError, KeyError, TypeError, RuntimeError, UnpicklingError) as error:
        msg = f"{path} is not a checkpoint of training.train ({error}); give the checkpoint.pt of a run"
        raise ModelError(msg) from error
    return model.eval(), state
