"""A small table of numbers under a heading of its own."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class NumberTable:
    """``rows`` of shown texts below ``head``; ``total`` sets the last row off."""

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    total: bool = False
