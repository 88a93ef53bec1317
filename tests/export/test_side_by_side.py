"""Convolutions of some pixels at once compute what those of one pixel did."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
from numpy.typing import NDArray

from export.map_levels import give_levels
from export.quantize import QuantizeSettings, quantize
from fsinfer.depth.manifest import models_folder
from fsinfer.depth.network_input import Levels, network_input


@pytest.fixture(scope="module")
def graphs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The features of ``cascade`` in 8 bits: as they ship, and with one pixel at a time."""
    folder = tmp_path_factory.mktemp("side_by_side")
    made = {"together": folder / "together.onnx", "alone": folder / "alone.onnx"}
    exact = models_folder() / "cascade_features.onnx"
    feeds = [{"images": network_input(photograph(64, 96))}]
    quantize(exact, made["together"], feeds, QuantizeSettings())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("export.image_levels.take_four", lambda _graph, _quantized: 1)
        patch.setattr("export.map_levels.fill_channels", lambda _graph, _quantized: None)
        quantize(exact, made["alone"], feeds, QuantizeSettings())
    return made


def photograph(height: int, width: int) -> NDArray[np.uint8]:
    rng = np.random.default_rng(height * width)
    return np.clip(rng.normal(120, 40, (height, width, 3)), 0, 255).astype(np.uint8)


def maps_of(file: Path, image: NDArray[np.uint8]) -> list[NDArray[np.uint8]]:
    session = onnxruntime.InferenceSession(file)
    levels = Levels.noted(session.get_modelmeta().custom_metadata_map)
    assert levels is not None
    return [np.asarray(output) for output in session.run(None, {"images": levels.of(image)})]


@pytest.mark.parametrize(("height", "width"), [(64, 96), (65, 100), (97, 132)])
def test_the_levels_stay_the_same(graphs: dict[str, Path], height: int, width: int) -> None:
    image = photograph(height, width)
    wanted, found = (maps_of(graphs[name], image) for name in ("alone", "together"))
    for one, other, stride in zip(wanted, found, (4, 2), strict=True):
        columns = -(-width // stride)
        assert one.shape[2] == columns
        # Of whole numbers nothing is rounded but the results, by whatever kernel.
        difference = np.abs(other[:, :, :columns].astype(int) - one)
        assert difference.max() <= 1
        assert (difference > 0).mean() < 1e-3


def test_the_graph_computes_four_pixels_and_sixteen_channels_at_once(graphs: dict[str, Path]) -> None:
    sizes = {name: kernels(file) for name, file in graphs.items()}
    changed = [now for before, now in zip(sizes["alone"], sizes["together"], strict=True) if before != now]
    assert changed == [(32, 12, 3, 2), (16, 16, 3, 4)]


def kernels(file: Path) -> list[tuple[int, ...]]:
    graph = onnx.load(file).graph
    constants = {item.name: tuple(item.dims) for item in graph.initializer}
    makers = {output: node for node in graph.node for output in node.output}
    return [constants[makers[node.input[1]].input[0]] for node in graph.node if node.op_type == "Conv"]


def test_a_graph_that_gives_32_bits_is_refused() -> None:
    model = onnx.load(models_folder() / "cascade_features.onnx")
    with pytest.raises(ValueError, match="quarter comes from Conv"):
        give_levels(model)
