"""``trees.csv``: one row a tree, empty where a value was not measured."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from fsinfer.errors import InputError
from fsinfer.io.files import atomic_path
from fsinfer.trees.tree import Tree

#: The columns in their order: exactly the fields of :class:`~fsinfer.trees.measure.Tree`.
COLUMNS: tuple[str, ...] = tuple(field.name for field in fields(Tree))
_OPTIONAL = frozenset(field.name for field in fields(Tree) if "None" in str(field.type))
_INTEGERS = frozenset({"tree_id", "points"})
_TEXT = frozenset({"status", "reason"})


def write_trees(path: Path, trees: Sequence[Tree]) -> None:
    """Write ``trees`` as CSV (UTF-8, comma, point), atomically; a table without trees has its header line."""
    with atomic_path(Path(path)) as temporary, temporary.open("w", newline="", encoding="utf-8") as handle:
        writer = csv.writer(handle, lineterminator="\n")
        writer.writerow(COLUMNS)
        for tree in trees:
            writer.writerow([_text(name, getattr(tree, name)) for name in COLUMNS])


def read_trees(path: Path) -> list[Tree]:
    """Read a ``trees.csv``.

    Raises :class:`~fsinfer.errors.InputError` naming the row and column that cannot be read.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        msg = f"cannot read {path}: {error}; give the trees.csv that 'fsinfer trees' wrote"
        raise InputError(msg) from error
    reader = csv.DictReader(text.splitlines())
    missing = [name for name in COLUMNS if name not in (reader.fieldnames or [])]
    if missing:
        msg = f"{path} has no column {', '.join(missing)}; give the trees.csv that 'fsinfer trees' wrote"
        raise InputError(msg)
    return [_tree(path, number, row) for number, row in enumerate(reader, start=2)]


def table_row(tree: Tree) -> tuple[float | int | str | None, ...]:
    """The values of ``COLUMNS`` for a spreadsheet: numbers rounded as in the CSV, None where nothing was measured."""
    values = ((name, getattr(tree, name)) for name in COLUMNS)
    return tuple(round(v, _decimals(n)) if isinstance(v, float) else v for n, v in values)


def _text(name: str, value: Any) -> str:
    if value is None:
        return ""
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


def _tree(path: Path, number: int, row: dict[str, str]) -> Tree:
    values: dict[str, Any] = {}
    for name in COLUMNS:
        text = (row[name] or "").strip()
        try:
            if name in _TEXT:
                values[name] = text
            elif text == "" and name in _OPTIONAL:
                values[name] = None
            else:
                values[name] = int(text) if name in _INTEGERS else float(text)
        except ValueError as error:
            msg = f"{path}, row {number}, column {name}: {text!r} is not a number; correct the cell or leave it empty"
            raise InputError(msg) from error
    return Tree(**values)
