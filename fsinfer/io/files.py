"""Writing results so that a kill at any moment leaves either the old file or the new one, never half of one."""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from fsinfer.errors import FsinferError, InputError, OutputError

#: A disk with less room than this is full. Source: judgement; a block or two are left where nothing fits any more.
_FULL_BYTES = 1 << 16
#: Bytes that are copied at once. Source: numerics.
_COPY_BYTES = 1 << 20
_FULL = frozenset({errno.ENOSPC, errno.EDQUOT})
# What lazrs and sqlite3 raise where the system does not let them write; named, since this module loads neither.
_ERRORS_OF_WRITERS = ("LazrsError", "OperationalError")
# Names by which Windows keeps how a folder looks, lower case.
_BY_EXPLORER = frozenset({"thumbs.db", "desktop.ini"})
# Systems that cannot flush a file: it is written all the same.
_NO_FLUSH = frozenset({errno.EINVAL, errno.EOPNOTSUPP, errno.ENOSYS})


def is_by_system(name: str) -> bool:
    """Whether a file of that name was put there by the system, not by a person or a program that was asked to.

    Finder leaves ``.DS_Store`` in each folder that it shows, and ``._NAME`` beside each file on a disk of another
    system; Explorer ``Thumbs.db`` and ``desktop.ini``.
    """
    return name.startswith(".") or name.lower() in _BY_EXPLORER


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
        # A link of that name, in a folder that somebody has sent, would be written through.
        temporary.unlink(missing_ok=True)
        yield temporary
        _flush(temporary)
        temporary.replace(path)
    except OSError as error:
        raise _output_error(path, error) from error
    except FsinferError:
        raise
    except Exception as error:
        # Writers of LAZ and GeoPackage have errors of their own.
        if is_disk_full(path.parent):
            raise disk_full(path) from error
        if type(error).__name__ in _ERRORS_OF_WRITERS:
            msg = f"cannot write {path}: {error}; choose another output folder"
            raise OutputError(msg) from error
        raise
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write ``text`` as UTF-8, atomically."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def copy_file(source: Path, target: Path) -> None:
    """Copy a file, atomically: a copy that a kill has cut would be taken for a whole one by whoever goes on.

    Raises
    ------
    InputError
        ``source`` cannot be read.
    OutputError
        ``target`` cannot be written.
    """
    try:
        stream = source.open("rb")
    except OSError as error:
        msg = f"cannot read {source}: {error.strerror or error}"
        raise InputError(msg) from error
    with stream, atomic_path(target) as temporary, temporary.open("wb") as copy:
        shutil.copyfileobj(stream, copy, _COPY_BYTES)


def remove_old(path: Path, *, way_out: str) -> None:
    """Remove a file; :class:`OutputError`, which ends with ``way_out``, where the system refuses."""
    try:
        path.unlink()
    except OSError as error:
        msg = f"cannot remove the old {path}: {error.strerror or error}; {way_out}"
        raise OutputError(msg) from error


def is_disk_full(folder: Path) -> bool:
    """Whether nothing more fits onto the disk of ``folder``."""
    try:
        return shutil.disk_usage(folder).free < _FULL_BYTES
    except OSError:
        return False


def disk_full(path: Path) -> OutputError:
    """The error of a disk on which ``path`` found no room."""
    return OutputError(f"the disk is full: could not write {path}; free some space and run the same command again")


def _flush(path: Path) -> None:
    """Have the content on the disk before the name: after a power cut there is the old file or the new one."""
    with path.open("r+b") as stream:
        try:
            os.fsync(stream.fileno())
        except OSError as error:
            if error.errno not in _NO_FLUSH:
                raise


def _output_error(path: Path, error: OSError) -> OutputError:
    # NumPy tells no number where a file could not be written to its end.
    if error.errno in _FULL or (error.errno is None and is_disk_full(path.parent)):
        return disk_full(path)
    return OutputError(f"cannot write {path}: {error.strerror or error}; choose another output folder")
