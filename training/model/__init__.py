"""FS-MVSNet in PyTorch, one concept a module."""

from training.model.config import ABLATIONS, CONFIGS, PRESETS, ModelConfig
from training.model.fsmvsnet import DepthOutput, FSMVSNet

__all__ = ["ABLATIONS", "CONFIGS", "PRESETS", "DepthOutput", "FSMVSNet", "ModelConfig"]
