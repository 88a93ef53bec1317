"""One attempt at one plot: the installed ``fsinfer run`` under its guard, and what came of it."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path

from fsinfer._version import __version__
from fsinfer.batch.guard import Ended, GuardResult, GuardTask, signal_session
from fsinfer.batch.run_log import LOG_FILE, last_words
from fsinfer.errors import CRASHED, NOT_ENOUGH_MEMORY
from fsinfer.io.files import make_folder
from fsinfer.threads import cores

#: What the command line's exit codes mean (docs/quickstart.md). Source: format.
_EXIT_FAULT, _EXIT_INPUT, _EXIT_STOPPED = 1, 2, 130
#: By number of the signal: 9 is how the system ends a process when memory runs out. Source: format; signal(7).
_WHY_KILLED = {9: ", mostly for want of memory: give fewer --jobs, or a smaller max_size"}


@dataclass(frozen=True, kw_only=True)
class PlotTask:
    """What a computer needs to know to measure a plot.

    Attributes
    ----------
    batch: token of the batch, by which its plots can be stopped.
    photos, out: as this computer sees them.
    options: of ``fsinfer run``. command: what runs it; empty for the installed one.
    threads: cores; 0 is the computer's share among ``beside`` plots.
    limit_minutes, limit_gb: None for no limit.
    attempt: which one it is, from 1 on.
    version: of fsinfer that asks; another one would measure otherwise.
    """

    batch: str
    photos: Path
    out: Path
    options: tuple[str, ...] = ()
    command: tuple[str, ...] = ()
    threads: int = 0
    beside: int = 1
    limit_minutes: float | None = None
    limit_gb: float | None = None
    attempt: int = 1
    version: str = __version__


@dataclass(frozen=True, kw_only=True)
class Attempt:
    """What came of it.

    Attributes
    ----------
    done: whether the plot is measured. message: why not, one line. again: whether another attempt may go better.
    seconds: that it took; peak_gb: largest memory, where there was a limit on it. host: the computer.
    """

    done: bool
    message: str = ""
    again: bool = False
    seconds: float = 0.0
    peak_gb: float | None = None
    host: str = ""


class _Running:
    """The guards of this process by their batch, so that they can be stopped from another thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._guards: dict[str, set[subprocess.Popen[bytes]]] = {}
        self._stopped: set[str] = set()

    def add(self, batch: str, process: subprocess.Popen[bytes]) -> None:
        with self._lock:
            self._guards.setdefault(batch, set()).add(process)
            if batch in self._stopped:
                _hang_up(process)

    def remove(self, batch: str, process: subprocess.Popen[bytes]) -> None:
        with self._lock:
            self._guards.get(batch, set()).discard(process)

    def stop(self, batch: str) -> None:
        with self._lock:
            self._stopped.add(batch)
            for process in self._guards.get(batch, set()):
                _hang_up(process)

    def is_stopped(self, batch: str) -> bool:
        with self._lock:
            return batch in self._stopped


def _hang_up(process: subprocess.Popen[bytes]) -> None:
    if process.stdin is not None and not process.stdin.closed:
        process.stdin.close()


_running = _Running()


def stop_batch(batch: str) -> None:
    """End all plots of a batch that this process has under way; they can be gone on with."""
    _running.stop(batch)


def is_stopped(batch: str) -> bool:
    """Whether this process was told to end the plots of a batch."""
    return _running.is_stopped(batch)


def attempt(task: PlotTask) -> Attempt:
    """Run ``fsinfer run`` once; whatever becomes of it is a result, not an error."""
    host = socket.gethostname()
    if task.version != __version__:
        msg = f"{host} has fsinfer {__version__}, the batch {task.version}; install the same version everywhere"
        return Attempt(done=False, message=msg, again=True, host=host)
    start = time.monotonic()
    make_folder(task.out)
    log = task.out / LOG_FILE
    command = _command_line(task)
    begins = log.stat().st_size if log.is_file() else 0
    guard_task = GuardTask(
        command=command,
        log=str(log),
        lease_folder=str(task.out),
        limit_minutes=task.limit_minutes,
        limit_gb=task.limit_gb,
    )
    told = _under_guard(task.batch, guard_task)
    done, message, again = _judge(told, task, last_words(log, begins))
    return Attempt(
        done=done,
        message=message,
        again=again,
        seconds=round(time.monotonic() - start, 2),
        peak_gb=None if told is None else told.peak_gb,
        host=host,
    )


def _command_line(task: PlotTask) -> tuple[str, ...]:
    threads = task.threads or max(1, cores() // max(1, task.beside))
    command = task.command or (sys.executable, "-m", "fsinfer", "run")
    # Absolute paths: none begins with a dash, so none is taken for an option.
    places = (str(task.photos.absolute()), str(task.out.absolute()))
    return (*command, *places, *task.options, f"--threads={threads}")


def _under_guard(batch: str, task: GuardTask) -> GuardResult | None:
    """How the command ended; None where the guard itself was killed."""
    # Words for a file, not for a terminal: no colours, no boxes that break lines.
    environment = os.environ | {"PYTHONUTF8": "1", "NO_COLOR": "1", "TERM": "dumb", "COLUMNS": "1000"}
    with subprocess.Popen(
        [sys.executable, "-m", "fsinfer.batch.guard", json.dumps(vars(task))],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=environment,
        start_new_session=True,
    ) as process:
        _running.add(batch, process)
        try:
            lines = [] if process.stdout is None else [json.loads(line) for line in process.stdout]
        finally:
            _running.remove(batch, process)
            _hang_up(process)
    if lines and "ended" in lines[-1]:
        return GuardResult(**(lines[-1] | {"ended": Ended(lines[-1]["ended"])}))
    if lines:
        # Nobody watches over the command any more, and the next attempt must not meet it in the folder.
        signal_session(int(lines[0]["pid"]), "SIGKILL")
    return None


def _judge(told: GuardResult | None, task: PlotTask, words: str) -> tuple[bool, str, bool]:
    """Whether the plot is done, else why not, and whether to try again."""
    if told is None:
        return False, "was killed from outside, with the process that watched over it", True
    if told.ended is Ended.unable:
        return False, told.message, True
    if told.ended is Ended.time:
        return False, f"took longer than --limit-minutes {task.limit_minutes:g}; run again with more to go on", False
    if told.ended is Ended.memory:
        needed = f"{told.peak_gb or 0.0:.1f} GB"
        return False, f"held {needed}, more than --limit-gb {task.limit_gb:g}; give more, or a smaller max_size", True
    if told.ended is Ended.stopped:
        return False, "was stopped; run again to go on", True
    code = told.returncode
    if code == 0:
        return True, "", False
    if code == _EXIT_INPUT:
        # The messages of this kind that are no fault of the input.
        return False, words, NOT_ENOUGH_MEMORY in words or CRASHED in words
    if code == _EXIT_FAULT:
        return False, words, False
    if code == _EXIT_STOPPED:
        return False, "was stopped from outside; run again to go on", True
    if code is not None and code < 0:
        return False, f"was killed by {_signal_name(-code)}{_WHY_KILLED.get(-code, '')}", True
    return False, f"ended with exit code {code}: {words}", True


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"
