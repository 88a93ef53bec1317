"""Products of a few long rows, kept to one thread.

From some ten thousand multiplications on BLAS wakes all its threads, which wait for each other longer than the product
takes; on two cores the processor was busy more than twice as long. Blocks below that limit do not.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
#: Numerics: times 14 parameters, below the 9,216 elements from which OpenBLAS spreads a matrix-vector product.
BLOCK = 512
#: Standard deviation of a Gaussian over its median absolute deviation. Source: statistics.
MAD_TO_SIGMA = 1.4826
#: Standard deviations to either side that hold 95 % of a Gaussian. Source: statistics.
Z95 = 1.96


def sums_of_products(a: Floats, b: Floats) -> Floats:
    """``a @ b.T`` for a (P, N) and b (Q, N) or (N,): (P, Q) or (P,), for P and Q of a dozen and N of thousands."""
    rows = b if b.ndim == 2 else b[None]
    whole = a.shape[1] // BLOCK * BLOCK
    # Also the rest is a block of its own.
    product = a[:, whole:] @ rows[:, whole:].T
    if whole:
        blocks = [v[:, :whole].reshape(len(v), -1, BLOCK).transpose(1, 0, 2) for v in (a, rows)]
        product = product + (blocks[0] @ blocks[1].transpose(0, 2, 1)).sum(axis=0)
    return np.asarray(product if b.ndim == 2 else product[:, 0])


def weighted_sum(weights: Floats, rows: Floats) -> Floats:
    """``weights @ rows`` for weights (P,) and rows (P, N): (N,)."""
    total = np.zeros(rows.shape[1])
    for weight, row in zip(weights, rows, strict=True):
        total += weight * row
    return total


def median(values: Floats) -> float:
    """Median of values (N,), N > 0: that of NumPy, which looks at its arguments for longer than at few values."""
    middle = len(values) // 2
    ordered = np.partition(values, middle)
    high = float(ordered[middle])
    return high if len(values) % 2 else 0.5 * (float(ordered[:middle].max()) + high)


def lengths(offsets: Floats) -> Floats:
    """Length (N,) of each of offsets (N, 2), without the guard of ``np.hypot`` against overflow, at a quarter of it."""
    x, y = offsets[:, 0], offsets[:, 1]
    return np.asarray(np.sqrt(x * x + y * y))
