"""The process in which poses are found; :mod:`fsinfer.workflow.poses_apart` starts it and hears what it tells.

Standard input is a pipe that holds one line, the task, and closes when whoever gave it is gone. Standard output is a
pipe for lines of JSON: ``progress``, ``log``, and last ``result`` or ``error``. Only what is light is imported here:
signals have to be turned off first.
"""

from __future__ import annotations

import json
import logging
import os
import sys
import threading
from contextlib import suppress
from pathlib import Path
from typing import Any

from fsinfer.child_process import end_with_parent, leave_interrupts_to_parent, take_pipes


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
    leave_interrupts_to_parent()
    task = json.loads(sys.stdin.readline())
    teller = _take_pipes()
    end_with_parent(task["parent"])
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
    """Who tells the parent; when its pipe closes, this process ends."""
    heard, told = take_pipes()

    def end_with_input() -> None:
        with suppress(OSError):
            while os.read(heard, 1):
                pass
        os._exit(1)

    threading.Thread(target=end_with_input, daemon=True).start()
    return Teller(told)
