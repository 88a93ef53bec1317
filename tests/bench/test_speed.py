"""The benchmark of one depth map: every part of the model that ships is timed."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Iterator
from unittest.mock import patch

import pytest

from tests.bench.speed import ours


@pytest.fixture(autouse=True)
def _put_back() -> Iterator[None]:
    """What the benchmark times it replaces for good."""
    yield
    patch.stopall()


def test_every_part_of_a_map_is_timed() -> None:
    args = Namespace(model="cascade", threads=1, scene=None, views=2, height=96, width=128)
    seconds = ours(args, "float32")()
    parts = ("features", "volume", "regularizer", "narrow volume", "candidates", "refiner", "surface", "finish")
    assert seconds.keys() == {*parts, "features of one view", "rest", "all", "processor", "cached"}
    assert all(seconds[part] > 0 for part in parts)
    assert sum(seconds[part] for part in (*parts, "rest")) == pytest.approx(seconds["all"])
