"""Products of matrices of 8-bit integers by onnxruntime, exact on every processor.

NumPy multiplies integers one by one. onnxruntime has kernels for what processors do with 8-bit integers; where they add
up two products in 16 bits first (AVX2), 255 times 128 twice would not fit. The first matrix has 7 bits, then, so that
every sum does and all processors agree.

The kernels want the second matrix in an order of their own. As a constant of the graph it is put into it once and not
at each product, which takes a third of the time.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: The graph, written by ``export/integer_product.py``.
FILE = Path(__file__).with_name("integer_product.onnx")
#: Greatest value of the first matrix: 2 * 127 * 128 < 2^15. Source: numerics.
MOST = 127
#: Only what cannot go on. Source: format; onnxruntime's levels.
_ERRORS = 3


class IntegerProducts:
    """Products with one second matrix (128, N) of int8; threads may share it."""

    def __init__(self, second: NDArray[np.int8]) -> None:
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1  # who calls shares the work out
        options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL  # there is one operator
        options.enable_cpu_mem_arena = False  # each of some hundred would keep its last product
        options.log_severity_level = _ERRORS
        # In the place of the file's, of one column; onnxruntime does not keep it alive.
        self._second = onnxruntime.OrtValue.ortvalue_from_numpy(np.ascontiguousarray(second))
        options.add_initializer("second", self._second)
        self._session: Any = onnxruntime.InferenceSession(str(FILE), options, providers=["CPUExecutionProvider"])

    def of(self, first: NDArray[np.uint8]) -> NDArray[np.int32]:
        """The product (M, N) of ``first`` (M, 128), none above :data:`MOST`, and the second matrix."""
        (product,) = self._session.run(None, {"first": first})
        return np.asarray(product, dtype=np.int32)
