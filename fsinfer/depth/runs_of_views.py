"""Which worker computes which view next: each a run of neighbours, so that their feature maps are at hand."""

from __future__ import annotations

import threading
from itertools import pairwise


class RunsOfViews:
    """Views 0 to ``count`` - 1, given out once each unless they come back; may be used from several threads.

    A worker goes on along its run. Where that ends it takes a run that nobody has, else the second half of the longest
    one: whoever is quick gets more, and few neighbours are parted.
    """

    def __init__(self, count: int, *, workers: int) -> None:
        self._lock = threading.Lock()
        self._owned: dict[str, range] = {}
        workers = max(1, min(workers, count))
        cuts = [count * part // workers for part in range(workers + 1)]
        self._free = [range(start, stop) for start, stop in pairwise(cuts) if stop > start]

    @property
    def left(self) -> int:
        """Views that no worker has been given."""
        with self._lock:
            return sum(map(len, (*self._free, *self._owned.values())))

    def take(self, worker: str) -> int | None:
        """The next view of a worker; None where there is none left to give."""
        with self._lock:
            run = self._owned.pop(worker, range(0)) or self._next_run()
            if not run:
                return None
            self._owned[worker] = run[1:]
            return run[0]

    def give_back(self, worker: str, view: int) -> None:
        """The worker is gone, or did not manage: this view, and its run, go to whoever asks next."""
        with self._lock:
            run = self._owned.pop(worker, range(0))
            # In one piece where they are neighbours still, for another worker may have taken the rest of the run.
            self._free += [range(view, run.stop)] if run and run.start == view + 1 else [range(view, view + 1), run]
            self._free = [free for free in self._free if free]

    def _next_run(self) -> range:
        if self._free:
            run = max(self._free, key=len)
            self._free.remove(run)
            return run
        owner = max(self._owned, key=lambda name: len(self._owned[name]), default=None)
        if owner is None:
            return range(0)
        run = self._owned[owner]
        middle = len(run) // 2
        self._owned[owner] = run[:middle]
        return run[middle:]
