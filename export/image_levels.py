"""A features graph in 8 bits that is given its photograph in levels of 8 bits.

What comes before those levels - the mean and the standard deviation of each colour, all pixels less the one over the
other - is left to :class:`fsinfer.depth.network_input.Levels`: a table of 256 entries for each photograph instead of
six steps over all its pixels. The quantizer had put the standard deviation into 8 bits, too, and cut it off at that of
the photographs that calibrated.
"""

from __future__ import annotations

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from export.side_by_side import CHANNELS_SECOND, take_four
from export.tidy import drop_unused, makers_of
from fsinfer.depth.network_input import Levels

#: Name of the input of a features graph, of either precision. Source: format.
IMAGES = "images"
#: Nodes that hand a number on as it is, or nearly.
_HAND_ON = ("QuantizeLinear", "DequantizeLinear")


def take_levels(model: onnx.ModelProto) -> dict[str, str]:
    """Change a quantized features graph in place to take ``images`` (N, H, W / n, 3 n) as levels, n pixels as one.

    Returns what is to be noted of them.

    Raises
    ------
    ValueError
        Its photograph is made into levels in another way.
    """
    graph = model.graph
    makers, constants = makers_of(graph), {item.name: numpy_helper.to_array(item) for item in graph.initializer}
    quantizer = next((node for node in graph.node if _is_of_normalised(node, makers)), None)
    if quantizer is None:
        msg = "the graph does not quantize its photograph less the mean over the standard deviation"
        raise ValueError(msg)
    levels = Levels(
        scale=float(constants[quantizer.input[1]]),
        zero_point=int(constants[quantizer.input[2]]),
        added_deviation=_added(makers[makers[quantizer.input[0]].input[1]], makers, constants),
        side_by_side=take_four(graph, quantizer.output[0]),
    )
    turned = helper.make_node("Transpose", [IMAGES], list(quantizer.output), "levels_chw", perm=CHANNELS_SECOND)
    for node in [node for node in graph.node if IMAGES in node.input and node.op_type == "Shape"]:
        start, end = (next(item for item in node.attribute if item.name == name) for name in ("start", "end"))
        if (start.i, end.i) not in ((2, 3), (3, 4)):
            msg = f"{node.name} reads sizes {start.i} to {end.i} of the photograph"
            raise ValueError(msg)
        if start.i == 3 and levels.side_by_side > 1:
            _multiply(graph, node, levels.side_by_side)
        start.i, end.i = start.i - 1, end.i - 1
    graph.node.remove(quantizer)
    graph.node.insert(0, turned)
    old = next(item for item in graph.input if item.name == IMAGES)
    count, channels, height, width = (dim.dim_param or dim.dim_value for dim in old.type.tensor_type.shape.dim)
    together = (width, channels) if levels.side_by_side == 1 else ("columns", levels.side_by_side * channels)
    given = helper.make_tensor_value_info(IMAGES, TensorProto.UINT8, [count, height, *together])
    old.CopyFrom(given)
    drop_unused(graph)
    return levels.notes()


def _multiply(graph: onnx.GraphProto, node: onnx.NodeProto, factor: int) -> None:
    """Let what ``node`` gives be so many times as much."""
    wanted, name = node.output[0], f"{node.output[0]}_factor"
    node.output[0] = f"{wanted}_once"
    graph.initializer.append(numpy_helper.from_array(np.array([factor], np.int64), name))
    times = helper.make_node("Mul", [node.output[0], name], [wanted], f"{wanted}_times")
    graph.node.insert(list(graph.node).index(node) + 1, times)


def _is_of_normalised(node: onnx.NodeProto, makers: dict[str, onnx.NodeProto]) -> bool:
    """Whether it quantizes the photograph less something, over something."""
    divided = makers.get(node.input[0]) if node.op_type == "QuantizeLinear" else None
    less = makers.get(divided.input[0]) if divided is not None and divided.op_type == "Div" else None
    return less is not None and less.op_type == "Sub" and less.input[0] == IMAGES


def _added(node: onnx.NodeProto, makers: dict[str, onnx.NodeProto], constants: dict[str, np.ndarray]) -> float:
    """What is added to the standard deviation that ``node`` hands on."""
    while node.op_type in _HAND_ON:
        node = makers[node.input[0]]
    if node.op_type != "Add":
        msg = f"{node.name} adds nothing to the standard deviation"
        raise ValueError(msg)
    for name in node.input:
        maker = makers.get(name)
        if name in constants:
            return float(constants[name])
        if maker is not None and maker.op_type == "DequantizeLinear" and maker.input[0] in constants:
            value, scale, zero_point = (float(constants[part]) for part in maker.input)
            return (value - zero_point) * scale
    msg = f"{node.name} adds no constant"
    raise ValueError(msg)
