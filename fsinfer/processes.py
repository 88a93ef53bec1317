"""Work shared out over processes, for what Python's lock keeps threads from doing side by side.

Much of what is done to each stem or photograph is short rows of numbers, where threads mostly wait for each other.
:func:`shared_out` gives such work to the processes of the :func:`worker_processes` that is being entered, and to
threads where there are none. Processes are started as :mod:`fsinfer.workflow.poses_apart` starts one, not by Python's
own pools: those would run a user's script once more in each where it does not guard its main part.
"""

from __future__ import annotations

import ctypes
import logging
import os
import pickle
import queue
import subprocess
import sys
import threading
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from functools import partial
from pathlib import Path
from typing import IO, Any, Literal, TypeVar

from fsinfer.child_process import python_command, search_path_line, start
from fsinfer.process_worker import Answer, receive, send
from fsinfer.threads import cores, in_order, photo_threads

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

#: Worker processes at most, where nobody says how many. Source: judgement; one holds 150 to 250 MB.
MOST_WORKERS = 4
#: A thread whose result nobody takes looks as often whether it is wanted any more, seconds. Source: judgement.
_LOOK_S = 0.2
#: What is run.
_MODULE = "fsinfer.process_worker"

_log = logging.getLogger(__name__)


@contextmanager
def worker_processes(modules: Sequence[str], *, count: int | None = None, beside: bool = False) -> Iterator[None]:
    """Within it, :func:`shared_out` gives work to ``count`` processes, as many as there are cores without it.

    They are started at once and load ``modules`` while other things are done. One process is as good as none: the work
    is then done here, unless it is for work ``beside`` what this one does. Within another it starts none, and the work
    goes to those that are there.
    The peak of their memory stays known, see :func:`ended_peak_mb`.
    """
    if _active.get() is not None:
        yield
        return
    count = min(cores(), MOST_WORKERS) if count is None else count
    command = python_command(_MODULE) if count > (0 if beside else 1) else None
    if command is None:
        yield
        return
    workers = Workers(command, count, modules)
    token = _active.set(workers)
    try:
        yield
    finally:
        child_ended(workers.peak_mb())
        workers.end()
        _active.reset(token)


def shared_out(
    work: Callable[[_Item], _Result], items: Iterable[_Item], *, threads: int | None = None
) -> Generator[_Result, None, None]:
    """The results of ``work`` on each item, in the items' order, by worker processes, or by threads without them.

    For processes ``work``, items and results must be of a kind that can be pickled; what ``work`` holds (as
    ``functools.partial`` does) is sent once to each. An error comes where its result would. Without processes there
    are so many ``threads``, by default those for photos; with one each item is worked on when its result is taken.
    """
    workers = _active.get()
    if workers is None:
        yield from in_order(work, items, photo_threads() if threads is None else threads)
    else:
        yield from workers.in_order(work, items)


def can_start() -> bool:
    """Whether other processes of ours can be started: not by a frozen program, nor by one that embeds Python."""
    return python_command(_MODULE) is not None


def as_ready(work: Callable[[_Item], _Result], take: Callable[[int], _Item | None]) -> Generator[_Result, None, None]:
    """The results of ``work`` as they get ready, on what each worker process takes by its number until that is None.

    For work that goes quicker on what lies beside the item before: a process keeps to its own. As for the rest see
    :func:`shared_out`. Without processes this one takes all, as number 0, each when its result is asked for.
    """
    workers = _active.get()
    if workers is None:
        while (item := take(0)) is not None:
            yield work(item)
    else:
        yield from workers.as_ready(work, take)


def peak_of_mb(process: int | Literal["self"]) -> float | None:
    """The largest resident memory of a process so far, MiB; None where the system does not tell (it does on Linux)."""
    return _status_mb(process, "VmHWM:")


def _status_mb(process: int | Literal["self"], key: str) -> float | None:
    with suppress(OSError):
        status = (Path("/proc") / str(process) / "status").read_text(encoding="ascii", errors="replace")
        for line in status.splitlines():
            if line.startswith(key):
                return int(line.split()[1]) / 1024
    return None


def hand_back() -> None:
    """Give back to the system what the allocator keeps of earlier work's memory, where it can (GNU's C library).

    It keeps some hundred MiB in pieces, which would lie beside all that comes afterwards.
    """
    if sys.platform != "linux":
        return
    with suppress(OSError, AttributeError):  # another C library
        ctypes.CDLL(None).malloc_trim(0)


def child_ended(peak_mb: float | None) -> None:
    """A process that worked for this one has ended; ``peak_mb`` is the peak of its memory, MiB, where that is known."""
    global _ended_peak_mb
    # This one has waited for it meanwhile.
    _ended_peak_mb = max(_ended_peak_mb, (peak_mb or 0.0) + (_status_mb("self", "VmRSS:") or 0.0))


def ended_peak_mb() -> float:
    """The largest memory, MiB, of this process and one that has ended, or several, since :func:`forget_ended`."""
    return _ended_peak_mb


