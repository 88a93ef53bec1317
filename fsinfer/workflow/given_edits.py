"""Where the corrections of the last measurement lay, for a command that measures again without being given them.

``OUT/edits.csv`` is found by itself. A file that was given with ``--edits`` is noted in ``OUT/.fsinfer/edits.json``.
"""

from __future__ import annotations

import json
from pathlib import Path

from fsinfer.errors import InputError
from fsinfer.io.files import write_text
from fsinfer.io.json_text import read_json
from fsinfer.output.layout import RECORDS_FOLDER, OutputFolder

_NOTE_FILE = "edits.json"


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


def _read(note: Path) -> str | None:
    try:
        told = read_json(note)
    except (OSError, ValueError):
        return None
    given = told.get("given") if isinstance(told, dict) else None
    return given if isinstance(given, str) else None
