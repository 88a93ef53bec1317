"""One run at a time in an output folder: two would empty and fill the same folders under each other's hands."""

from __future__ import annotations

import errno
import logging
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from fsinfer.errors import OutputError
from fsinfer.io.files import make_folder
from fsinfer.output.layout import RECORDS_FOLDER

#: Stays where it is, empty: whoever took it away would leave two runs with locks of their own.
LOCK_FILE = "lock"
#: What systems answer that have no locks for this folder, as some network shares.
_NO_LOCKS = frozenset({errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL})

_log = logging.getLogger(__name__)
_guard = threading.Lock()
# By the folder: the thread that holds its lock, and how many times.
_held: dict[Path, tuple[int, int]] = {}


@contextmanager
def alone_in(out: Path) -> Iterator[None]:
    """Hold the lock of an output folder; within one thread as often as wanted.

    The system takes it back when the process ends, however it ends, so that a kill leaves nothing to clean up. Where a
    folder has no locks, the work goes on without.

    Raises
    ------
    OutputError
        Another process, or another thread of this one, is at work in the folder.
    """
    folder = make_folder(out / RECORDS_FOLDER).resolve()
    me = threading.get_ident()
    with _guard:
        holder, times = _held.get(folder, (me, 0))
        if holder != me:
            raise _busy(out)
        stream = _take(out, folder / LOCK_FILE) if times == 0 else None
        _held[folder] = (me, times + 1)
    try:
        yield
    finally:
        with _guard:
            if times == 0:
                del _held[folder]
                if stream is not None:
                    stream.close()
            else:
                _held[folder] = (me, times)


def _take(out: Path, path: Path) -> BinaryIO | None:
    try:
        stream = path.open("a+b")
    except OSError as error:
        msg = f"cannot write into {path.parent}: {error.strerror or error}; choose another output folder"
        raise OutputError(msg) from error
    try:
        _lock(stream)
    except OSError as error:
        if error.errno in _NO_LOCKS:
            _log.info("%s: this folder has no locks (%s); going on without", out, error)
            return stream
        stream.close()
        raise _busy(out) from error
    return stream


def _lock(stream: BinaryIO) -> None:
    try:
        import fcntl
    except ImportError:  # Windows
        import msvcrt

        stream.seek(0)
        msvcrt.locking(stream.fileno(), msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined,unused-ignore]
        return
    fcntl.flock(stream.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)


def _busy(out: Path) -> OutputError:
    return OutputError(
        f"another run of fsinfer is at work in {out}; wait until it has ended, or choose another output folder"
    )
