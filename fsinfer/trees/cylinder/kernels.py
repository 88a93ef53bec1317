"""What an iteration of :mod:`fsinfer.trees.cylinder.batch` does with each point, in single precision.

Written with few temporaries: these lines take most of the time of finding and fitting stems.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fsinfer.trees.points.sums import BLOCK

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]


def residual_rows(xyz: Singles, p: Floats) -> Singles:
    """Derivatives of the residuals, the residuals, and rows of zeros, for points (3, K, N) and parameters (K, P).

    Together (Q, K, N) with Q a multiple of eight above P, of which BLAS makes products twice as fast as of others.
    Points are about the heights of the axes.
    """
    columns = p.T.astype(np.float32)[:, :, None]
    x, y, z = xyz[0] - columns[0], xyz[1] - columns[1], xyz[2]
    u, v = columns[2:4]
    foot, other = x * u, y * v
    foot += other
    foot += z
    foot *= np.float32(1.0) / (np.float32(1.0) + u * u + v * v)
    x -= np.multiply(foot, u, out=other)
    y -= np.multiply(foot, v, out=other)
    rows = np.empty(((p.shape[1] // 8 + 1) * 8, *foot.shape), dtype=np.float32)
    rows[p.shape[1] + 1 :] = 0.0
    residual = np.multiply(x, x, out=rows[p.shape[1]])
    residual += np.multiply(y, y, out=other)
    np.subtract(z, foot, out=other)
    other *= other
    residual += other
    residual += np.float32(1e-18)
    np.sqrt(residual, out=residual)
    np.divide(np.float32(-1.0), residual, out=other)
    cosine, sine = np.multiply(x, other, out=rows[0]), np.multiply(y, other, out=rows[1])
    np.multiply(cosine, foot, out=rows[2])
    np.multiply(sine, foot, out=rows[3])
    rows[4] = -1.0
    np.negative(foot, out=rows[5])
    residual -= np.multiply(foot, columns[5], out=other)
    residual -= columns[4]
    # -cos ka and -sin ka from those of k - 1.
    c, s = cosine, sine
    for k in range(6, p.shape[1], 2):
        np.multiply(s, sine, out=rows[k])
        rows[k] -= np.multiply(c, cosine, out=other)
        np.multiply(c, sine, out=rows[k + 1])
        rows[k + 1] += np.multiply(s, cosine, out=other)
        np.negative(rows[k + 1], out=rows[k + 1])
        c, s = rows[k], rows[k + 1]
        residual += np.multiply(c, columns[k], out=other)
        residual += np.multiply(s, columns[k + 1], out=other)
    return rows


#: Numerics: erfc(x) = (a1 t + ... + a5 t^5) exp(-x^2) to 1.5e-7, t = 1 / (1 + p x), x >= 0.
#: Source: Abramowitz & Stegun (1964), 7.1.26.
_ERFC_P = np.float32(0.3275911 * np.sqrt(0.5))
#: Numerics: a1 to a5 of it, last to first.
_ERFC_A = tuple(np.float32(a) for a in (1.061405429, -1.453152027, 1.421413741, -0.284496736, 0.254829592))


def tail_density(scaled: Singles, body: Singles, ratio: Singles) -> Singles:
    """Density (K, N) of a Gaussian plus an outward exponential, times twice the latter's mean, to 2e-6.

    ``scaled`` are the residuals over sigma, ``body`` exp(-scaled^2 / 2), ``ratio`` (K, 1) or (K, N) sigma over the
    exponential's mean. With a = (ratio - scaled) / sqrt(2) it is body erfcx(a); for a < 0, where erfcx grows without
    bound, erfcx(a) = 2 exp(a^2) - erfcx(-a), and body exp(a^2) is a plain exponential.
    """
    argument = ratio - scaled
    t = np.abs(argument)
    t *= _ERFC_P
    t += np.float32(1.0)
    np.divide(np.float32(1.0), t, out=t)
    value = _ERFC_A[0] * t
    for factor in _ERFC_A[1:]:
        value += factor
        value *= t
    value *= body
    # Below 0 for a < 0; for others, where it is not wanted, it must not overflow.
    plain = np.float32(0.5) * ratio - scaled
    plain *= ratio
    np.abs(plain, out=plain)
    np.negative(plain, out=plain)
    np.exp(plain, out=plain)
    plain *= np.float32(2.0)
    # |0 - value| or 2 plain - value, quicker than choosing between the two.
    plain *= argument < 0
    plain -= value
    return np.asarray(np.abs(plain, out=plain), np.float32)


def blocked(count: int) -> int:
    """The least number from ``count`` on that falls into equal blocks for :func:`sums_of_sets`."""
    blocks = max(-(-count // BLOCK), 1)
    return -(-count // blocks) * blocks


def sums_of_sets(a: Singles, b: Singles) -> Floats:
    """Sums (K, P, Q) of products over the points of each set, of a (P, K, N) and b (Q, K, N); N is ``blocked``.

    In blocks, so that BLAS keeps to one thread (:mod:`fsinfer.trees.points.sums`).
    """
    sets, count = a.shape[1:]
    blocks = max(-(-count // BLOCK), 1)
    left, right = (v.reshape(len(v), sets * blocks, count // blocks) for v in (a, b))
    sums = np.matmul(left.transpose(1, 0, 2), right.transpose(1, 2, 0)).astype(np.float64)
    return np.asarray(sums.reshape(sets, blocks, len(a), len(b)).sum(axis=1), np.float64)


def column(values: Floats) -> Singles:
    """Values (K,) for an array (K, N)."""
    return values.astype(np.float32)[:, None]
