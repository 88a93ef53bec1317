"""Numbers with their nouns: "1 tree", "2 trees"."""

from __future__ import annotations

from string import Formatter
from typing import Any


def noun(number: int, one: str, more: str) -> str:
    """``one`` where there is 1 of it, ``more`` for any other number."""
    return one if number == 1 else more


def counted(number: int, one: str, more: str) -> str:
    """The number and its noun."""
    return f"{number} {noun(number, one, more)}"


class Counting(Formatter):
    """Templates whose fields may say both words of a number: ``{trees:tree|trees}``; others are as in str.format."""

    def format_field(self, value: Any, format_spec: str) -> str:
        """A value as its field asks for it."""
        one, bar, more = format_spec.partition("|")
        return counted(value, one, more) if bar else super().format_field(value, format_spec)
