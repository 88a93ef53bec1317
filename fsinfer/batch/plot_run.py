"""A plot from its row to its outcome, where photographs and output folder are within reach."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

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
    """The outcome of ``try_it``, or the one kept from earlier where nothing has changed since, or nothing can be done.

    It is kept, unless the photographs are not there: then what was kept of the plot stays.
    """
    photos = photo_files(task.photos)
    words, paths = (*task.options, *(flag for flag, _ in files)), [path for _, path in files]
    inputs, options = (inputs_digest(read, task.out, words, paths) for read in (photos, ()))
    before = read_outcome(task.out)
    if before is not None and before.state is State.done:
        results = result_digests(task.out)
        if results and not photos:
            told = _without_photos(before, task.photos, options=options, results=results)
            return replace(before, ran=False, **told)
        if results and results == before.results and before.inputs == inputs:
            return replace(before, ran=False)
    tried = try_it()
    # What an earlier attempt has finished is not done again, so its time belongs to the plot.
    same = before is not None and (before.inputs == inputs if photos else before.options == options)
    spent = before.seconds if before is not None and same else 0.0
    outcome = Outcome(
        state=State.done if tried.done else State.failed,
        message=tried.message,
        again=tried.again,
        attempts=task.attempt,
        seconds=round(spent + tried.seconds, 2),
        host=tried.host,
        peak_gb=tried.peak_gb,
        place_deg=place_of_photos(photos),
        inputs=inputs,
        options=options,
        results=result_digests(task.out) if tried.done else (),
    )
    if outcome.state is State.done and not outcome.results:
        outcome = replace(outcome, state=State.failed, message="left no plot.json, trees.csv and report.html")
    if photos or before is None:
        write_outcome(task.out, outcome)
    return outcome


def _without_photos(before: Outcome, photos: Path, *, options: str, results: tuple[str, ...]) -> dict[str, Any]:
    """State and message of a plot that was done ``before``, and whose photographs are on a disk that is not there."""
    gone = f"its photos are not there at the moment ({photos})"
    if not before.options:
        why = "an earlier fsinfer, which did not note its options"
    elif before.options != options:
        why = "earlier options, corrections, or another version of fsinfer"
    elif before.results != results:
        return {"state": State.outdated, "message": f"{gone}; its results were changed since the batch measured it"}
    else:
        return {"message": gone}
    return {"state": State.outdated, "message": f"{gone}; it still has the results of {why}"}


def with_files(task: PlotTask, files: Files) -> PlotTask:
    """The task with the options that name files."""
    return replace(task, options=(*task.options, *(f"{flag}={path.absolute()}" for flag, path in files)))
