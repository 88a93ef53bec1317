"""The process in which poses are found; :mod:`fsinfer.workflow.poses_apart` starts it and hears what it tells.

Standard input is a pipe that holds one line, the task, and closes when whoever gave it is gone. Standard output is a
pipe for lines of JSON: ``progress``, ``log``, and last ``result`` or ``error``. Only what is light is imported here:
signals have to be turned off first.
"""

from __future__ import annotations

import json
import logging
import os
import signal
import sys
import threading
from contextlib import suppress
from pathlib import Path
from typing import Any

#: What ends a group of processes at once, by name, where the system has it.
_FOR_THE_PARENT = ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")
#: The call by which Linux tells a process that its parent has died. Source: format; prctl(2).
_PR_SET_PDEATHSIG = 1


class Teller:
    """Writes messages to the pipe, from any thread; without anybody who hears them the process ends."""

    def __init__(self, number: int) -> None:
        self._number, self._lock = number, threading.Lock()

    def tell(self, **message: Any) -> None:
        """One line: ``{kind: value}``."""
        left = memoryview(json.dumps(message).encode("ascii") + b"\n")
        with self._lock:
            try:
                while left:
                    left = left[os.write(self._number, left) :]
            except OSError:
                os._exit(1)


class _ToldLines(logging.Handler):
    def __init__(self, teller: Teller) -> None:
        super().__init__()
        self._teller = teller

    def emit(self, record: logging.LogRecord) -> None:
        self._teller.tell(log=[record.name, record.levelno, record.getMessage()])


def main() -> None:
    """Do the task on standard input."""
    for name in _FOR_THE_PARENT:
        if hasattr(signal, name):
            # Ctrl-C reaches both; the parent answers it, and kills this process at once.
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    task = json.loads(sys.stdin.readline())
    teller = _take_pipes()
    _end_with_parent(task["parent"])
    logging.basicConfig(level=task["log_level"], handlers=[_ToldLines(teller)])
    try:
        teller.tell(**_work(task, teller))
    except Exception as error:
        from fsinfer.workflow.error_json import error_json

        teller.tell(error=error_json(error))
    # Nothing is left to be put in order, and libraries that tidy up at the end may crash at it.
    os._exit(0)


def _work(task: dict[str, Any], teller: Teller) -> dict[str, Any]:
    from fsinfer.output.json_values import as_json, of_json
    from fsinfer.poses.estimate import estimate_poses
    from fsinfer.poses.settings import PoseSettings
    from fsinfer.workflow.memory_peak import MemoryPeak

    peak = MemoryPeak()
    result = estimate_poses(
        Path(task["images"]),
        Path(task["out"]),
        settings=of_json(PoseSettings, task["settings"]),
        origin=None if task["origin"] is None else Path(task["origin"]),
        resume=task["resume"],
        progress=lambda done, total, what: teller.tell(progress=[int(done), int(total), what]),
    )
    return {"result": as_json(result), "peak_mb": peak.read_mb()}


def _take_pipes() -> Teller:
    """Keep the two pipes for ourselves: what libraries print goes to standard error, and they read nothing."""
    heard, told = os.dup(sys.stdin.fileno()), os.dup(sys.stdout.fileno())
    # On Windows a library that is loaded while a thread reads standard input would wait for it.
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, sys.stdin.fileno())
    os.close(nothing)
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())

    def end_with_input() -> None:
        with suppress(OSError):
            while os.read(heard, 1):
                pass
        os._exit(1)

    threading.Thread(target=end_with_input, daemon=True).start()
    return Teller(told)


def _end_with_parent(parent: int) -> None:
    """On Linux, end at the moment when the parent does, not when the closed pipe is read after a step of COLMAP."""
    if sys.platform == "linux":
        import ctypes

        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:
            os._exit(1)  # it was gone before
