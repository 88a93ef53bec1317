"""Threads: those of NumPy's and SciPy's linear algebra, one whatever the environment says; our own; and the cores.

The heavy work of fsinfer shares itself out over the cores (blocks of a cost volume, onnxruntime, COLMAP). The products
in it are small, and a library for linear algebra that starts threads of its own for each of them fights for the same
cores. In one thread its sums are the same on every machine with the same instructions, too.
"""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from contextvars import copy_context
from pathlib import Path
from typing import TypeVar

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

#: Photos or depth maps worked on at a time at most. Source: numerics; a photo of 2400 pixels takes 60 MB while it is
#: straightened, one of 12 megapixels (with a larger --max-size) 170 MB.
MOST_AT_ONCE = 4

_lock = threading.Lock()
_inside = 0
_limits = ExitStack()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Within it, and in functions that it decorates, BLAS works in one thread; afterwards as before.

    May be nested and entered from several threads at a time: the libraries' setting is one for the whole process, so
    the first to enter sets it, and the last to leave puts it back.
    """
    global _inside
    with _lock:
        if _inside == 0:
            _limit()
        _inside += 1
    try:
        yield
    finally:
        with _lock:
            _inside -= 1
            if _inside == 0:
                _unlimit()


def cores() -> int:
    """Processor cores that this process may use."""
    allowed = getattr(os, "sched_getaffinity", None)  # Linux alone knows
    return len(allowed(0)) if allowed is not None else os.cpu_count() or 1


def photo_threads() -> int:
    """Threads for what is done to photos or depth maps one by one."""
    return min(cores(), MOST_AT_ONCE)


def in_order(
    work: Callable[[_Item], _Result],
    items: Iterable[_Item],
    threads: int,
    *,
    ahead: int = 0,
    on_interrupt: Callable[[], None] = lambda: None,
) -> Generator[_Result, None, None]:
    """The results of ``work`` on each item, in the items' order, worked out by so many threads at a time.

    At most so many items and ``ahead`` more are worked on ahead of what is taken, so that as many photos are held at
    once. An error comes where its result would, and what was not begun by then is not begun any more. At Ctrl-C
    ``on_interrupt`` is called before what was begun is waited for.
    """
    if threads <= 1:
        yield from map(work, items)
        return
    waiting: deque[Future[_Result]] = deque()
    with ThreadPoolExecutor(threads) as pool:
        try:
            for item in items:
                waiting.append(pool.submit(work, item))
                if len(waiting) > threads + ahead:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        except KeyboardInterrupt:
            on_interrupt()
            raise
        finally:
            for future in waiting:
                future.cancel()


@contextmanager
def beside(work: Callable[[Callable[[], None]], _Result]) -> Iterator[Callable[[], _Result]]:
    """Within it ``work`` goes on in a thread of its own; what is given waits for its result, or raises its error.

    ``work`` is given a function to be called now and then, which ends it where the result is wanted no more.
    """
    over = threading.Event()

    def go_on() -> None:
        if over.is_set():
            raise _OverError

    with ThreadPoolExecutor(1) as pool:
        # The processes that work for this one are those of the thread that asks, too.
        future = pool.submit(copy_context().run, work, go_on)
        try:
            yield future.result
        finally:
            over.set()


class _OverError(Exception):
    """Nobody waits for the result."""


def blas_architecture() -> str:
    """What OpenBLAS calls the processor that NumPy's products are computed for; empty where it is another library."""
    from threadpoolctl import threadpool_info

    found = [library for library in threadpool_info() if library.get("internal_api") == "openblas"]
    # SciPy and OpenCV bring libraries of their own, which may be older and know less of processors.
    of_numpy = [library for library in found if _of_numpy(Path(library["filepath"]))] or found
    named = {str(library.get("architecture") or "") for library in of_numpy}
    return named.pop() if len(named) == 1 else ""


def _of_numpy(library: Path) -> bool:
    """Whether a wheel of NumPy brought it: in ``numpy.libs`` or ``numpy/.dylibs``."""
    return any(part.startswith("numpy") for part in library.parts[-3:-1])


def _limit() -> None:
    # SciPy brings a library of its own, which is found only once it is loaded.
    import scipy.linalg  # noqa: F401
    from threadpoolctl import threadpool_limits

    _limits.enter_context(threadpool_limits(limits=1, user_api="blas"))


def _unlimit() -> None:
    from threadpoolctl import OpenBLASController

    # From 3.8 on only the thread that has set a limit may change it, unless it is told that that one is done.
    release = getattr(OpenBLASController, "clear_controlling_thread", None)
    if release is not None:
        release(force=True)
    _limits.close()
