"""Convolutions of 8-bit integers that compute some pixels of a row at once, as more channels of fewer pixels.

A processor's kernels compute sixteen channels as fast as eight, and fetch the twelve numbers of four pixels of three
colours as fast as the three of one. What was channels of neighbouring pixels becomes pixels again by giving the same
numbers another shape, which takes no time where the channels are last.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import onnx
from onnx import helper, numpy_helper

from export.tidy import makers_of

#: Channels that are computed at once. Source: numerics.
_AT_ONCE = 16
#: Axes in the order with the channels last, in which onnxruntime computes 8 bits: it drops such a transposition against
#: its own; and back. Source: format.
CHANNELS_LAST, CHANNELS_SECOND = [0, 2, 3, 1], [0, 3, 1, 2]


@dataclass(frozen=True, kw_only=True)
class _Convolution:
    """A convolution between numbers of 8 bits.

    ``weights`` are (C, I, h, w) int8, ``stored`` the nodes that turn these, and the bias, into numbers; ``strides`` and
    ``pads`` are those of rows and columns.
    """

    node: onnx.NodeProto
    weights: np.ndarray
    stored: list[onnx.NodeProto]
    strides: list[int]
    pads: list[int]


class _Quantized:
    """A graph in QDQ form under change."""

    def __init__(self, graph: onnx.GraphProto) -> None:
        self.graph = graph
        self.constants = {item.name: item for item in graph.initializer}
        self.makers = makers_of(graph)

    def convolution(self, node: onnx.NodeProto | None) -> _Convolution | None:
        """What ``node`` computes; None where it is none of 8 bits, or one of a kind that is not changed."""
        if node is None or node.op_type != "Conv":
            return None
        stored = [self.makers[name] for name in node.input[1:] if name in self.makers]
        in_8_bits = all(part.op_type == "DequantizeLinear" and part.input[0] in self.constants for part in stored)
        attributes = {item.name: helper.get_attribute_value(item) for item in node.attribute}
        plain = attributes.get("group", 1) == 1 and attributes.get("dilations", [1, 1]) == [1, 1]
        if len(stored) != len(node.input) - 1 or not in_8_bits or not plain:
            return None
        return _Convolution(
            node=node,
            weights=numpy_helper.to_array(self.constants[stored[0].input[0]]),
            stored=stored,
            strides=list(attributes.get("strides", [1, 1])),
            pads=list(attributes.get("pads", [0, 0, 0, 0])),
        )

    def change(
        self, old: _Convolution, weights: np.ndarray, *, count: int, strides: list[int], pads: list[int]
    ) -> None:
        """Give a convolution other ``weights``, those of ``count`` pixels after each other."""
        of_weights, *of_bias = old.stored
        self._set(of_weights.input[0], weights)
        # Each channel has a scale and a zero point of its own, and a bias.
        for name in [*of_weights.input[1:], *(name for node in of_bias for name in node.input)]:
            values = numpy_helper.to_array(self.constants[name])
            if values.shape == (len(old.weights),):
                self._set(name, np.tile(values, count))
        replaced = {"kernel_shape": list(weights.shape[2:]), "strides": strides, "pads": pads}
        kept = [item for item in old.node.attribute if item.name not in replaced]
        del old.node.attribute[:]
        old.node.attribute.extend([*kept, *(helper.make_attribute(name, value) for name, value in replaced.items())])

    def _set(self, name: str, values: np.ndarray) -> None:
        self.constants[name].CopyFrom(numpy_helper.from_array(np.ascontiguousarray(values), name))

    def reader(self, tensor: str) -> onnx.NodeProto | None:
        """The one node that reads a tensor, or None."""
        readers = [node for node in self.graph.node if tensor in node.input]
        return readers[0] if len(readers) == 1 else None

    def part_again(self, quantizer: onnx.NodeProto, channels: int) -> None:
        """Make pixels of ``channels`` again of what ``quantizer`` gives."""
        wanted = quantizer.output[0]
        together, apart, shape = (f"{wanted}_{what}" for what in ("side_by_side", "pixels", "shape"))
        self.graph.initializer.append(numpy_helper.from_array(np.array([0, 0, -1, channels], np.int64), shape))
        quantizer.output[0] = f"{wanted}_channels"
        place = list(self.graph.node).index(quantizer) + 1
        for node in reversed(
            (
                helper.make_node("Transpose", [quantizer.output[0]], [together], together, perm=CHANNELS_LAST),
                helper.make_node("Reshape", [together, shape], [apart], apart),
                helper.make_node("Transpose", [apart], [wanted], f"{wanted}_apart", perm=CHANNELS_SECOND),
            )
        ):
            self.graph.node.insert(place, node)


def fill_channels(graph: onnx.GraphProto, quantized: str) -> None:
    """Let the 3x3 convolution whose result is ``quantized``, in 8 bits, compute as many pixels as fill the channels.

    Of rows whose width they do not divide there are pixels behind the last. Others stay as they are.
    """
    editor = _Quantized(graph)
    quantizer = editor.makers[quantized]
    old = editor.convolution(editor.makers.get(quantizer.input[0]))
    if old is None or old.weights.shape[2:] != (3, 3) or (old.strides, old.pads) != ([1, 1], [1, 1, 1, 1]):
        return
    channels, inputs = old.weights.shape[:2]
    count, rest = divmod(_AT_ONCE, channels)
    if rest or count < 2:
        return
    # Pixel n x + i has the channels i C to i C + C - 1 of column x, whose window begins a column before pixel n x.
    wide = np.zeros((count, channels, inputs, 3, count + 2), old.weights.dtype)
    for pixel in range(count):
        wide[pixel, ..., pixel : pixel + 3] = old.weights
    wide = wide.reshape(count * channels, inputs, 3, count + 2)
    editor.change(old, wide, count=count, strides=[1, count], pads=[1, 1, 1, count])
    editor.part_again(quantizer, channels)


def take_four(graph: onnx.GraphProto, quantized: str) -> int:
    """Let the 3x3 convolution of stride 2 that reads ``quantized`` take four pixels as one and give two.

    Returns how many pixels it takes as one: 4, or 1 where it is another and stays as it is.
    """
    editor = _Quantized(graph)
    dequantizer = editor.reader(quantized)
    old = editor.convolution(editor.reader(dequantizer.output[0])) if dequantizer is not None else None
    if old is None or old.weights.shape[2:] != (3, 3) or (old.strides, old.pads) != ([2, 2], [1, 1, 1, 1]):
        return 1
    last = editor.reader(old.node.output[0])
    if last is not None and last.op_type == "Relu":
        last = editor.reader(last.output[0])
    if last is None or last.op_type != "QuantizeLinear":
        return 1
    channels, inputs = old.weights.shape[:2]
    # Of the pixels -1 to 3 beside pixel 4 x the first is the last of the four before.
    wide = np.zeros((2, channels, 2, 4, inputs, 3), old.weights.dtype)
    for pixel in range(2):
        for column in range(3):
            four, place = divmod(2 * pixel - 1 + column + 4, 4)
            wide[pixel, :, four, place] = old.weights[..., column]
    wide = wide.transpose(0, 1, 3, 4, 5, 2).reshape(2 * channels, 4 * inputs, 3, 2)
    editor.change(old, wide, count=2, strides=[2, 1], pads=[1, 1, 1, 0])
    editor.part_again(last, channels)
    return 4
