"""A Dask cluster as a place to run plots; the only module that knows Dask.

A thread of a worker is room for one plot. Which worker has a plot is decided here, not by the scheduler, because the
photographs may have to travel there first; everything else (who is there, who is gone, calls and results) is Dask's.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from fsinfer._version import __version__
from fsinfer.batch.attempt import PlotTask, stop_batch
from fsinfer.batch.copying import attempt_there
from fsinfer.batch.outcome import Outcome
from fsinfer.batch.places_to_run import ClusterError, WorkerLostError
from fsinfer.batch.plot_run import measured, run_plot
from fsinfer.errors import InputError

#: Time in which the scheduler has to answer; without any worker, or without an answer, a batch waits so long before it
#: gives up. Seconds. Source: judgement; a worker takes some seconds to start, a switch that restarts a minute or two.
CONNECT_S, ALONE_S = 15.0, 300.0
#: Between two looks at who is there, seconds. Source: numerics.
LOOK_S = 1.0
#: Plots that are in the hands of threads here, most of which wait for a worker. Source: numerics.
MOST_AT_ONCE = 256


class Cluster:
    """Plots on the workers of the scheduler at ``address``; with ``copy`` the photographs are sent to them."""

    def __init__(self, address: str, *, copy: bool = False) -> None:
        self._address = address
        self._copy = copy
        self._client = _connect(address)
        self._changed = threading.Condition()
        self._threads: dict[str, int] = {}
        self._lent: Counter[str] = Counter()
        self._gone = ""
        self._closed = threading.Event()
        self._seen = time.monotonic()
        try:
            self._look()
            self._check_versions()
        except BaseException:
            self._client.close()
            raise
        threading.Thread(target=self._keep_looking, daemon=True).start()

    @property
    def at_once(self) -> int:
        """Threads of all workers, at least 1."""
        return max(1, sum(self._threads.values()))

    @property
    def most_at_once(self) -> int:
        """Workers may still come."""
        return MOST_AT_ONCE

    def run(self, task: PlotTask, files: Sequence[tuple[str, Path]]) -> Outcome:
        """Measure a plot on the next worker that has room."""
        worker = self._lend()
        try:
            task = replace(task, beside=self._beside(worker))

            def call(function: Callable[..., Any], *arguments: object) -> Any:
                return self._call(worker, function, *arguments)

            if not self._copy:
                return call(run_plot, task, tuple(files))  # type: ignore[no-any-return]
            return measured(task, files, lambda: attempt_there(call, task, files, call(_scratch_of_worker)))
        finally:
            with self._changed:
                self._lent[worker] -= 1
                self._changed.notify_all()

    def stop(self, batch: str) -> None:
        """End what is under way on all workers."""
        self._fail("the batch was stopped")
        # Where the cluster is gone its workers end their plots by themselves.
        with contextlib.suppress(Exception):
            self._client.run(stop_batch, batch, on_error="ignore")

    def close(self) -> None:
        """Leave the cluster as it is."""
        self._closed.set()
        self._client.close()

    def _call(self, worker: str, function: Callable[..., Any], *arguments: object) -> Any:
        """What ``function`` returns on the worker; WorkerLostError when it is not there any more."""
        # A key of its own for each call: the same call may be made twice, and has to be done twice.
        try:
            future = self._client.submit(
                function, *arguments, workers=[worker], allow_other_workers=False, pure=False, retries=0
            )
        except Exception as refused:
            self._give_up_if_closed(refused)
            raise
        lost = f"its worker {worker} was lost"
        done = threading.Event()
        future.add_done_callback(lambda _: done.set())
        try:
            while not done.wait(LOOK_S):
                if self._gone:
                    raise ClusterError(self._gone)
                if worker not in self._threads:
                    raise WorkerLostError(lost)
            if future.status == "finished":
                return future.result()
            if future.status != "error":
                raise WorkerLostError(lost)
            error = future.exception()
            if type(error).__module__.partition(".")[0] in ("distributed", "dask"):
                # Words of Dask: the worker died with the call, or it could not be brought back.
                msg = f"{lost} ({type(error).__name__})"
                raise WorkerLostError(msg) from error
            raise error
        finally:
            with contextlib.suppress(Exception):  # nobody is there to be told
                future.cancel()

    def _give_up_if_closed(self, error: Exception) -> None:
        """Raise ClusterError where Dask has given the scheduler up, which it does for good."""
        if self._client.status not in ("closing", "closed"):
            return
        if not self._gone:
            self._fail(f"the scheduler {self._address} does not answer any more ({type(error).__name__})")
        raise ClusterError(self._gone) from error

    def _lend(self) -> str:
        """A worker that has room, waited for."""
        with self._changed:
            while True:
                if self._gone:
                    raise ClusterError(self._gone)
                free = {worker: count - self._lent[worker] for worker, count in self._threads.items()}
                worker = max(free, key=free.__getitem__, default="")
                if worker and free[worker] > 0:
                    self._lent[worker] += 1
                    return worker
                self._changed.wait(LOOK_S)

    def _beside(self, worker: str) -> int:
        """How many plots the worker's computer may be measuring at once."""
        host = urlsplit(worker).hostname
        return max(1, sum(count for other, count in self._threads.items() if urlsplit(other).hostname == host))

    def _keep_looking(self) -> None:
        while not self._closed.wait(LOOK_S):
            try:
                self._look()
            except Exception as error:
                if not self._closed.is_set() and time.monotonic() - self._seen > ALONE_S:
                    self._fail(f"the scheduler {self._address} does not answer any more ({type(error).__name__})")
                    return
                continue
            if self._threads:
                self._seen = time.monotonic()
            elif time.monotonic() - self._seen > ALONE_S:
                self._fail(f"the scheduler {self._address} has had no worker for {ALONE_S:.0f} s")
                return

    def _look(self) -> None:
        found = dict(self._client.nthreads())
        with self._changed:
            self._threads = found
            self._changed.notify_all()

    def _fail(self, why: str) -> None:
        with self._changed:
            self._gone = f"{why}; start it again and give the same command: finished plots are kept"
            self._changed.notify_all()

    def _check_versions(self) -> None:
        """Refuse workers without fsinfer, or with another version, before any plot is sent."""
        try:
            versions: dict[str, str] = self._client.run(_version)
        except Exception as error:
            msg = f"a worker of {self._address} cannot load fsinfer ({error}); install it there: pip install fsinfer"
            raise ClusterError(msg) from error
        others = sorted(f"{worker} has {version}" for worker, version in versions.items() if version != __version__)
        if others:
            msg = f"fsinfer is {__version__} here, but {', '.join(others)}; install the same version everywhere"
            raise ClusterError(msg)


def _connect(address: str) -> Any:
    try:
        from distributed import Client
    except ImportError as error:
        msg = "--scheduler needs Dask, which is not installed here: pip install 'fsinfer[cluster]'"
        raise InputError(msg) from error
    try:
        connect: Any = Client
        return connect(address, timeout=CONNECT_S, set_as_default=False, name="fsinfer-batch")
    except (OSError, TimeoutError, ValueError) as error:
        msg = f"no Dask scheduler answers at {address} ({error}); start one with: dask scheduler"
        raise InputError(msg) from error


def _version() -> str:
    return __version__


def _scratch_of_worker() -> str:
    """The worker's own folder, which goes away with it."""
    from distributed import get_worker

    return str(get_worker().local_directory)
