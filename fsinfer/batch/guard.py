"""Runs one command and sees to it that it ends: ``python -m fsinfer.batch.guard TASK``, TASK a JSON object.

A process of its own beside the plot's, so that time and memory are watched whatever the plot does, and so that the plot
ends when whoever asked for it is gone: its standard input is a pipe from there, which closes by itself even after
SIGKILL. What it has to tell is JSON on its standard output: first the number of the process, last how it ended.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path
from typing import IO

from fsinfer.batch.lease import Lease
from fsinfer.batch.tree_memory import resident_gb
from fsinfer.errors import OutputError

#: Between two looks at the command; between two at its memory, which costs more. Seconds. Source: numerics.
LOOK_S, MEMORY_S = 0.1, 0.5
#: Time that a command gets to end by itself after it was asked to, seconds. Source: judgement; ``fsinfer run`` answers
#: at once, but what it has begun to write may be large.
GRACE_S = 10.0


class Ended(StrEnum):
    """How a command came to its end."""

    itself = "itself"
    time = "time"
    memory = "memory"
    stopped = "stopped"
    unable = "unable"


@dataclass(frozen=True, kw_only=True)
class GuardTask:
    """What to run, and within what.

    Attributes
    ----------
    command: words of the command line.
    log: file that its output is appended to.
    lease_folder: nothing else may run here meanwhile.
    limit_minutes, limit_gb: None for no limit.
    """

    command: tuple[str, ...]
    log: str
    lease_folder: str
    limit_minutes: float | None = None
    limit_gb: float | None = None


@dataclass(frozen=True, kw_only=True)
class GuardResult:
    """How it ended: exit status (negative: the signal), seconds, largest memory seen (None where it cannot be).

    ``message``: why it could not be run at all.
    """

    ended: Ended
    returncode: int | None
    seconds: float
    peak_gb: float | None
    message: str = ""


def guard(task: GuardTask, stop: threading.Event, report_pid: IO[str] | None = None) -> GuardResult:
    """Run the command to its end, or end it: for its time, its memory, or because ``stop`` is set."""
    lease = Lease(Path(task.lease_folder))
    try:
        if not lease.take(stop.is_set):
            return GuardResult(ended=Ended.stopped, returncode=None, seconds=0.0, peak_gb=None)
    except OutputError as error:
        return GuardResult(ended=Ended.unable, returncode=None, seconds=0.0, peak_gb=None, message=str(error))
    try:
        with Path(task.log).open("ab") as log:
            return _watch(task, stop, lease, log, report_pid)
    finally:
        lease.give_back()


def _watch(
    task: GuardTask, stop: threading.Event, lease: Lease, log: IO[bytes], report_pid: IO[str] | None
) -> GuardResult:
    start = time.monotonic()
    # A session of its own: a signal reaches all that it starts, and a Ctrl-C in the terminal does not.
    process = subprocess.Popen(task.command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True)
    if report_pid is not None:
        _tell(report_pid, {"pid": process.pid})
    peak_gb: float | None = None
    looked = -MEMORY_S
    ended = Ended.itself
    while process.poll() is None:
        now = time.monotonic()
        if task.limit_gb is not None and now - looked >= MEMORY_S:
            looked = now
            peak_gb = max(peak_gb or 0.0, resident_gb(process.pid))
        if stop.is_set():
            ended = Ended.stopped
        elif task.limit_gb is not None and peak_gb is not None and peak_gb > task.limit_gb:
            ended = Ended.memory
        elif task.limit_minutes is not None and now - start > 60.0 * task.limit_minutes:
            ended = Ended.time
        if ended is not Ended.itself:
            # Memory is short for everybody: no time to be polite.
            end_session(process, grace_s=0.0 if ended is Ended.memory else GRACE_S)
            break
        lease.keep()
        stop.wait(LOOK_S)
    else:
        # What it has started may have stayed behind.
        signal_session(process.pid, "SIGKILL")
    seconds = round(time.monotonic() - start, 2)
    return GuardResult(ended=ended, returncode=process.returncode, seconds=seconds, peak_gb=peak_gb)


def end_session(process: subprocess.Popen[bytes], *, grace_s: float) -> None:
    """End a process that leads a session, with all that it has started: asked first, then killed."""
    if sys.platform == "win32":
        # Windows knows no sessions; its own tool ends a process with those that it has started.
        subprocess.run(["taskkill", "/T", "/F", "/PID", str(process.pid)], capture_output=True, check=False)
        process.wait()
        return
    if grace_s > 0:
        signal_session(process.pid, "SIGTERM")
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(grace_s)
    signal_session(process.pid, "SIGKILL")
    process.wait()


def signal_session(pid: int, name: str) -> None:
    """Send a signal to all processes of a session, where there are any left and the system has such signals."""
    if sys.platform != "win32":
        with contextlib.suppress(ProcessLookupError, PermissionError):  # nobody is left
            os.killpg(pid, getattr(signal, name))


def _tell(stream: IO[str], what: dict[str, object]) -> None:
    stream.write(json.dumps(what) + "\n")
    stream.flush()


def main(arguments: list[str]) -> None:
    """Do the task given as JSON; standard input closes when it is no longer wanted."""
    given = json.loads(arguments[0])
    task = GuardTask(**(given | {"command": tuple(given["command"])}))
    stop = threading.Event()
    for name in ("SIGTERM", "SIGINT", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), lambda *_: stop.set())

    def wait_for_the_end_of_input() -> None:
        sys.stdin.buffer.read()
        stop.set()

    threading.Thread(target=wait_for_the_end_of_input, daemon=True).start()
    result = guard(task, stop, sys.stdout)
    _tell(sys.stdout, asdict(result))
    # The thread may still be reading, which Python would complain of at its ordinary end.
    os._exit(0)


if __name__ == "__main__":
    main(sys.argv[1:])
