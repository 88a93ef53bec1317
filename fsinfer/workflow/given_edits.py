"""Where the corrections of the last measurement lay, for a command that measures again without being given them.

``OUT/edits.csv`` is found by itself. A file that was given with ``--edits`` is noted in ``OUT/.fsinfer/edits.json``.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fsinfer.errors import FsinferError, InputError
from fsinfer.geometry.similarity import scale_of
from fsinfer.io.files import write_text
from fsinfer.io.json_text import read_json
from fsinfer.output.layout import RECORDS_FOLDER, OutputFolder
from fsinfer.output.plot_json import read_plot
from fsinfer.trees.edit_rows import TreeEdit
from fsinfer.trees.edited_trees import Places, RowPlaces, places_of, row_key
from fsinfer.trees.outputs.table import read_trees
from fsinfer.trees.tree import Tree

_NOTE_FILE, _TREES_FILE = "edits.json", "edited_trees.json"


def note_edits(out: Path, given: Path | None) -> None:
    """Note the file of corrections that a measurement into ``out`` was given, or that it was given none."""
    note = out / RECORDS_FOLDER / _NOTE_FILE
    told = None
    if given is not None:
        path = given.absolute()
        # A folder may be moved with what lies in it.
        told = str(path.relative_to(out.absolute())) if path.is_relative_to(out.absolute()) else str(path)
    if told != _read(note):
        write_text(note, json.dumps({"given": told}, indent=1) + "\n")


def last_edits(out: Path) -> Path | None:
    """The file of corrections that the last measurement into ``out`` was given; None where it was given none.

    Raises
    ------
    InputError
        It is gone, and there is no ``OUT/edits.csv`` either.
    """
    told = _read(out / RECORDS_FOLDER / _NOTE_FILE)
    if told is None:
        return None
    path = out / told  # an absolute path stays what it is
    if path.is_file():
        return path
    own = OutputFolder(out).edits
    if own.is_file():
        return None
    msg = (
        f"the corrections that the last measurement was given with --edits, {path}, are gone; put the file back or "
        f"copy it to {own}. To do without them, give the command of the last measurement again without --edits first"
    )
    raise InputError(msg)


def stood_before(out: Path, edits: Sequence[TreeEdit], trees: Sequence[Tree], unit: float) -> RowPlaces:
    """Where the trees stood that these rows were written for: on the map before the first measurement with them.

    That is noted in ``OUT/.fsinfer/edited_trees.json``, with the ``trees`` found now, for the rows to come; of a map
    of earlier versions, which noted nothing, ``trees.csv`` tells it. There places are in units of the scene or file, of
    which one is ``unit`` of the trees' frame: a cloud of another scale is the same.
    """
    note = out / RECORDS_FOLDER / _TREES_FILE
    told = _read_places(note)
    last, rows = told["trees"] if told else _places_of_table(out), told.get("rows", {})
    now = {tree.tree_id: (tree.x_m / unit, tree.y_m / unit) for tree in trees}
    stood = {row_key(edit): rows.get(row_key(edit)) or places_of(edit, last or now) for edit in edits}
    stood.pop("", None)
    content = json.dumps({"trees": {"": now}, "rows": stood}, indent=1) + "\n"
    write_text(note, content)
    return {key: {number: (x * unit, y * unit) for number, (x, y) in places.items()} for key, places in stood.items()}


def _places_of_table(out: Path) -> Places:
    """Places of the last map by ``trees.csv``, in units of the scene or file; empty where there is none."""
    try:
        plot, trees = read_plot(out), read_trees(OutputFolder(out).trees_csv)
        similarity, scale = plot.get("cloud_from_scene"), plot.get("trees_scale") or {}
        unit = float(scale.get("m_per_unit") or 1.0)
        unit *= 1.0 if similarity is None else scale_of(np.asarray(similarity, dtype=np.float64))
        return {tree.tree_id: (tree.x_m / unit, tree.y_m / unit) for tree in trees}
    except (FsinferError, OSError, ValueError, TypeError, AttributeError, IndexError, ArithmeticError):
        return {}


def _read_places(note: Path) -> dict[str, Any]:
    """``trees`` (of the last map) and ``rows``, places by numbers; empty where nothing was noted."""
    try:
        told = read_json(note)
        kinds = {
            kind: {
                str(key): {int(number): (float(x), float(y)) for number, (x, y) in places.items()}
                for key, places in told[kind].items()
            }
            for kind in ("trees", "rows")
        }
    except (OSError, ValueError, TypeError, KeyError, AttributeError, OverflowError):
        return {}
    return {"trees": kinds["trees"].get("", {}), "rows": kinds["rows"]}


def _read(note: Path) -> str | None:
    try:
        told = read_json(note)
    except (OSError, ValueError):
        return None
    given = told.get("given") if isinstance(told, dict) else None
    return given if isinstance(given, str) else None
