"""Write the graph of one product of whole numbers, with which ``fsinfer.poses`` searches descriptors.

``python -m export.integer_product`` writes the file that ships with the package; it holds no weights. onnxruntime uses
the instructions of a processor for products of 8-bit integers, which NumPy does not.
"""

from __future__ import annotations

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from fsinfer.poses.integer_product import FILE

#: Of the operators (MatmulInteger is from 10 on) and of the file; what onnxruntime 1.22 reads for long. Source: format.
OPSET, IR_VERSION = 17, 9
#: Numbers of a descriptor. Source: format; SIFT.
LENGTH = 128


def integer_product() -> onnx.ModelProto:
    """``product[m, n] = sum of first[m, k] * second[k, n]``: uint8 by int8, in int32; ``m`` and ``n`` are free.

    ``second`` is a constant, for which whoever loads the graph puts his own of any ``n``.
    """
    node = helper.make_node("MatMulInteger", ["first", "second"], ["product"])
    graph = helper.make_graph(
        [node],
        "integer_product",
        [
            helper.make_tensor_value_info("first", TensorProto.UINT8, ["m", LENGTH]),
        ],
        [helper.make_tensor_value_info("product", TensorProto.INT32, ["m", "n"])],
        [numpy_helper.from_array(np.zeros((LENGTH, 1), np.int8), "second")],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], producer_name="fsinfer")
    model.ir_version = IR_VERSION
    onnx.checker.check_model(model)
    return model


def main() -> None:
    """Write the file."""
    FILE.write_bytes(integer_product().SerializeToString())


if __name__ == "__main__":
    main()
