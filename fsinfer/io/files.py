"""Writing results so that a kill at any moment leaves either the old file or the new one, never half of one."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fsinfer.errors import OutputError


def make_folder(folder: Path) -> Path:
    """Create ``folder`` with its parents; raise :class:`OutputError` where that is impossible."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _output_error(folder, error) from error
    if not os.access(folder, os.W_OK):
        msg = f"cannot write into {folder}: no permission; choose another output folder"
        raise OutputError(msg)
    return folder


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside ``path`` that replaces it when the block ends without an error.

    The temporary name keeps the suffix of ``path`` because image and LAZ writers choose their format by it.
    Raises :class:`OutputError` when the disk is full or the folder is not writable.
    """
    make_folder(path.parent)
    temporary = path.with_name(f".{path.stem}.part{path.suffix}")
    try:
        yield temporary
        temporary.replace(path)
    except OSError as error:
        raise _output_error(path, error) from error
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write ``text`` as UTF-8, atomically."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _output_error(path: Path, error: OSError) -> OutputError:
    if error.errno == errno.ENOSPC:
        return OutputError(f"the disk is full: could not write {path}; free some space and run the same command again")
    return OutputError(f"cannot write {path}: {error.strerror or error}; choose another output folder")
