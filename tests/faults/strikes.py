"""What befalls a run: each fault strikes in the process of the run itself, at the moment that it is called."""

from __future__ import annotations

import errno
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

#: Address space that a run keeps when memory ends, bytes; and size from which on no file is written, bytes.
_LAST_MEMORY, _LARGEST_FILE = 1 << 21, 256
#: How long a folder stalls, seconds.
_STALL_S = 1.0


class Synced:
    """Which files the run has flushed to the disk: a power cut drops what was written but not flushed."""

    def __init__(self) -> None:
        self._known: set[tuple[int, int, int]] = set()
        self._start_ns = time.time_ns()
        fsync = os.fsync

        def noting(number: int) -> None:
            fsync(number)
            self._known.add(_state(os.fstat(number)))

        os.fsync = noting  # type: ignore[assignment]

    def drop(self, out: Path) -> int:
        """Cut what is not on the disk: every second file to nothing, the others in half. Returns how many."""
        lost = 0
        for path in sorted(out.rglob("*")):
            state = path.lstat()
            if path.is_file() and state.st_mtime_ns >= self._start_ns and _state(state) not in self._known:
                os.truncate(path, 0 if lost % 2 else state.st_size // 2)
                lost += 1
        return lost


def _state(status: os.stat_result) -> tuple[int, int, int]:
    return status.st_ino, status.st_size, status.st_mtime_ns


def arm(out: Path, stage: str, writes: int, fault: str, *, second: Callable[[], int]) -> None:
    """Let ``fault`` strike once ``stage`` has begun and ``writes`` more files have been put in their place.

    ``second`` starts another run into the same folder and returns its exit code.
    """
    record = out / ".fsinfer" / f"{stage}.json"
    synced = Synced()
    replace = Path.replace
    seen, struck = -1, False

    def counting(self: Path, target: Path) -> Any:
        nonlocal seen, struck
        if struck and fault == "read-only":
            raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(target))
        done = replace(self, target)
        if seen >= 0 or Path(target) == record:
            seen += 1
        if seen == writes and not struck:
            struck = True
            strike(fault, out, synced, second)
        return done

    Path.replace = counting  # type: ignore[method-assign,assignment]


def strike(fault: str, out: Path, synced: Synced, second: Callable[[], int]) -> None:
    """Do it."""
    if fault in ("kill", "clock"):
        os.kill(os.getpid(), signal.SIGKILL)
    elif fault == "power cut":
        synced.drop(out)
        os.kill(os.getpid(), signal.SIGKILL)
    elif fault == "end":
        os.kill(os.getpid(), signal.SIGTERM)
    elif fault == "Ctrl-C":
        os.kill(os.getpid(), signal.SIGINT)
    elif fault == "full disk":
        fill_disk(out)
    elif fault == "file limit":
        import resource

        resource.setrlimit(resource.RLIMIT_FSIZE, (_LARGEST_FILE, resource.RLIM_INFINITY))
    elif fault == "no memory":
        import resource

        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
        limit = pages * os.sysconf("SC_PAGE_SIZE") + _LAST_MEMORY
        resource.setrlimit(resource.RLIMIT_AS, (limit, resource.RLIM_INFINITY))
    elif fault == "stall":
        time.sleep(_STALL_S)
    elif fault == "Ctrl-C in a stall":
        threading.Timer(_STALL_S / 4, os.kill, (os.getpid(), signal.SIGINT)).start()
        time.sleep(60)
    elif fault == "second run":
        if second() != 2:
            sys.exit("the second run was not refused")
    elif fault != "read-only":
        raise ValueError(f"there is no fault {fault!r}")


def fill_disk(out: Path) -> None:
    """Write until nothing more fits; only for a small file system of its own."""
    with (out.parent / "filler").open("wb", buffering=0) as stream:
        for size in (1 << 16, 1 << 9):
            try:
                while True:
                    stream.write(bytes(size))
            except OSError as error:
                if error.errno != errno.ENOSPC:
                    raise
