"""Reduce a checkpoint to what export, evaluation and ``--init`` need: the averaged weights and where they come from.

python -m training.checkpoint RUN/checkpoint.pt training/checkpoints/field.pt
"""

from __future__ import annotations

import argparse
from dataclasses import fields
from pathlib import Path
from typing import Any

import torch

from fsinfer.errors import ModelError
from training.model import FSMVSNet, ModelConfig

#: More than any network has of channels, planes or groups. Source: judgement.
_MOST = 1024

KEPT = ("config", "average", "step", "spent_s", "training")


def read_state(path: Path, device: torch.device | str = "cpu") -> dict[str, Any]:
    """The entries of a checkpoint: tensors, numbers and texts, never code (``weights_only``).

    Raises :class:`ModelError` for anything else.
    """
    try:
        state = torch.load(path, map_location=device, weights_only=True)
    except Exception as error:  # the readers of torch have no kind of error in common
        msg = f"{path} is not a checkpoint of training.train ({error}); give the checkpoint.pt of a run"
        raise ModelError(msg) from error
    if not isinstance(state, dict):
        msg = f"{path} is not a checkpoint of training.train; give the checkpoint.pt of a run"
        raise ModelError(msg)
    return state


def _check_sizes(config: ModelConfig, path: Path) -> None:
    """Refuse a network that no memory holds before its weights are allocated."""
    for field in fields(config):
        value = getattr(config, field.name)
        if isinstance(value, (int, float)) and not 0 <= value <= _MOST:
            msg = f"{path} asks for {field.name} = {value}, which no network of training.train has"
            raise ModelError(msg)


def slim(checkpoint: Path, out: Path) -> None:
    """Write ``out`` with the entries of :data:`KEPT`: a quarter of the size, without the optimizer's state."""
    state = read_state(checkpoint)
    missing = [key for key in KEPT if key not in state]
    if missing:
        msg = f"{checkpoint} is not a checkpoint of training.train (without {missing}); give the checkpoint.pt of a run"
        raise ModelError(msg)
    out.parent.mkdir(parents=True, exist_ok=True)
    torch.save({key: state[key] for key in KEPT}, out)


def main(arguments: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m training.checkpoint", description=__doc__)
    parser.add_argument("checkpoint", type=Path)
    parser.add_argument("out", type=Path)
    args = parser.parse_args(arguments)
    try:
        slim(args.checkpoint, args.out)
    except ModelError as error:
        print(f"Error: {error}")
        return 2
    print(f"{args.out}: {args.out.stat().st_size / 1e6:.1f} MB")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())


def load_checkpoint(path: Path) -> tuple[FSMVSNet, dict[str, Any]]:
    """Rebuild the model of a checkpoint with its averaged weights; returns it and the checkpoint's other entries."""
    state = read_state(path)
    try:
        config = ModelConfig(**state["config"])
        _check_sizes(config, path)
        model = FSMVSNet(config)
        model.load_state_dict(state["average"])
    except Exception as error:  # of any kind that a wrong architecture or wrong weights raise in torch
        msg = f"{path} is not a checkpoint of training.train ({error}); give the checkpoint.pt of a run"
        raise ModelError(msg) from error
    return model.eval(), state
