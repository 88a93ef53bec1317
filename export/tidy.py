"""The same arithmetic with less to do: what the exporter writes that a CPU need not compute.

- PyTorch enlarges a level with corners aligned, for which a row and a column are repeated before, and cuts what is too
  much off row by row and column by column; ONNX knows the same enlargement by its factor.
- Of a batch of one the only member is copied; its axis is dropped instead.
- A convolution in 8 bits of channels that are no multiple of four takes two to three times as long: it gets channels
  more, with weights of zero.
- The exporter's notes of the lines of code that each node comes from are left out.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import onnx
from onnx import helper, numpy_helper, shape_inference

#: Products of 8-bit integers are summed by so many. Source: format.
_TOGETHER = 4


def makers_of(graph: onnx.GraphProto) -> dict[str, onnx.NodeProto]:
    """The node that makes each tensor."""
    return {output: node for node in graph.node for output in node.output}


class _Editor:
    """A graph under change, with what is looked up in it."""

    def __init__(self, model: onnx.ModelProto) -> None:
        self.graph = model.graph
        self.constants = {item.name: numpy_helper.to_array(item) for item in model.graph.initializer}
        known = shape_inference.infer_shapes(model).graph
        self.shapes = {
            item.name: [dim.dim_value for dim in item.type.tensor_type.shape.dim]
            for item in (*known.value_info, *known.input, *known.output)
        }

    def readers(self, tensor: str) -> list[onnx.NodeProto]:
        return [node for node in self.graph.node if tensor in node.input]

    def constant(self, name: str, values: np.ndarray) -> str:
        self.graph.initializer.append(numpy_helper.from_array(values, name))
        self.constants[name] = values
        return name

    def replace(self, old: list[onnx.NodeProto], new: list[onnx.NodeProto]) -> None:
        """Put nodes in the place of the last of others."""
        place = max(list(self.graph.node).index(node) for node in old)
        for i, node in enumerate(new):
            self.graph.node.insert(place + 1 + i, node)
        for node in old:
            self.graph.node.remove(node)


def tidy(model: onnx.ModelProto) -> None:
    """Change a graph in place; what it computes stays the same but for the order of a few sums."""
    editor = _Editor(model)
    _enlarge_by_factor(editor)
    _drop_axes(editor)
    _fill_channels(editor)
    drop_unused(model.graph)
    # Sizes that were told for what is larger now, or gone.
    del model.graph.value_info[:]
    _drop_notes(model.graph)


def _drop_notes(graph: onnx.GraphProto) -> None:
    """Take out what the exporter notes of where each node comes from: the files on the machine that it ran on."""
    for item in (graph, *graph.node, *graph.input, *graph.output, *graph.initializer):
        item.ClearField("metadata_props")
        item.ClearField("doc_string")


def drop_unused(graph: onnx.GraphProto) -> None:
    """Take out nodes and constants that nothing reads."""
    while True:
        read = {name for node in graph.node for name in node.input} | {output.name for output in graph.output}
        unused = [node for node in graph.node if not read.intersection(node.output)]
        if not unused:
            break
        for node in unused:
            graph.node.remove(node)
    for item in [item for item in graph.initializer if item.name not in read]:
        graph.initializer.remove(item)


def _attributes(node: onnx.NodeProto) -> dict[str, object]:
    return {item.name: helper.get_attribute_value(item) for item in node.attribute}


def _enlargements(editor: _Editor) -> Iterator[tuple[onnx.NodeProto, ...]]:
    """Pad, Resize, Slice of rows, Slice of columns, as :func:`training.model.backbone.upsample_like` becomes them."""
    makers = makers_of(editor.graph)
    for resize in [node for node in editor.graph.node if node.op_type == "Resize"]:
        pad = makers.get(resize.input[0])
        if pad is None or pad.op_type != "Pad" or _attributes(pad).get("mode") != b"edge":
            continue
        aligned = _attributes(resize)["coordinate_transformation_mode"] == b"align_corners"
        if not aligned or editor.constants[pad.input[1]].tolist() != [0, 0, 0, 0, 0, 0, 1, 1]:
            continue
        rows = editor.readers(resize.output[0])
        columns = editor.readers(rows[0].output[0]) if len(rows) == 1 else []
        if all(_is_cut(editor, part, axis) for part, axis in ((rows, 2), (columns, 3))):
            yield pad, resize, rows[0], columns[0]


def _is_cut(editor: _Editor, nodes: list[onnx.NodeProto], axis: int) -> bool:
    """Whether this is one Slice from the beginning of an axis on."""
    if len(nodes) != 1 or nodes[0].op_type != "Slice" or len(nodes[0].input) < 4:
        return False
    starts, axes = (editor.constants.get(nodes[0].input[i]) for i in (1, 3))
    return starts is not None and axes is not None and (starts.tolist(), axes.tolist()) == ([0], [axis])


def _enlarge_by_factor(editor: _Editor) -> None:
    for pad, resize, rows, columns in list(_enlargements(editor)):
        name = resize.name
        factors = editor.constant(f"{name}_factors", np.array([1, 1, 2, 2], np.float32))
        ends = f"{name}_ends"
        starts, axes, steps = (
            editor.constant(f"{name}_{what}", np.array(values, np.int64))
            for what, values in (("starts", [0, 0]), ("axes", [2, 3]), ("steps", [1, 1]))
        )
        editor.replace(
            [pad, resize, rows, columns],
            [
                helper.make_node(
                    "Resize",
                    [pad.input[0], "", factors],
                    [resize.output[0]],
                    name,
                    mode="linear",
                    coordinate_transformation_mode="asymmetric",
                ),
                helper.make_node("Concat", [rows.input[2], columns.input[2]], [ends], f"{name}_ends", axis=0),
                helper.make_node(
                    "Slice", [resize.output[0], starts, ends, axes, steps], [columns.output[0]], columns.name
                ),
            ],
        )


def _drop_axes(editor: _Editor) -> None:
    for node in [node for node in editor.graph.node if node.op_type == "Gather"]:
        index = editor.constants.get(node.input[1])
        one = editor.shapes.get(node.input[0], [0])[0] == 1
        if one and index is not None and index.shape == () and int(index) == 0 and not _attributes(node).get("axis", 0):
            axes = editor.constant(f"{node.name}_axes", np.array([0], np.int64))
            editor.replace([node], [helper.make_node("Squeeze", [node.input[0], axes], list(node.output), node.name)])


def _fill_channels(editor: _Editor) -> None:
    makers = makers_of(editor.graph)
    for conv in [node for node in editor.graph.node if node.op_type == "Conv"]:
        weights = editor.constants.get(conv.input[1])
        concat = makers.get(conv.input[0])
        if weights is None or concat is None or concat.op_type != "Concat" or _attributes(concat)["axis"] != 1:
            continue
        missing, last = -weights.shape[1] % _TOGETHER, editor.shapes.get(concat.input[-1], [0, 0])
        alone = len(editor.readers(concat.output[0])) == 1 and _attributes(conv).get("group", 1) == 1
        if not missing or not alone or len(last) < 2 or last[1] < missing:
            continue
        # The channels are some that there are, so that no size need be known.
        again = f"{concat.name}_again"
        bounds = [
            editor.constant(f"{again}_{what}", np.array([value], np.int64))
            for what, value in (("starts", 0), ("ends", missing), ("axes", 1))
        ]
        at = list(editor.graph.node).index(concat)
        editor.graph.node.insert(at, helper.make_node("Slice", [concat.input[-1], *bounds], [again], again))
        concat.input.append(again)
        filled = np.pad(weights, [(0, 0), (0, missing), *[(0, 0)] * (weights.ndim - 2)])
        conv.input[1] = editor.constant(f"{conv.input[1]}_filled", filled)
