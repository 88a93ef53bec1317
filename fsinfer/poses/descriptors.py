"""Matching the descriptors of two photos by exact search: each with all of the other.

A match is the nearest of the other photo, on both sides, clearly nearer than the second nearest, and near: the rules,
and their numbers, are those of COLMAP. Its own search on the CPU goes through an index that is built for each photo and
finds nearly all; products of whole numbers find all in a third of the time (docs/trials-speed.md).

SIFT's 128 numbers have 8 bits and one length, so that the greater their product the nearer they are. One side of a
product has 7 bits (:mod:`fsinfer.poses.integer_product`), which turns a descriptor by a tenth of a degree at most.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsinfer.poses.integer_product import MOST, IntegerProducts

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

#: Products of the descriptors of one photo with all of the other that are made at a time: they stay in a core's cache.
#: Source: numerics, docs/trials-speed.md; of 4,300 by 4,300 the two nearest are found in 2.6 instead of 4.6 ms.
PRODUCTS_AT_ONCE = 400_000
#: What is taken off so that 8 bits without a sign have one. Source: format.
HALF_RANGE = 128
#: No product is as small. Source: numerics.
NONE = np.iinfo(np.int32).min


@dataclass(frozen=True, kw_only=True)
class Descriptors:
    """Those of one photo as both sides of a product.

    ``asked`` (N, 128) uint8 are halves of them, ``lengths`` (N,) their lengths, ``offsets`` (N,) what their products
    lack because ``found``, of (128, N) int8, are less by :data:`HALF_RANGE`, ``found_length`` that of a whole one.
    """

    asked: NDArray[np.uint8]
    lengths: Floats
    offsets: NDArray[np.int32]
    found: IntegerProducts
    found_length: float

    def __len__(self) -> int:
        return len(self.asked)


def prepared(descriptors: NDArray[np.uint8]) -> Descriptors:
    """``descriptors`` (N, 128) of one photo, ready to be multiplied."""
    asked = np.minimum((descriptors.astype(np.int16) + 1) >> 1, MOST).astype(np.uint8)
    whole = np.linalg.norm(descriptors.astype(np.float64), axis=1)
    return Descriptors(
        asked=asked,
        lengths=np.linalg.norm(asked.astype(np.float64), axis=1),
        offsets=HALF_RANGE * asked.sum(axis=1, dtype=np.int32),
        found=IntegerProducts((descriptors.astype(np.int16) - HALF_RANGE).astype(np.int8).T),
        found_length=float(np.median(whole)) if len(whole) else 1.0,
    )


def matched(one: Descriptors, other: Descriptors, *, max_ratio: float, max_angle: float) -> NDArray[np.uint32]:
    """Matches (M, 2) of two photos: the number of a descriptor in each.

    ``max_ratio`` is the most that the angle to the nearest may be of that to the second nearest, ``max_angle`` the most
    that it may be, radians. Source: Lowe, International Journal of Computer Vision 60, 2004; COLMAP.
    """
    if not len(one) or not len(other):
        return np.zeros((0, 2), dtype=np.uint32)
    every = np.arange(len(one))
    nearest, angle, second = _two_nearest(one, every, other)
    asked = every[(angle <= max_angle) & (angle < max_ratio * second)]
    back, angle, second = _two_nearest(other, nearest[asked], one)
    both = (back == asked) & (angle < max_ratio * second)
    return np.column_stack([asked[both], nearest[asked[both]]]).astype(np.uint32)


def _two_nearest(one: Descriptors, which: Indices, other: Descriptors) -> tuple[Indices, Floats, Floats]:
    """Of those of ``one``: the nearest of ``other``, and the angles to it and to the second nearest, radians."""
    nearest = np.empty(len(which), dtype=np.intp)
    products = np.empty((2, len(which)))
    at_once = max(1, PRODUCTS_AT_ONCE // len(other))
    for start in range(0, len(which), at_once):
        rows = slice(start, start + at_once)
        product = other.found.of(one.asked[which[rows]])
        every, best = np.arange(len(product)), product.argmax(axis=1)
        nearest[rows], products[0, rows] = best, product[every, best]
        product[every, best] = NONE
        products[1, rows] = product.max(axis=1)
    cosines = (products + one.offsets[which]) / (np.maximum(one.lengths[which], 1e-9) * other.found_length)
    angle, second = np.arccos(np.clip(cosines, -1.0, 1.0))
    return nearest, angle, second
