"""Processes that one of ours starts: how, and what they do first: take their pipes, end when who started them is gone.

Only what is light is imported here: signals have to be turned off first.
"""

from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import subprocess

#: What ends a group of processes at once, by name, where the system has it.
_FOR_THE_PARENT = ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")
#: The call by which Linux tells a process that its parent has died. Source: format; prctl(2).
_PR_SET_PDEATHSIG = 1
#: What is run; the search path of the parent comes first, so that the same fsinfer is found. Read without a buffer, for
#: what follows is not text everywhere.
_START = (
    "import json, sys; sys.path[:] = json.loads(sys.stdin.buffer.raw.readline()); from {module} import main; main()"
)


def python_command(module: str) -> list[str] | None:
    """The command that runs ``main`` of a module; its standard input begins with a line, ``sys.path`` as JSON.

    None where ``sys.executable`` is a program that would start itself once more: frozen, or with Python embedded.
    """
    python = sys.executable or ""
    if not Path(python).stem.lower().startswith("python") or getattr(sys, "frozen", False):
        return None
    # Without -P a file in the current folder would be taken for a module of Python's.
    return [python, "-P", "-c", _START.format(module=module)]


def start(command: Sequence[str], *, stderr: int) -> subprocess.Popen[bytes]:
    """Start it with pipes to and from it; ``stderr`` is as for :class:`subprocess.Popen`."""
    import subprocess  # not for the process that is started, which turns off signals first

    return subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=stderr,
        # On Windows neither a window of its own nor Ctrl-C from ours.
        creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
    )


def search_path_line() -> bytes:
    """The first line that such a process is told. Python passes over what is no text in its search path."""
    entries: list[object] = list(sys.path)
    return f"{json.dumps([entry for entry in entries if isinstance(entry, str)])}\n".encode("ascii")


def leave_interrupts_to_parent() -> None:
    """Ctrl-C reaches both; the parent answers it, and ends this process."""
    for name in _FOR_THE_PARENT:
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)


def take_pipes() -> tuple[int, int]:
    """Keep both pipes for ourselves, files to read and to write: libraries read nothing and print to standard error."""
    heard, told = os.dup(sys.stdin.fileno()), os.dup(sys.stdout.fileno())
    # On Windows a library that is loaded while a thread reads standard input would wait for it.
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, sys.stdin.fileno())
    os.close(nothing)
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    return heard, told


def end_with_parent(parent: int) -> None:
    """On Linux, end at the moment when the parent does, not when the closed pipe is read."""
    if sys.platform == "linux":
        import ctypes

        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:
            os._exit(1)  # it was gone before
