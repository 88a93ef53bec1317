"""FS-MVSNet in PyTorch, one concept a module."""

from training.model.config import PRESETS, ModelConfig
from training.model.fsmvsnet import DepthOutput, FSMVSNet

__all__ = ["PRESETS", "DepthOutput", "FSMVSNet", "ModelConfig"]
