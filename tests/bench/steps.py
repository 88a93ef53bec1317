"""Seconds of each step of a run, and how right the remaining time was that the command line would have told."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from fsinfer.cli.remaining import STEPS, RemainingTime, Step, step_of
from fsinfer.progress import Progress


def figure_of(step: Step) -> str:
    """Name of the figure with the seconds of a step: ``step_STAGE_WHAT_s``."""
    return "_".join(["step", step.stage, *step.what.split(), "s"])


class StepClock:
    """Progress of all stages (:data:`fsinfer.progress.StageProgress`) of one run, which it times.

    ``clock``: seconds, rising.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._remaining = RemainingTime(clock=clock)
        self._begun = clock()
        self._step, self._since = "", self._begun
        self._seconds: dict[str, float] = {}
        self._told: list[tuple[float, float]] = []

    def __call__(self, stage: str) -> Progress:
        """The progress of a stage."""

        def report(done: int, total: int, what: str) -> None:
            self._remaining.update(stage, done, total, what)
            left = self._remaining.seconds()
            now = self._clock()
            if left is not None:
                self._told.append((now - self._begun, left))
            step = step_of(stage, what)
            if step is not None:
                self._enter(figure_of(STEPS[step]), now)

        return report

    def _enter(self, step: str, now: float) -> None:
        if step == self._step:
            return
        if self._step:
            self._seconds[self._step] = self._seconds.get(self._step, 0.0) + now - self._since
        self._step, self._since = step, now

    def figures(self) -> dict[str, float]:
        """To be asked when the run is done.

        Of each step its seconds (:func:`figure_of`); of the remaining time, told between the first tenth of the run and
        the last, the median and the greatest error (``remaining_median_percent``, ``remaining_worst_percent``).
        """
        now = self._clock()
        self._enter("end", now)
        whole = now - self._begun
        found = dict(self._seconds)
        errors = [
            100 * abs(left / (whole - passed) - 1)
            for passed, left in self._told
            if 0.1 * whole <= passed <= 0.9 * whole
        ]
        if errors:
            found["remaining_median_percent"] = float(np.median(errors))
            found["remaining_worst_percent"] = max(errors)
        return found
