"""A features graph in 8 bits that gives its feature maps out in levels of 8 bits.

The quantizer turns what a graph gives out back into 32 bits. That, and the order of channels that comes with it, is
left to :class:`fsinfer.depth.map_levels.MapLevels`: the levels are as they came out of the last convolutions, with the
channels last.
"""

from __future__ import annotations

import numpy as np
import onnx
from onnx import helper, numpy_helper

from export.side_by_side import CHANNELS_LAST, fill_channels
from export.tidy import makers_of
from fsinfer.depth.map_levels import MapLevels


def give_levels(model: onnx.ModelProto) -> dict[str, str]:
    """Change a quantized features graph in place to give out levels (N, h, w, C); returns what is to be noted of them.

    Rows may be longer than the feature map is wide.

    Raises
    ------
    ValueError
        An output does not come from numbers of 8 bits.
    """
    graph = model.graph
    makers, constants = makers_of(graph), {item.name: numpy_helper.to_array(item) for item in graph.initializer}
    notes: dict[str, str] = {}
    for output in graph.output:
        last = makers[output.name]
        stored = [constants[name] for name in last.input[1:] if name in constants]
        if last.op_type != "DequantizeLinear" or len(stored) != 2 or stored[1].dtype != np.uint8:
            msg = f"{output.name} comes from {last.op_type}, not from levels of 8 bits"
            raise ValueError(msg)
        scale, zero_point = stored
        notes |= MapLevels(scale=float(scale), zero_point=int(zero_point)).notes(output.name)
        quantized = last.input[0]
        turned = helper.make_node("Transpose", [quantized], [output.name], f"{output.name}_levels", perm=CHANNELS_LAST)
        graph.node.insert(list(graph.node).index(last), turned)
        graph.node.remove(last)
        fill_channels(graph, quantized)
        count, channels, *_ = (dim.dim_param or dim.dim_value for dim in output.type.tensor_type.shape.dim)
        sizes = (f"{output.name}_rows", f"{output.name}_columns")
        given = helper.make_tensor_value_info(output.name, onnx.TensorProto.UINT8, [count, *sizes, channels])
        output.CopyFrom(given)
    return notes
