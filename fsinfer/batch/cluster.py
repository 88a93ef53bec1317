"""A Dask cluster as a place to run plots. A thread of a worker is room for one plot."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from fsinfer.batch.attempt import Attempt, PlotTask, stop_batch
from fsinfer.batch.copying import attempt_there
from fsinfer.batch.outcome import Outcome
from fsinfer.batch.plot_run import measured, run_plot
from fsinfer.cluster.pieces import remove_scratch
from fsinfer.cluster.workers import LOOK_S, Workers, scratch_of_worker

#: Plots that are in the hands of threads here, most of which wait for a worker. Source: numerics.
MOST_AT_ONCE = 256


class Cluster:
    """Plots on the workers of the scheduler at ``address``; with ``copy`` the photographs are sent to them."""

    def __init__(self, address: str, *, copy: bool = False) -> None:
        self._copy = copy
        self._workers = Workers(address, name="fsinfer-batch", kept="finished plots are kept")
        self._lent: Counter[str] = Counter()
        self._left: list[str] = []

    @property
    def at_once(self) -> int:
        """Threads of all workers, at least 1."""
        return max(1, sum(self._workers.threads.values()))

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
                return self._workers.call(worker, function, *arguments)

            if not self._copy:
                return call(run_plot, task, tuple(files))  # type: ignore[no-any-return]

            def try_it() -> Attempt:
                return attempt_there(call, task, files, call(scratch_of_worker), self._left.append)

            return measured(task, files, try_it)
        finally:
            with self._workers.changed:
                self._lent[worker] -= 1
                self._workers.changed.notify_all()

    def stop(self, batch: str) -> None:
        """End what is under way on all workers."""
        self._workers.give_up("the batch was stopped")
        self._workers.everywhere(stop_batch, batch)

    def close(self) -> None:
        """Leave the cluster as it is, without what plots that were stopped have left on workers."""
        if self._left:
            # Not through the threads of workers, which may still be busy with plots that are ending.
            self._workers.everywhere(remove_scratch, *self._left)
        self._workers.close()

    def _lend(self) -> str:
        """A worker that has room, waited for."""
        with self._workers.changed:
            while True:
                self._workers.check()
                free = {worker: count - self._lent[worker] for worker, count in self._workers.threads.items()}
                worker = max(free, key=free.__getitem__, default="")
                if worker and free[worker] > 0:
                    self._lent[worker] += 1
                    return worker
                self._workers.changed.wait(LOOK_S)

    def _beside(self, worker: str) -> int:
        """How many plots the worker's computer may be measuring at once."""
        threads = self._workers.threads
        return max(1, sum(threads.get(other, 0) for other in self._workers.neighbours(worker)))
