"""Graphs with less to do compute what they did."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from onnx import numpy_helper
from torch import Tensor, nn

from export.quantize import score_nodes
from export.tidy import makers_of, tidy
from fsinfer.depth.manifest import models_folder
from training.model.backbone import upsample_like


class _Small(nn.Module):
    """What tidying looks for: five channels put together, an enlarged level, a batch of one."""

    def __init__(self) -> None:
        super().__init__()
        torch.manual_seed(3)
        self.enter = nn.Conv2d(5, 6, 3, padding=1)
        self.down = nn.Conv2d(6, 6, 3, stride=2, padding=1)

    def forward(self, volume: Tensor, features: Tensor) -> Tensor:
        level = self.enter(torch.cat([volume[None], features[None]], dim=1))
        return torch.as_tensor((level + upsample_like(self.down(level), level))[0])


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("small") / "small.onnx"
    free = {1: torch.export.Dim.DYNAMIC, 2: torch.export.Dim.DYNAMIC}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the exporter's own deprecations are not ours to mend
        program = torch.onnx.export(
            _Small().eval(),
            kwargs={"volume": torch.rand(2, 16, 24), "features": torch.rand(3, 16, 24)},
            input_names=["volume", "features"],
            output_names=["scores"],
            opset_version=18,
            dynamo=True,
            dynamic_shapes={"volume": free, "features": free},
            verbose=False,
        )
    assert program is not None
    program.save(str(path))
    return path


@pytest.mark.parametrize("size", [(16, 24), (17, 23), (9, 8)])
def test_the_results_stay(small: Path, size: tuple[int, int]) -> None:
    plain, tidied = onnx.load(small), onnx.load(small)
    tidy(tidied)
    onnx.checker.check_model(tidied, full_check=True)
    rng = np.random.default_rng(0)
    feeds = {name: rng.random((channels, *size), np.float32) for name, channels in (("volume", 2), ("features", 3))}
    before, after = (
        onnxruntime.InferenceSession(model.SerializeToString()).run(None, feeds)[0] for model in (plain, tidied)
    )
    assert after.shape == (6, *size)
    np.testing.assert_allclose(after, before, atol=2e-6)
    operators = [node.op_type for node in tidied.graph.node]
    assert not {"Pad", "Gather"}.intersection(operators)
    assert operators.count("Resize") == 1
    weights = {item.name: list(item.dims) for item in tidied.graph.initializer}
    assert sorted(weights[node.input[1]][1] for node in tidied.graph.node if node.op_type == "Conv") == [6, 8]
    assert len(operators) < len(plain.graph.node)


def test_a_second_time_changes_nothing(small: Path) -> None:
    model = onnx.load(small)
    tidy(model)
    once = model.SerializeToString()
    tidy(model)
    assert model.SerializeToString() == once


@pytest.mark.parametrize("path", sorted(models_folder().glob("*.onnx")), ids=lambda path: path.stem)
def test_what_ships_is_tidy(path: Path) -> None:
    graph = onnx.load(path).graph
    makers, filled = makers_of(graph), []
    weights = {item.name: numpy_helper.to_array(item).shape for item in graph.initializer}
    for node in graph.node:
        maker = makers.get(node.input[0]) if node.input else None
        # A size is no reason to turn a tensor back into float32.
        assert node.op_type != "Shape" or maker is None or maker.op_type != "DequantizeLinear", node.name
        if node.op_type == "Resize" and maker is not None and maker.op_type == "Pad":
            assert weights[maker.input[1]] != (8,), node.name  # four axes, and not the five of 3D convolutions
        while maker is not None and maker.op_type in ("DequantizeLinear", "QuantizeLinear"):
            maker = makers.get(maker.input[0])
        if node.op_type == "Conv" and maker is not None and maker.op_type == "Concat":
            turned = makers.get(node.input[1])
            assert weights[node.input[1] if turned is None else turned.input[0]][1] % 4 == 0, node.name
            filled.append(node.name)
    assert filled or not path.stem.startswith(("cascade_candidates", "cascade_refiner", "field_refiner"))
    if path.stem.endswith(("regularizer_int8", "candidates_int8", "refiner_int8")):
        # What is looked through for the best plane is the sum itself, not what only hands it on.
        assert {node.op_type for node in score_nodes(graph)} == {"Add"}
