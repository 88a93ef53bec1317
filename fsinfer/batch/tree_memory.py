"""Resident memory of a process with all that it has started.

A limit by RLIMIT_AS would count addresses, not memory: onnxruntime, memory-mapped models and threads' stacks reserve
many times what they use, and a run would die far below its limit. So resident memory is looked at from outside.
"""

from __future__ import annotations

import os
from pathlib import Path

from fsinfer.errors import InputError

_PROC = Path("/proc")
_PROC_IS_THERE = (_PROC / "self" / "stat").is_file()
#: Bytes of a GB, as options count them. Source: format; its definition.
BYTES_OF_GB = 1e9
#: Fields of /proc/PID/stat behind the name: parent, session, resident pages. Source: format; proc(5).
_PARENT, _SESSION, _RESIDENT = 1, 3, 21


def resident_gb(pid: int) -> float:
    """GB (10⁹ bytes) held by process ``pid``, those of its session, and all that descend from it; 0 when it is gone.

    Pages that processes share count for each of them, so the figure is never too low.
    """
    return (_of_proc(pid) if _PROC_IS_THERE else _of_psutil(pid)) / BYTES_OF_GB


def check_can_look() -> None:
    """Raise :class:`InputError` where the memory of other processes cannot be seen."""
    if not _PROC_IS_THERE:
        try:
            import psutil  # noqa: F401
        except ImportError as error:
            msg = "--limit-gb needs the package psutil on this computer: pip install 'fsinfer[cluster]'"
            raise InputError(msg) from error


def _of_proc(pid: int) -> float:
    parents: dict[int, int] = {}
    pages: dict[int, int] = {}
    own: set[int] = set()
    for entry in _PROC.iterdir():
        if not entry.name.isdigit():
            continue
        try:
            # The name is in brackets and may hold anything, brackets too.
            fields = (entry / "stat").read_bytes().rpartition(b")")[2].split()
            number, parent = int(entry.name), int(fields[_PARENT])
            parents[number], pages[number] = parent, int(fields[_RESIDENT])
            if number == pid or int(fields[_SESSION]) == pid:
                own.add(number)
        except (OSError, IndexError, ValueError):
            continue  # it ended meanwhile
    grown = True
    while grown:
        more = {number for number, parent in parents.items() if parent in own} - own
        own |= more
        grown = bool(more)
    return float(sum(pages.get(number, 0) for number in own) * os.sysconf("SC_PAGE_SIZE"))


def _of_psutil(pid: int) -> float:
    import psutil

    total = 0.0
    try:
        process = psutil.Process(pid)
        for one in (process, *process.children(recursive=True)):
            total += one.memory_info().rss
    except psutil.NoSuchProcess:
        pass
    return total
