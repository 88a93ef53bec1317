"""The workers of a Dask scheduler: who is there, who is gone, calls on one of them. The only module that knows Dask.

Which worker does what is decided by who asks, not by the scheduler: files may have to travel there first, or lie in its
memory from the call before. Everything else is Dask's.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable
from concurrent.futures import CancelledError
from typing import Any
from urllib.parse import urlsplit

from fsinfer._version import __version__
from fsinfer.errors import ClusterError, InputError, WorkerLostError

#: Time in which the scheduler has to answer; without any worker, or without an answer, one waits so long before giving
#: up. Seconds. Source: judgement; a worker takes some seconds to start, a switch that restarts a minute or two.
CONNECT_S, ALONE_S = 15.0, 300.0
#: A result takes no longer to come from a worker that is there, else it is asked for again, seconds. Source: judgement;
#: a few megabytes over a slow line.
FETCH_S = 30.0
#: Between two looks at who is there, seconds. Source: numerics.
LOOK_S = 1.0


class Workers:
    """Those of the scheduler at ``address``; ``name`` is that of the client, ``kept`` says what an end does not lose.

    Raises
    ------
    InputError
        Dask is not installed, or no scheduler answers.
    ClusterError
        A worker has no fsinfer, or another version.
    """

    def __init__(self, address: str, *, name: str, kept: str) -> None:
        self._address = address
        self._kept = kept
        self._client = _connect(address, name)
        #: Notified when workers come or go, or the cluster is given up.
        self.changed = threading.Condition()
        self._threads: dict[str, int] = {}
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
    def threads(self) -> dict[str, int]:
        """Threads of each worker that is there, by its address."""
        return self._threads

    def neighbours(self, worker: str) -> list[str]:
        """The workers of this one's computer, it among them."""
        host = urlsplit(worker).hostname
        return [other for other in self._threads if urlsplit(other).hostname == host]

    def check(self) -> None:
        """Raise ClusterError when the cluster is given up."""
        if self._gone:
            raise ClusterError(self._gone)

    def call(self, worker: str, function: Callable[..., Any], *arguments: object) -> Any:
        """What ``function`` returns on the worker, or raises there.

        Raises
        ------
        WorkerLostError
            It is not there any more.
        ClusterError
            The cluster is not.
        """
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
                self.check()
                if worker not in self._threads:
                    raise WorkerLostError(lost)
            if future.status == "finished":
                return self._fetch(future, worker, lost)
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

    def _fetch(self, future: Any, worker: str, lost: str) -> Any:
        """The result, which lies on the worker until it is asked for: Dask would wait for it though that is gone."""
        while True:
            try:
                return future.result(timeout=FETCH_S)
            except TimeoutError:
                self.check()
                if worker not in self._threads:
                    raise WorkerLostError(lost) from None
            except CancelledError as error:
                raise WorkerLostError(lost) from error

    def everywhere(self, function: Callable[..., Any], *arguments: object) -> None:
        """Call a quick function on all workers; those that cannot be reached end what they do by themselves."""

        def run() -> None:
            with contextlib.suppress(Exception):
                self._client.run(function, *arguments, on_error="ignore")

        # Dask would wait for a worker that is asleep.
        thread = threading.Thread(target=run, daemon=True)
        thread.start()
        thread.join(CONNECT_S)

    def give_up(self, why: str) -> None:
        """Let whoever waits for a worker, or for what it returns, stop waiting."""
        with self.changed:
            self._gone = f"{why}; start it again and give the same command: {self._kept}"
            self.changed.notify_all()

    def close(self) -> None:
        """Leave the cluster as it is."""
        self._closed.set()
        self._client.close()

    def _give_up_if_closed(self, error: Exception) -> None:
        """Raise ClusterError where Dask has given the scheduler up, which it does for good."""
        if self._client.status not in ("closing", "closed"):
            return
        if not self._gone:
            self.give_up(f"the scheduler {self._address} does not answer any more ({type(error).__name__})")
        raise ClusterError(self._gone) from error

    def _keep_looking(self) -> None:
        while not self._closed.wait(LOOK_S):
            try:
                self._look()
            except Exception as error:
                if not self._closed.is_set() and time.monotonic() - self._seen > ALONE_S:
                    self.give_up(f"the scheduler {self._address} does not answer any more ({type(error).__name__})")
                    return
                continue
            if self._threads:
                self._seen = time.monotonic()
            elif time.monotonic() - self._seen > ALONE_S:
                self.give_up(f"the scheduler {self._address} has had no worker for {ALONE_S:.0f} s")
                return

    def _look(self) -> None:
        found = dict(self._client.nthreads())
        with self.changed:
            self._threads = found
            self.changed.notify_all()

    def _check_versions(self) -> None:
        """Refuse workers without fsinfer, or with another version, before anything is sent."""
        try:
            versions: dict[str, str] = self._client.run(_version)
        except Exception as error:
            msg = f"a worker of {self._address} cannot load fsinfer ({error}); install it there: pip install fsinfer"
            raise ClusterError(msg) from error
        others = sorted(f"{worker} has {version}" for worker, version in versions.items() if version != __version__)
        if others:
            msg = f"fsinfer is {__version__} here, but {', '.join(others)}; install the same version everywhere"
            raise ClusterError(msg)


def scratch_of_worker() -> str:
    """On a worker: its own folder, which goes away with it."""
    from distributed import get_worker

    return str(get_worker().local_directory)


def memory_limit_bytes() -> int | None:
    """On a worker: the memory that it may hold; None where it was given no limit."""
    from distributed import get_worker

    return get_worker().memory_manager.memory_limit or None


def _connect(address: str, name: str) -> Any:
    try:
        from distributed import Client
    except ImportError as error:
        msg = "--scheduler needs Dask, which is not installed here: pip install 'fsinfer[cluster]'"
        raise InputError(msg) from error
    try:
        connect: Any = Client
        return connect(address, timeout=CONNECT_S, set_as_default=False, name=name)
    except (OSError, TimeoutError, ValueError) as error:
        msg = f"no Dask scheduler answers at {address} ({error}); start one with: dask scheduler"
        raise InputError(msg) from error


def _version() -> str:
    return __version__