def forget_ended() -> None:
    """What has ended by now counts no more."""
    global _ended_peak_mb
    _ended_peak_mb = 0.0


def has_workers() -> bool:
    """Whether processes work for this one: :func:`shared_out` gives its work to them."""
    return _active.get() is not None


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

    def in_order(self, work: Callable[[_Item], _Result], items: Iterable[_Item]) -> Generator[_Result, None, None]:
        """See :func:`shared_out`."""
        # One more is begun than there are processes, so that fewer wait for a slow one before them.
        yield from in_order(partial(self._ask, work), items, self._count, ahead=1, on_interrupt=self.end)

    def as_ready(
        self, work: Callable[[_Item], _Result], take: Callable[[int], _Item | None]
    ) -> Generator[_Result, None, None]:
        """See :func:`as_ready`."""
        ready: queue.Queue[tuple[_Result] | BaseException | None] = queue.Queue(self._count)
        over = threading.Event()

        def tell(what: tuple[_Result] | BaseException | None) -> None:
            while not over.is_set():
                try:
                    ready.put(what, timeout=_LOOK_S)
                except queue.Full:
                    continue
                return

        def serve(number: int) -> None:
            worker = self._idle.get()
            try:
                while not over.is_set() and (item := take(number)) is not None:
                    worker, answer = self._answer(worker, work, item)
                    tell((_result_of(answer, work, item),))
            except BaseException as error:  # whatever it is, who asked gets it
                tell(error)
            finally:
                self._idle.put(worker)
                tell(None)

        with ThreadPoolExecutor(self._count) as pool:
            try:
                for number in range(self._count):
                    pool.submit(serve, number)
                left = self._count
                while left:
                    told = ready.get()
                    if isinstance(told, BaseException):
                        raise told
                    if told is None:
                        left -= 1
                    else:
                        yield told[0]
            except KeyboardInterrupt:
                self.end()
                raise
            finally:
                over.set()

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
            worker, answer = self._answer(worker, work, item)
        finally:
            self._idle.put(worker)
        return _result_of(answer, work, item)

    def _answer(
        self, worker: _Worker | None, work: Callable[[Any], Any], item: Any
    ) -> tuple[_Worker | None, Answer | None]:
        """The process if it is still there, and what it says of an item."""
        if worker is None:
            return None, None
        try:
            return worker, worker.ask(work, item)
        except _GoneError as error:
            if self._ended:
                raise
            # The system may have ended it for want of memory. Its share is done in this process from here on.
            _log.warning("a worker process has ended (%s); its share is done by the run itself", error)
            return None, None


def _result_of(answer: Answer | None, work: Callable[[_Item], _Result], item: _Item) -> _Result:
    """What a process found, or what is found here where none said anything."""
    if answer is None:
        return work(item)
    if answer.error is not None:
        raise answer.error
    result: _Result = answer.result
    return result


_active: ContextVar[Workers | None] = ContextVar("workers", default=None)
# One for the whole process, as the system's mark of its own memory is.
_ended_peak_mb = 0.0


class _GoneError(Exception):
    """The process has ended, or cannot do its work; nobody sees this error who has not ended it himself."""


class _Worker:
    """One process; one thread at a time asks it."""

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        self._process = process
        self._work: object = None

    @classmethod
    def started(cls, command: Sequence[str], modules: Sequence[str]) -> _Worker | None:
        """A new process that loads ``modules``; None where the system allows no more."""
        try:
            process = start(command, stderr=subprocess.DEVNULL)
        except OSError as error:
            _log.info("no worker process could be started: %s", error)
            return None
        worker = cls(process)
        with suppress(_GoneError):  # found out when it is asked
            worker._write(search_path_line())
            worker._send(os.getpid())
            worker._send(("import", tuple(modules)))
        return worker

    def ask(self, work: Callable[[Any], Any], item: Any) -> Answer:
        """What comes of an item."""
        if work is not self._work:
            self._send(("work", work))
            self._work = work
        self._send(("item", item))
        try:
            answer: Answer = pickle.loads(receive(self._told()))
        except Exception as error:  # half an answer may be left in the pipe
            self.end()
            raise _GoneError(repr(error)) from error
        if answer.unfit:
            self.end()
            raise _GoneError(answer.unfit)
        return answer

    def _told(self) -> IO[bytes]:
        if self._process.stdout is None:
            raise EOFError
        return self._process.stdout

    def peak_mb(self) -> float:
        return peak_of_mb(self._process.pid) or 0.0

    def end(self) -> None:
        self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                with suppress(OSError):
                    stream.close()

    def _send(self, message: Any) -> None:
        pickled = pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL)
        try:
            send(self._heard(), pickled)
        except (OSError, ValueError) as error:  # its end of the pipe is closed, or ours
            raise _GoneError(repr(error)) from error

    def _write(self, line: bytes) -> None:
        with suppress(OSError):  # found out when it is asked
            self._heard().write(line)

    def _heard(self) -> IO[bytes]:
        if self._process.stdin is None:
            raise ValueError
        return self._process.stdin
