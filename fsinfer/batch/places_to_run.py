"""Where plots are measured: on this computer, or on the workers of a cluster."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from fsinfer.batch.attempt import PlotTask, stop_batch
from fsinfer.batch.outcome import Outcome
from fsinfer.batch.plot_run import run_plot


class PlaceToRun(Protocol):
    """Measures plots, several at a time from several threads."""

    @property
    def at_once(self) -> int:
        """How many plots it measures at a time at present, at least 1."""

    @property
    def most_at_once(self) -> int:
        """How many it may come to measure."""

    def run(self, task: PlotTask, files: Sequence[tuple[str, Path]]) -> Outcome:
        """Measure a plot, waiting for room first.

        Raises
        ------
        WorkerLostError
            Its worker is gone.
        ClusterError
            The whole cluster is.
        """

    def stop(self, batch: str) -> None:
        """End what is under way."""

    def close(self) -> None:
        """Nothing more will come."""


class ThisComputer:
    """``jobs`` plots at once, each in a process of its own."""

    def __init__(self, jobs: int) -> None:
        self.at_once = self.most_at_once = jobs

    def run(self, task: PlotTask, files: Sequence[tuple[str, Path]]) -> Outcome:
        """Measure a plot here."""
        return run_plot(task, files)

    def stop(self, batch: str) -> None:
        """End what is under way."""
        stop_batch(batch)

    def close(self) -> None:
        """Nothing is held."""
