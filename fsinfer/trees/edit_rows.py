"""Corrections of a stem map by hand as they are written: the rows of ``edits.csv``."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from fsinfer.errors import InputError
from fsinfer.io.csv_text import CsvRow, read_table

EDITS_FILE = "edits.csv"
#: The columns that each action needs.
ACTIONS = {"delete": ("tree_id",), "add": ("x_m", "y_m"), "merge": ("tree_id", "other_id")}
#: Numbers of trees go no higher: tables of other programs hold them in 32 bits. Source: format.
MOST_NUMBER = 999_999_999


@dataclass(frozen=True, kw_only=True)
class TreeEdit:
    """One row of the CSV; fields that the action does not use are None. ``tree_id`` of an added tree is its number."""

    action: str
    row: int
    tree_id: int | None = None
    other_id: int | None = None
    x_m: float | None = None
    y_m: float | None = None


def read_edits(path: Path | str) -> tuple[TreeEdit, ...]:
    """Read an edits file: ``action, tree_id, other_id, x_m, y_m``, of which each action needs its own.

    Commas between the cells, or semicolons, and then decimal commas are understood too.

    Raises
    ------
    InputError
        The file cannot be read, a column that an action needs is missing, or a cell is wrong; file and row are named.
    """
    table = read_table(
        path,
        what="the edits",
        required=("action",),
        way_out="give a CSV whose first line is action,tree_id,other_id,x_m,y_m (see docs/trees.md)",
    )
    edits = tuple(_read_row(row, table.columns) for row in table.rows)
    given = Counter(edit.tree_id for edit in edits if edit.action == "add" and edit.tree_id is not None)
    for number, count in given.items():
        if count > 1:
            msg = f"{path}: {count} added trees have the tree_id {number}; give each its own, or leave the cell empty"
            raise InputError(msg)
    return edits


def find_edits(out: Path, given: Path | None) -> tuple[TreeEdit, ...]:
    """The edits of a file that was given, or of ``edits.csv`` in the output folder; none where there is neither."""
    if given is not None:
        return read_edits(given)
    path = out / EDITS_FILE
    return read_edits(path) if path.is_file() else ()


def _is_tree_number(value: float) -> bool:
    return value == int(value) and 1 <= value <= MOST_NUMBER


def _read_row(row: CsvRow, columns: Sequence[str]) -> TreeEdit:
    action = row.text("action").lower()
    if action not in ACTIONS:
        msg = f"{row.place}: the action is '{action}'; it must be {', '.join(ACTIONS)}"
        raise InputError(msg)
    missing = [name for name in ACTIONS[action] if name not in columns]
    if missing:
        msg = f"{row.place}: '{action}' needs the column {' and '.join(missing)}, which the file does not have; add it"
        raise InputError(msg)
    numbers: dict[str, float | None] = {}
    for name in ("tree_id", "other_id", "x_m", "y_m"):
        value = row.value(name)
        if value is None and name not in ACTIONS[action]:
            numbers[name] = None
            continue
        whole = name.endswith("_id")
        if value is None or not math.isfinite(value) or (whole and not _is_tree_number(value)):
            kind = f"the number of a tree, 1 to {MOST_NUMBER}," if whole else "a number"
            msg = f"{row.place}: '{action}' needs {kind} in the column {name}, not '{row.text(name)}'"
            raise InputError(msg)
        numbers[name] = value
    tree_id, other_id = numbers["tree_id"], numbers["other_id"]
    if action == "merge" and tree_id == other_id:
        msg = f"{row.place}: a tree cannot be merged with itself; name two trees"
        raise InputError(msg)
    return TreeEdit(
        action=action,
        row=row.row,
        tree_id=None if tree_id is None else int(tree_id),
        other_id=None if other_id is None else int(other_id),
        x_m=numbers["x_m"],
        y_m=numbers["y_m"],
    )
