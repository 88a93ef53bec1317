"""Products of matrices of 8-bit integers by onnxruntime, exact on every processor.

NumPy multiplies integers one by one. onnxruntime has kernels for what processors do with 8-bit integers; where they add
up two products in 16 bits first (AVX2), 255 times 128 twice would not fit. The first matrix has 7 bits, then, so that
every sum does and all processors agree.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: The graph, written by ``export/integer_product.py``.
FILE = Path(__file__).with_name("integer_product.onnx")
#: Greatest value of the first matrix: 2 * 127 * 128 < 2^15. Source: numerics.
MOST = 127


@cache
def _session() -> Any:
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1  # who calls shares the work out
    return onnxruntime.InferenceSession(str(FILE), options, providers=["CPUExecutionProvider"])


def integer_product(first: NDArray[np.uint8], second: NDArray[np.int8]) -> NDArray[np.int32]:
    """The product (M, N) of ``first`` (M, K), none above :data:`MOST`, and ``second`` (K, N); threads may call."""
    (product,) = _session().run(None, {"first": first, "second": second})
    return np.asarray(product, dtype=np.int32)
