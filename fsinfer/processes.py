"""Work shared out over processes, for what Python's lock keeps threads from doing side by side.

Much of what is done to each stem or photograph is short rows of numbers, where threads mostly wait for each other.
:func:`shared_out` gives such work to the processes of the :func:`worker_processes` that is being entered, and to
threads where there are none. Processes are started as :mod:`fsinfer.workflow.poses_apart` starts one, not by Python's
own pools: those would run a user's script once more in each where it does not guard its main part.
"""

from __future__ import annotations

import json
import logging
import os
import pickle
import queue
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from fsinfer.child_process import python_command
from fsinfer.threads import cores, in_order, photo_threads

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

#: Worker processes at most. Source: judgement; one holds 150 to 250 MB.
MOST_WORKERS = 4
#: What is run.
_MODULE = "fsinfer.process_worker"

_log = logging.getLogger(__name__)


@contextmanager
def worker_processes(modules: Sequence[str], *, count: int | None = None) -> Iterator[None]:
    """Within it, :func:`shared_out` gives work to ``count`` processes, as many as there are cores without it.

    They are started at once and load ``modules`` while other things are done. One process is as good as none: the work
    is then done here. Within another it starts none, and the work goes to those that are there.
    """
    if _active.get() is not None:
        yield
        return
    count = min(cores(), MOST_WORKERS) if count is None else count
    command = python_command(_MODULE) if count > 1 else None
    if command is None:
        yield
        return
    workers = Workers(command, count, modules)
    token = _active.set(workers)
    try:
        yield
    finally:
        _active.reset(token)
        workers.end()


def shared_out(work: Callable[[_Item], _Result], items: Iterable[_Item]) -> Iterator[_Result]:
    """The results of ``work`` on each item, in the items' order, by worker processes, or by threads without them.

    For processes ``work``, items and results must be of a kind that can be pickled; what ``work`` holds (as
    ``functools.partial`` does) is sent once to each. An error comes where its result would.
    """
    workers = _active.get()
    if workers is None:
        yield from in_order(work, items, photo_threads())
    else:
        yield from workers.in_order(work, items)


def workers_peak_mb() -> float:
    """The largest resident memory so far of all processes that work for this one, MiB; 0 where nobody tells (Linux)."""
    workers = _active.get()
    return 0.0 if workers is None else workers.peak_mb()


class Workers:
    """Processes that wait for work. Use :func:`worker_processes`."""

    def __init__(self, command: Sequence[str], count: int, modules: Sequence[str]) -> None:
        self._count, self._ended = count, False
        self._idle: queue.SimpleQueue[_Worker | None] = queue.SimpleQueue()
        self._all: list[_Worker] = []
        for _ in range(count):
            worker = _Worker.started(command, modules)
            if worker is not None:
                self._all.append(worker)
            self._idle.put(worker)

    def in_order(self, work: Callable[[_Item], _Result], items: Iterable[_Item]) -> Iterator[_Result]:
        """See :func:`shared_out`."""
        # One item is on its way to each while it works, so that nobody waits for the pipe.
        yield from in_order(partial(self._ask, work), items, self._count, ahead=1, on_interrupt=self.end)

    def peak_mb(self) -> float:
        """See :func:`workers_peak_mb`."""
        return sum(worker.peak_mb() for worker in self._all)

    def end(self) -> None:
        """End the processes, also in the middle of their work."""
        self._ended = True
        for worker in self._all:
            worker.end()

    def _ask(self, work: Callable[[_Item], _Result], item: _Item) -> _Result:
        worker = self._idle.get()
        try:
            if worker is not None:
                try:
                    right, found = worker.ask(work, item)
                except _GoneError:
                    if self._ended:
                        raise
                    # The system may have ended it for want of memory; what it had to do is done here.
                    _log.info("a worker process has ended; its work is done by the others")
                    worker = None
                else:
                    if not right:
                        raise found
                    result: _Result = found
                    return result
        finally:
            self._idle.put(worker)
        return work(item)


_active: ContextVar[Workers | None] = ContextVar("workers", default=None)


class _GoneError(Exception):
    """The process has ended; nobody sees this error who has not ended it himself."""


class _Worker:
    """One process; one thread at a time asks it."""

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        self._process = process
        self._work: object = None

    @classmethod
    def started(cls, command: Sequence[str], modules: Sequence[str]) -> _Worker | None:
        """A new process that loads ``modules``; None where the system allows no more."""
        try:
            process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                # On Windows neither a window of its own nor Ctrl-C from ours.
                creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
            )
        except OSError as error:
            _log.info("no worker process could be started: %s", error)
            return None
        worker = cls(process)
        with suppress(_GoneError):  # found out when it is asked
            worker._write(f"{json.dumps(sys.path)}\n".encode("ascii"))
            worker._send(os.getpid())
            worker._send(("import", tuple(modules)))
        return worker

    def ask(self, work: Callable[[Any], Any], item: Any) -> tuple[bool, Any]:
        """Whether it went well, and the result or the error."""
        if work is not self._work:
            self._send(("work", work))
            self._work = work
        self._send(("item", item))
        if self._process.stdout is None:
            raise _GoneError
        try:
            right, found = pickle.load(self._process.stdout)
        except (EOFError, OSError, pickle.UnpicklingError) as error:
            raise _GoneError from error
        return bool(right), found

    def peak_mb(self) -> float:
        status = Path("/proc") / str(self._process.pid) / "status"
        with suppress(OSError):
            for line in status.read_text(encoding="ascii", errors="replace").splitlines():
                if line.startswith("VmHWM:"):
                    return int(line.split()[1]) / 1024
        return 0.0

    def end(self) -> None:
        self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                with suppress(OSError):
                    stream.close()

    def _send(self, message: Any) -> None:
        self._write(pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL))

    def _write(self, told: bytes) -> None:
        if self._process.stdin is None:
            raise _GoneError
        try:
            self._process.stdin.write(told)
            self._process.stdin.flush()
        except OSError as error:
            raise _GoneError from error
