"""Poses in a process of their own: what ends it, a crash of COLMAP or the system for want of memory, ends no run.

Ctrl-C is answered at once as well, while COLMAP is at a step that takes seconds.
"""

from __future__ import annotations

import json
import logging
import os
import queue
import re
import signal
import subprocess
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

from fsinfer.child_process import python_command, search_path_line, start
from fsinfer.errors import CRASHED, NOT_ENOUGH_MEMORY, PosesError
from fsinfer.output.json_values import as_json, of_json
from fsinfer.poses.estimate import PosesResult, estimate_poses
from fsinfer.poses.settings import PoseSettings
from fsinfer.processes import child_ended
from fsinfer.progress import Progress, silent
from fsinfer.workflow.error_json import TraceThereError, error_of_json

_MODULE = "fsinfer.workflow.poses_process"
#: Between two looks at whether Ctrl-C was pressed, which Windows does not tell a thread that waits. Source: numerics.
_LOOK_S = 0.1
#: Threads that only read get so long to see that their pipe has closed. Source: numerics.
_GRACE_S = 5.0
#: Lines that are kept of what libraries print. Source: numerics; a trace of COLMAP.
_KEPT_LINES = 100
#: Frames and headings of the trace that COLMAP's library prints: they say less than the line before.
_OF_TRACE = re.compile(r"\s+@|PC: @|\*\*\*")
#: What C++ says before it gives up for want of memory.
_NO_MEMORY = "bad_alloc"

_log = logging.getLogger(__name__)


def estimate_poses_apart(
    images: Path,
    out: Path,
    *,
    settings: PoseSettings | None = None,
    origin: Path | None = None,
    resume: bool = False,
    progress: Progress = silent,
) -> PosesResult:
    """:func:`fsinfer.poses.estimate.estimate_poses` in a process of its own: same arguments, result and errors.

    In a program that is no Python interpreter (frozen, or one that Python is embedded in) it runs in this process.

    Raises
    ------
    PosesError
        Also where the process came to an end by itself: what it was at, why, and what to do.
    """
    command = python_command(_MODULE)
    if command is None:
        return estimate_poses(images, out, settings=settings, origin=origin, resume=resume, progress=progress)
    task = {
        "images": str(images),
        "out": str(out),
        "settings": as_json(settings or PoseSettings()),
        "origin": None if origin is None else str(origin),
        "resume": resume,
        "parent": os.getpid(),
        "log_level": logging.getLogger("fsinfer").getEffectiveLevel(),
    }
    step = "at its start"
    with _started(command, task) as (process, messages, noise):
        for message in messages:
            if "progress" in message:
                done, total, what = message["progress"]
                step = f"while {what} ({done} of {total})"
                progress(done, total, what)
            elif "log" in message:
                name, level, text = message["log"]
                logging.getLogger(name).log(level, "%s", text)
            elif "error" in message:
                raise error_of_json(message["error"])
            else:
                child_ended(message["peak_mb"])
                return of_json(PosesResult, message["result"])
        code = process.wait()
    raise _crash(code, step, noise, out / "work")


@contextmanager
def _started(
    command: list[str], task: dict[str, Any]
) -> Iterator[tuple[subprocess.Popen[bytes], Iterator[dict[str, Any]], deque[str]]]:
    """The process, what it tells until its end, and the last lines that its libraries print; killed at the end.

    COLMAP's database in the work folder outlives that, and the next attempt goes on with it.
    """
    process = start(command, stderr=subprocess.PIPE)
    told: queue.SimpleQueue[dict[str, Any] | None] = queue.SimpleQueue()
    noise: deque[str] = deque(maxlen=_KEPT_LINES)
    readers = (
        threading.Thread(target=_hear, args=(process.stdout, told), daemon=True),
        threading.Thread(target=_keep, args=(process.stderr, noise), daemon=True),
    )
    try:
        for reader in readers:
            reader.start()
        if process.stdin is not None:
            with suppress(OSError):  # it is gone already: its end says so
                process.stdin.write(search_path_line() + f"{json.dumps(task)}\n".encode("ascii"))
                process.stdin.flush()
        yield process, _until_end(told), noise
    finally:
        process.kill()
        process.wait()
        for reader in readers:
            reader.join(_GRACE_S)
        for stream in (process.stdin, process.stdout, process.stderr):
            if stream is not None:
                with suppress(OSError):
                    stream.close()
        if noise:
            _log.info("libraries of the process that found poses said: %s", "\n".join(noise))


def _until_end(told: queue.SimpleQueue[dict[str, Any] | None]) -> Iterator[dict[str, Any]]:
    while True:
        try:
            message = told.get(timeout=_LOOK_S)
        except queue.Empty:
            continue
        if message is None:
            return
        yield message


def _hear(stream: IO[bytes], told: queue.SimpleQueue[dict[str, Any] | None]) -> None:
    try:
        for line in stream:
            if line.endswith(b"\n"):  # else it was cut by the end of the process
                told.put(json.loads(line))
    finally:
        told.put(None)


def _keep(stream: IO[bytes], noise: deque[str]) -> None:
    for line in stream:
        noise.append(line.decode("utf-8", errors="replace").rstrip())


def _crash(code: int, step: str, noise: deque[str], work: Path) -> PosesError:
    """The error of a process that ended with ``code`` (below zero: the signal) without a result."""
    how = _end_in_words(code)
    words = next((line.strip() for line in reversed(noise) if line.strip() and not _OF_TRACE.match(line)), "")
    kept = "what is done is kept: run the same command again to go on"
    if how == "SIGKILL" or _NO_MEMORY in " ".join(noise):
        hint = f"close other programs or give fewer --jobs; {kept}"
        error = PosesError(f"finding poses was ended {step} ({how}), most likely since {NOT_ENOUGH_MEMORY}: {hint}")
    else:
        said = f", last words: {words}" if words else ""
        error = PosesError(f"{CRASHED} {step} ({how}{said}); {kept}; should it crash again, delete {work} first")
    error.__cause__ = TraceThereError("\n".join(noise))
    return error


def _end_in_words(code: int) -> str:
    if code >= 0:
        # Windows tells crashes by numbers that are known in this form.
        return f"exit code {code}" if code < 256 else f"exit code 0x{code:08X}"
    try:
        return signal.Signals(-code).name
    except ValueError:
        return f"signal {-code}"
