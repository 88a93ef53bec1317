"""The photographs of a plot to a worker, and its results back."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from fsinfer.batch.attempt import Attempt, PlotTask, attempt, is_stopped
from fsinfer.batch.outcome import CORRECTIONS, photo_files
from fsinfer.batch.run_log import LOG_FILE
from fsinfer.cluster.pieces import (
    below,
    bundles,
    list_files,
    make_scratch,
    pieces_of,
    read_parts,
    remove_scratch,
    write_pieces,
)
from fsinfer.errors import ClusterError
from fsinfer.io.files import make_folder
from fsinfer.output.layout import LOG_FILE as FAULT_LOG_FILE
from fsinfer.output.layout import METRIC_TREE_FILES

#: Calls a function on the worker and returns what it returns.
Call = Callable[..., Any]
#: Where results lie until all of them are here.
_ARRIVING = ".arriving"
_PHOTOS, _OUT, _FILES = "photos", "out", "files"


def attempt_there(
    call: Call,
    task: PlotTask,
    files: Sequence[tuple[str, Path]],
    scratch_in: str | None,
    left: Callable[[str], None] = lambda _: None,
) -> Attempt:
    """Measure a plot on the worker that ``call`` reaches; its results lie in ``task.out`` afterwards.

    Of an attempt that failed only what it said comes back: the next one may be on another worker, and begins anew.
    ``left`` is told of a folder on the worker that could not be deleted, because the cluster was given up.
    """
    photos = photo_files(task.photos)
    if not photos:
        msg = f"{task.photos} holds no photos, or cannot be read from this computer; --copy sends them from here"
        return Attempt(done=False, message=msg)
    make_folder(task.out)
    # The names of both stand in the report.
    inside, out = f"{_PHOTOS}/{task.photos.name}", f"{_OUT}/{task.out.name}"
    single = task.photos.is_file()
    sent = {inside if single else f"{inside}/{path.name}": path for path in photos}
    named = [(flag, f"{_FILES}/{flag.strip('-')}/{path.name}", path) for flag, path in files]
    sent |= {name: path for _, name, path in named if path.is_file()}
    sent |= {f"{out}/{name}": task.out / name for name in CORRECTIONS if (task.out / name).is_file()}
    folder = call(make_scratch, scratch_in)
    try:
        for pieces in pieces_of(sent):
            call(write_pieces, folder, pieces)
        there = replace(task, photos=Path(inside), out=Path(out))
        tried: Attempt = call(attempt_in, folder, there, [(flag, name) for flag, name, _ in named])
        _bring(call, f"{folder}/{out}", task.out, only=() if tried.done else (LOG_FILE, FAULT_LOG_FILE))
    finally:
        try:
            call(remove_scratch, folder)
        except ClusterError:
            left(folder)
            raise
    return tried


def attempt_in(folder: str, task: PlotTask, files: Sequence[tuple[str, str]]) -> Attempt:
    """Run the plot in scratch; photographs, output folder and files of options are given below ``folder``."""
    root = Path(folder)
    options = (*task.options, *(f"{flag}={root / name}" for flag, name in files))
    here = {"photos": root / task.photos, "out": root / task.out, "options": options}
    try:
        return attempt(PlotTask(**(vars(task) | here)))
    finally:
        if is_stopped(task.batch):
            # Whoever gave the plot does not wait for this thread any more.
            remove_scratch(folder)


def _bring(call: Call, folder: str, out: Path, *, only: Sequence[str]) -> None:
    """Fetch results beside ``out``'s own files, and put them in their place when all are here."""
    arriving = out / _ARRIVING
    shutil.rmtree(arriving, ignore_errors=True)
    make_folder(arriving)
    for load in bundles(call(list_files, folder, only)):
        for piece in call(read_parts, folder, load):
            path = below(arriving, piece.name)
            path.parent.mkdir(parents=True, exist_ok=True)
            with path.open("r+b" if path.exists() else "wb") as stream:
                stream.seek(piece.start)
                stream.write(piece.data)
    if not only:
        for name in METRIC_TREE_FILES:
            (out / name).unlink(missing_ok=True)
    for path in sorted(arriving.iterdir()):
        target = out / path.name
        if target.is_dir() and not target.is_symlink():
            # Only what a run has made itself has such a name, and it is replaced as a whole.
            shutil.rmtree(target)
        path.replace(target)
    arriving.rmdir()
