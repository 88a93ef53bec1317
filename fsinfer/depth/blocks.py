"""Blocks of rows of a map, shared out over threads; they are independent of each other."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor


def over_blocks(fill: Callable[[int], None], height: int, block_rows: int, threads: int) -> None:
    """Call ``fill`` with the first row of each block of a map of ``height`` rows; NumPy and OpenCV release the GIL."""
    starts = range(0, height, block_rows)
    if threads <= 1:
        for start in starts:
            fill(start)
        return
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(fill, starts))
