"""A plot from its row to its outcome, where photographs and output folder are within reach."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from fsinfer.batch.attempt import Attempt, PlotTask, attempt
from fsinfer.batch.outcome import (
    Outcome,
    State,
    inputs_digest,
    photo_files,
    read_outcome,
    result_digests,
    write_outcome,
)
from fsinfer.batch.place import place_of_photos

Files = Sequence[tuple[str, Path]]


def run_plot(task: PlotTask, files: Files) -> Outcome:
    """Measure a plot here, unless that was done before; ``files`` are those that options name."""
    return measured(task, files, lambda: attempt(with_files(task, files)))


def measured(task: PlotTask, files: Files, try_it: Callable[[], Attempt]) -> Outcome:
    """The outcome of ``try_it``, or the one kept from earlier where nothing has changed since; kept in any case."""
    inputs = inputs_digest(task.photos, task.out, (*task.options, *(flag for flag, _ in files)), [p for _, p in files])
    before = read_outcome(task.out)
    if before is not None and before.state is State.done and before.inputs == inputs:
        results = result_digests(task.out)
        if results and results == before.results:
            return replace(before, ran=False)
    tried = try_it()
    # What an earlier attempt has finished is not done again, so its time belongs to the plot.
    spent = before.seconds if before is not None and before.inputs == inputs else 0.0
    outcome = Outcome(
        state=State.done if tried.done else State.failed,
        message=tried.message,
        again=tried.again,
        attempts=task.attempt,
        seconds=round(spent + tried.seconds, 2),
        host=tried.host,
        peak_gb=tried.peak_gb,
        place_deg=place_of_photos(photo_files(task.photos)),
        inputs=inputs,
        results=result_digests(task.out) if tried.done else (),
    )
    if outcome.state is State.done and not outcome.results:
        outcome = replace(outcome, state=State.failed, message="left no plot.json, trees.csv and report.html")
    write_outcome(task.out, outcome)
    return outcome


def with_files(task: PlotTask, files: Files) -> PlotTask:
    """The task with the options that name files."""
    return replace(task, options=(*task.options, *(f"{flag}={path.absolute()}" for flag, path in files)))
