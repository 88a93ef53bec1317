"""Products in blocks against the product itself."""

from __future__ import annotations

import numpy as np
import pytest

from fsinfer.trees.points.sums import BLOCK, lengths, median, sums_of_products, weighted_sum


@pytest.mark.parametrize("count", [0, 1, BLOCK, 3 * BLOCK + 7])
def test_blocks_give_the_whole_product(count: int) -> None:
    rng = np.random.default_rng(count)
    a, b = rng.normal(0.0, 1.0, (5, count)), rng.normal(0.0, 1.0, (7, count))
    np.testing.assert_allclose(sums_of_products(a, b), a @ b.T, atol=1e-10)
    np.testing.assert_allclose(sums_of_products(a, b[0]), a @ b[0], atol=1e-10)
    np.testing.assert_allclose(weighted_sum(np.arange(5.0), a), np.arange(5.0) @ a, atol=1e-12)


@pytest.mark.parametrize("count", [1, 2, 7, 1000])
def test_median_and_lengths_are_those_of_numpy(count: int) -> None:
    vectors = np.random.default_rng(count).normal(0.0, 1.0, (count, 2))
    assert median(vectors[:, 0]) == np.median(vectors[:, 0])
    np.testing.assert_allclose(lengths(vectors), np.hypot(*vectors.T))
