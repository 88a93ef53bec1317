"""Matches of pairs of photos in COLMAP's database, before :mod:`fsinfer.poses.geometric_check` checks them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsinfer.poses.colmap_calls import image_number, open_database
from fsinfer.poses.descriptors import Descriptors, matched, prepared
from fsinfer.threads import in_order

Pair = tuple[int, int]


class PairMatcher:
    """Matches pairs of photos of one database, by their ranks among ``names``; keeps what the next pairs need again."""

    def __init__(self, database: Path, names: Sequence[str], *, max_ratio: float, max_angle: float) -> None:
        self._database, self._names = database, names
        self._max_ratio, self._max_angle = max_ratio, max_angle
        self._kept: dict[int, Descriptors] = {}

    def match(self, pairs: Sequence[Pair], threads: int) -> None:
        """Write the matches of ``pairs`` that the database has none of, so many at a time."""
        with open_database(self._database) as opened:
            numbers = {
                rank: image_number(opened, self._names[rank]) for rank in {rank for pair in pairs for rank in pair}
            }
            missing = [pair for pair in pairs if not opened.exists_matches(*(numbers[rank] for rank in pair))]
            self._keep(opened, {rank: numbers[rank] for pair in missing for rank in pair})
            for (first, second), found in zip(missing, in_order(self._matched, missing, threads), strict=True):
                opened.write_matches(numbers[first], numbers[second], found)

    def _matched(self, pair: Pair) -> NDArray[np.uint32]:
        one, other = (self._kept[rank] for rank in pair)
        return matched(one, other, max_ratio=self._max_ratio, max_angle=self._max_angle)

    def _keep(self, opened: Any, numbers: Mapping[int, int]) -> None:
        """Hold the descriptors of these photos, and of no other."""
        self._kept = {
            rank: self._kept[rank] if rank in self._kept else prepared(_descriptors(opened, number))
            for rank, number in numbers.items()
        }


def _descriptors(opened: Any, number: int) -> NDArray[np.uint8]:
    return np.asarray(opened.read_descriptors(number).data, dtype=np.uint8)
