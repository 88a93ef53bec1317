"""The choice of onnxruntime's execution provider."""

from __future__ import annotations

import pytest

from fsinfer.depth.model import DepthModel
from fsinfer.depth.session import CPU, find_providers
from fsinfer.errors import ModelError


def test_the_processor_is_always_behind_the_chosen_one() -> None:
    available = ["CUDAExecutionProvider", CPU]
    assert find_providers("cpu", available) == [CPU]
    assert find_providers("CUDA", available) == ["CUDAExecutionProvider", CPU]
    assert find_providers("CUDAExecutionProvider", available) == ["CUDAExecutionProvider", CPU]


def test_a_missing_one_is_an_error_that_names_those_there_are() -> None:
    with pytest.raises(ModelError, match=r"no provider 'directml', only: cpu, cuda;"):
        find_providers("directml", ["CUDAExecutionProvider", CPU])
    with pytest.raises(ModelError, match="no provider 'nonsense'"):
        DepthModel.load("field", provider="nonsense")
