"""Exact search of descriptors: against the definition in floating point, and in the cases where there is little."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.poses import descriptors
from fsinfer.poses.descriptors import matched, prepared
from fsinfer.poses.integer_product import MOST, IntegerProducts

RATIO, ANGLE = 0.8, 0.7


def of_length(values: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Descriptors as COLMAP writes them: 512 long, in 8 bits."""
    unit = values / np.linalg.norm(values, axis=1, keepdims=True)
    return np.asarray(np.round(512.0 * unit), dtype=np.uint8)


def sift(count: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Something like SIFT's: many small numbers and some large ones."""
    return rng.gamma(0.7, 1.0, (count, 128)).clip(0.0, 3.0)


def two_photos(rng: np.random.Generator, shared: int, own: int) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """``shared`` features seen in both, from a little farther off, among ``own`` others; the second in disorder."""
    same = sift(shared, rng)
    change = rng.uniform(0.05, 0.6, (shared, 1))
    again = np.abs(same + change * rng.standard_normal(same.shape))
    first = np.vstack([same, sift(own, rng)])
    second = np.vstack([again, sift(own + 7, rng)])
    return of_length(first), of_length(second[rng.permutation(len(second))])


def by_definition(first: NDArray[np.uint8], second: NDArray[np.uint8]) -> set[tuple[int, int]]:
    """Nearest on both sides, near, and clearly nearer than the second nearest of either photo."""
    one, other = (d / np.linalg.norm(d.astype(np.float64), axis=1, keepdims=True) for d in (first, second))
    angles = np.arccos(np.clip(one @ other.T, -1.0, 1.0))
    found = set()
    for i, row in enumerate(angles):
        j = int(row.argmin())
        column = angles[:, j]
        nearest = row[j]
        if int(column.argmin()) == i and nearest <= ANGLE:
            others = min(np.delete(row, j).min(initial=np.pi), np.delete(column, i).min(initial=np.pi))
            if nearest < RATIO * others:
                found.add((i, j))
    return found


def pairs_of(first: NDArray[np.uint8], second: NDArray[np.uint8]) -> set[tuple[int, int]]:
    found = matched(prepared(first), prepared(second), max_ratio=RATIO, max_angle=ANGLE)
    assert found.dtype == np.uint32
    return {(int(i), int(j)) for i, j in found}


@pytest.mark.parametrize("seed", range(4))
def test_matches_are_those_of_the_definition(seed: int) -> None:
    rng = np.random.default_rng(seed)
    first, second = two_photos(rng, shared=400, own=306)
    truth, found = by_definition(first, second), pairs_of(first, second)
    assert len(truth) > 250
    # One side has seven bits: what lies at the edge of a rule may fall on its other side.
    assert len(truth & found) >= 0.98 * len(truth)
    assert len(found - truth) <= 0.02 * len(truth)


@pytest.mark.parametrize("products", [1, 711, 100_000])
def test_products_of_few_at_a_time_make_the_same_matches(products: int, monkeypatch: pytest.MonkeyPatch) -> None:
    first, second = two_photos(np.random.default_rng(6), shared=200, own=500)
    at_once = pairs_of(first, second)
    monkeypatch.setattr(descriptors, "PRODUCTS_AT_ONCE", products)
    assert pairs_of(first, second) == at_once
    assert len(at_once) > 100


def test_the_other_way_round_they_are_the_same() -> None:
    first, second = two_photos(np.random.default_rng(5), shared=300, own=100)
    there, back = pairs_of(first, second), {(i, j) for j, i in pairs_of(second, first)}
    assert len(there & back) >= 0.97 * max(len(there), len(back)) > 0


def test_a_feature_that_looks_like_two_of_the_other_photo_is_none() -> None:
    first, second = two_photos(np.random.default_rng(6), shared=50, own=20)
    number, partner = min(pairs_of(first, second))
    twice = np.vstack([second, second[partner : partner + 1]])
    assert number not in {i for i, _ in pairs_of(first, twice)}
    # Nor is one of the other photo that two look like.
    assert partner not in {j for _, j in pairs_of(np.vstack([first, first[number : number + 1]]), second)}


def test_the_farther_of_two_whose_nearest_is_the_same_is_none() -> None:
    rng = np.random.default_rng(10)
    values = sift(30, rng)
    farther, nearer = (np.abs(values[:1] + change * rng.standard_normal((1, 128))) for change in (0.4, 0.05))
    assert pairs_of(of_length(np.vstack([farther, nearer])), of_length(values)) == {(1, 0)}
    assert pairs_of(of_length(farther), of_length(values)) == {(0, 0)}


def test_what_is_not_near_is_no_match() -> None:
    rng = np.random.default_rng(7)
    first, second = of_length(sift(1, rng)), of_length(sift(1, rng))
    assert pairs_of(first, second) == set()
    assert pairs_of(first, first) == {(0, 0)}


def test_a_photo_without_features_has_no_matches() -> None:
    none, some = np.zeros((0, 128), dtype=np.uint8), of_length(sift(5, np.random.default_rng(8)))
    for one, other in ((none, some), (some, none), (none, none)):
        assert matched(prepared(one), prepared(other), max_ratio=RATIO, max_angle=ANGLE).shape == (0, 2)


def test_a_product_of_the_greatest_numbers_does_not_overflow() -> None:
    """Processors that add up two products in 16 bits would cut them off."""
    first = np.full((3, 128), MOST, dtype=np.uint8)
    second = np.full((128, 2), -128, dtype=np.int8)
    second[:, 1] = 127
    assert IntegerProducts(second).of(first).tolist() == [[-128 * MOST * 128, 127 * MOST * 128]] * 3
    rng = np.random.default_rng(9)
    first = rng.integers(0, MOST + 1, (300, 128), dtype=np.uint8)
    second = rng.integers(-128, 128, (128, 70), dtype=np.int8)
    assert np.array_equal(IntegerProducts(second).of(first), first.astype(np.int64) @ second.astype(np.int64))


def test_no_half_of_a_descriptor_is_more_than_that() -> None:
    assert prepared(np.full((1, 128), 255, dtype=np.uint8)).asked.max() == MOST
