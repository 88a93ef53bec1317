"""Tables that people write: with commas, or as spreadsheets of countries with a decimal comma do."""

from __future__ import annotations

from collections.abc import Sequence


def has_semicolons(lines: Sequence[str]) -> bool:
    """Whether semicolons separate the cells of a CSV, by its first line; then decimal commas are to be expected."""
    return bool(lines) and lines[0].count(";") > lines[0].count(",")
