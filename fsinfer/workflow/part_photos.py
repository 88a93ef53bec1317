"""The photographs of a part of a walk, in a folder of their own: those of this run and no others.

The number in the name of a part's folder is its place among the parts of one run. In the next run the same folder may
be another part's, or the same part may have lost photographs, so that what an earlier run left must not be measured.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from fsinfer.errors import InputError
from fsinfer.io.digest import file_digest
from fsinfer.io.files import copy_file, make_folder, remove_old, write_text
from fsinfer.io.json_text import read_json
from fsinfer.io.photo_folders import PHOTO_SUFFIXES, VIDEO_SUFFIXES
from fsinfer.output.layout import RECORDS_FOLDER

#: Digests of all files that were ever put into the folder, below the part's records.
_PUT_FILE = "photos.json"
#: Names that a message tells at most. Source: layout.
_MOST_NAMES = 3


def fill_part(part: Path, paths: Sequence[Path], frames: Sequence[Path]) -> Path:
    """Make ``part/photos`` hold exactly ``paths`` with their present content; return that folder.

    Parameters
    ----------
    frames: of the whole plot; a copy of one may be taken away, for nothing is lost by it.

    Raises
    ------
    InputError
        The folder holds photos that no run put there; nothing was touched.
    OutputError
        It cannot be written.
    """
    photos, notes = make_folder(part / "photos"), part / RECORDS_FOLDER / _PUT_FILE
    wanted = {path.name: file_digest(path) for path in paths}
    there = {path: file_digest(path) for path in sorted(photos.iterdir()) if _is_capture(path)}
    put = _read(notes)
    ours = put | {file_digest(path) for path in frames}
    if foreign := [path.name for path, digest in there.items() if digest not in ours]:
        more = ", …" if len(foreign) > _MOST_NAMES else ""
        msg = (
            f"{photos} holds photos that no run put there or that were changed ({', '.join(foreign[:_MOST_NAMES])}"
            f"{more}); move them away and run the same command again"
        )
        raise InputError(msg)
    if not put >= set(wanted.values()):
        # Before the first copy: after a kill all of them are known.
        write_text(notes, json.dumps({"put": sorted(put | set(wanted.values()))}, indent=1) + "\n")
    for path in there:
        if path.name not in wanted:
            remove_old(path, way_out="delete it by hand")
    for path in paths:
        if there.get(photos / path.name) != wanted[path.name]:
            copy_file(path, photos / path.name)
    return photos


def _is_capture(path: Path) -> bool:
    """Whether a run would take it for a photograph or a video."""
    suffix = path.suffix.lower()
    return (suffix in PHOTO_SUFFIXES or suffix in VIDEO_SUFFIXES) and not path.name.startswith(".") and path.is_file()


def _read(notes: Path) -> set[str]:
    try:
        told = read_json(notes)
    except (OSError, ValueError):
        return set()  # none, or damaged: then the frames tell what may be taken away
    put = told.get("put") if isinstance(told, dict) else None
    return {digest for digest in put if isinstance(digest, str)} if isinstance(put, list) else set()
