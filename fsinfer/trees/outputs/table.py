"""``trees.csv``: one row a tree, empty where a value was not measured; yes and no are 1 and 0."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

from fsinfer.io.csv_text import CsvRow, read_table, write_table
from fsinfer.notices.notice import notice
from fsinfer.notices.stems import StemCode
from fsinfer.trees.tree import Tree

#: The columns in their order: the fields of :class:`~fsinfer.trees.tree.Tree`, the reasons in words.
COLUMNS: tuple[str, ...] = tuple("reason" if field.name == "reasons" else field.name for field in fields(Tree))
_OPTIONAL = frozenset(field.name for field in fields(Tree) if "None" in str(field.type))
_INTEGERS = frozenset({"tree_id", "points"})
_TEXT = frozenset({"status", "reason", "part"})
_YES_OR_NO = frozenset(field.name for field in fields(Tree) if str(field.type).startswith("bool"))
#: Columns that a table of an earlier version lacks; they are read as empty.
_LATER = frozenset(field.name for field in fields(Tree) if field.default is not MISSING)


def write_trees(path: Path, trees: Sequence[Tree]) -> None:
    """Write ``trees`` as CSV (UTF-8, comma, point), atomically; a table without trees has its header line."""
    write_table(path, COLUMNS, ([_text(name, getattr(tree, name)) for name in COLUMNS] for tree in trees))


def read_trees(path: Path) -> list[Tree]:
    """Read a ``trees.csv``; reasons come back as they are written (``StemCode.as_written``).

    Raises :class:`~fsinfer.errors.InputError` naming the row and column that cannot be read.
    """
    table = read_table(
        path,
        what="the table of trees",
        required=[name for name in COLUMNS if name not in _LATER],
        way_out="give the trees.csv that 'fsinfer trees' wrote",
    )
    return [_tree(row) for row in table.rows]


def table_row(tree: Tree) -> tuple[float | int | str | None, ...]:
    """The values of ``COLUMNS`` for a spreadsheet: numbers rounded as in the CSV, None where nothing was measured."""
    values = ((name, getattr(tree, name)) for name in COLUMNS)
    return tuple(round(v, _decimals(n)) if isinstance(v, float) else v for n, v in values)


def _text(name: str, value: Any) -> str:
    if value is None:
        return ""
    if name in _YES_OR_NO:
        return str(int(value))
    if name in _TEXT or name in _INTEGERS:
        return str(value)
    return f"{value:.{_decimals(name)}f}"


def _decimals(name: str) -> int:
    if name.endswith("_cm"):
        return 2
    if name.endswith("_deg"):
        return 1
    if name in {"bh_m", "height_m", "arc_coverage"}:
        return 2
    return 3


def _tree(row: CsvRow) -> Tree:
    values: dict[str, Any] = {}
    for name in COLUMNS:
        if name == "reason":
            text = row.text(name)
            values["reasons"] = (notice(StemCode.as_written, text=text),) if text else ()
        elif name in _TEXT:
            values[name] = row.text(name) or (None if name in _OPTIONAL else "")
        elif name in _YES_OR_NO:
            given = row.number(name)
            values[name] = None if given is None else given != 0
        elif name in _INTEGERS:
            values[name] = row.whole(name)
        else:
            values[name] = row.number(name) if name in _OPTIONAL else row.given(name)
    return Tree(**values)
