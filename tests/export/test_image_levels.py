"""A features graph that takes levels computes what the quantized one did, and what that cut off."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
from numpy.typing import NDArray

from export.image_levels import take_levels
from export.quantize import QuantizeSettings, quantize
from fsinfer.depth.manifest import models_folder
from fsinfer.depth.map_levels import MapLevels, features_of
from fsinfer.depth.network_input import Levels, network_input

Float32 = NDArray[np.float32]


@pytest.fixture(scope="module")
def graphs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """In 32 bits, in 8 calibrated on photographs of little contrast, and the same as it was before the levels."""
    folder = tmp_path_factory.mktemp("levels")
    exact = models_folder() / "field_features.onnx"
    feeds = [{"images": network_input(photograph(deviation))} for deviation in (20.0, 40.0)]
    made = {"exact": exact, "levels": folder / "levels.onnx", "before": folder / "before.onnx"}
    quantize(exact, made["levels"], feeds, QuantizeSettings())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("export.quantize.take_levels", lambda _model: {})
        quantize(exact, made["before"], feeds, QuantizeSettings())
    return made


def photograph(deviation: float) -> NDArray[np.uint8]:
    rng = np.random.default_rng(int(deviation))
    return np.clip(rng.normal(120, deviation, (64, 96, 3)), 0, 255).astype(np.uint8)


def quarter(file: Path, image: NDArray[np.uint8]) -> Float32:
    session = onnxruntime.InferenceSession(file)
    notes = session.get_modelmeta().custom_metadata_map
    levels = Levels.noted(notes)
    given = network_input(image) if levels is None else levels.of(image)
    output = session.run(None, {"images": given})[0]
    return features_of(output, MapLevels.noted(notes, "quarter"), image.shape[1] // 4).to_chw()


def test_it_takes_bytes_with_the_colours_of_four_pixels_last(graphs: dict[str, Path]) -> None:
    given = onnx.load(graphs["levels"]).graph.input[0]
    assert given.type.tensor_type.elem_type == onnx.TensorProto.UINT8
    assert given.type.tensor_type.shape.dim[3].dim_value == 4 * 3
    kinds = {node.op_type for node in onnx.load(graphs["levels"]).graph.node}
    assert not kinds & {"Sub", "Pow", "Sqrt", "ReduceMean"}


def test_what_was_within_the_calibration_stays(graphs: dict[str, Path]) -> None:
    image = photograph(30.0)
    exact, before, now = (quarter(graphs[name], image) for name in ("exact", "before", "levels"))
    assert np.abs(now - exact).mean() < 1.05 * np.abs(before - exact).mean()


def test_a_contrast_beyond_the_calibration_is_not_cut_off(graphs: dict[str, Path]) -> None:
    image = photograph(90.0)
    exact, before, now = (quarter(graphs[name], image) for name in ("exact", "before", "levels"))
    assert np.abs(now - exact).mean() < 0.6 * np.abs(before - exact).mean()


def test_a_graph_that_normalises_otherwise_is_refused(graphs: dict[str, Path]) -> None:
    model = onnx.load(graphs["before"])
    for node in model.graph.node:
        if node.op_type == "Sub" and "images" in node.input:
            node.op_type = "Mul"
    with pytest.raises(ValueError, match="does not quantize its photograph"):
        take_levels(model)
