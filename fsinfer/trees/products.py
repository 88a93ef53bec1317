"""Products of a few long rows, kept to one thread.

From some ten thousand multiplications on BLAS wakes all its threads, which wait for each other longer than the product
takes; on two cores the processor was busy more than twice as long. Blocks below that limit do not.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
BLOCK = 512  # times 14 parameters: below the 9,216 elements from which OpenBLAS spreads a matrix-vector product


def sums_of_products(a: Floats, b: Floats) -> Floats:
    """``a @ b.T`` for a (P, N) and b (Q, N) or (N,): (P, Q) or (P,), for P and Q of a dozen and N of thousands."""
    return np.asarray(
        sum(
            (a[:, first : first + BLOCK] @ b[..., first : first + BLOCK].T for first in range(0, a.shape[1], BLOCK)),
            start=np.zeros((len(a), *b.shape[:-1])),
        )
    )


def weighted_sum(weights: Floats, rows: Floats) -> Floats:
    """``weights @ rows`` for weights (P,) and rows (P, N): (N,)."""
    total = np.zeros(rows.shape[1])
    for weight, row in zip(weights, rows, strict=True):
        total += weight * row
    return total


def lengths(offsets: Floats) -> Floats:
    """Length (N,) of each of offsets (N, 2), without the guard of ``np.hypot`` against overflow, at a quarter of it."""
    x, y = offsets[:, 0], offsets[:, 1]
    return np.asarray(np.sqrt(x * x + y * y))
