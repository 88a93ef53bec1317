"""Work that threads share out: NumPy, OpenCV and onnxruntime release Python's lock."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

ItemT = TypeVar("ItemT")
ResultT = TypeVar("ResultT")


def in_threads(work: Callable[[ItemT], ResultT], items: Iterable[ItemT], threads: int) -> list[ResultT]:
    """What ``work`` gives for each item, in their order; one after the other where there is one thread."""
    if threads <= 1:
        return [work(item) for item in items]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(work, items))


def over_blocks(fill: Callable[[int], None], height: int, block_rows: int, threads: int) -> None:
    """Call ``fill`` with the first row of each block of rows of a map of ``height`` rows, independent of each other."""
    in_threads(fill, range(0, height, block_rows), threads)
