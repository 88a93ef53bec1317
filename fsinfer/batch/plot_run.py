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

    It is kept, unless the photographs are not there, or a file that an option names: then what was kept of the plot
    stays.
    """
    photos = photo_files(task.photos)
    words, paths = (*task.options, *(flag for flag, _ in files)), [path for _, path in files]
    inputs, options = (inputs_digest(read, task.out, words, paths) for read in (photos, ()))
    # What a file holds that is not there cannot be compared, but its name can.
    named = inputs_digest((), task.out, (*words, *(path.name for path in paths)), ())
    before = read_outcome(task.out)
    if before is not None and before.state is State.done:
        results = result_digests(task.out)
        gone = _gone(task.photos, files)
        if results and gone:
            whole = all(path.is_file() for path in paths)
            kept, now = (before.options, options) if whole else (before.named, named)
            told = _without_inputs(gone, known=bool(kept), same=kept == now, unchanged=results == before.results)
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
        named=named,
        results=result_digests(task.out) if tried.done else (),
    )
    if outcome.state is State.done and not outcome.results:
        outcome = replace(outcome, state=State.failed, message="left no plot.json, trees.csv and report.html")
    if photos or before is None:
        write_outcome(task.out, outcome)
    return outcome


def _gone(photos: Path, files: Files) -> str:
    """What of a plot's inputs lies on a disk that is not there; empty where all are."""
    gone = [] if photo_files(photos) else [f"its photos are not there at the moment ({photos})"]
    gone += [f"the file of {flag} is not there at the moment ({path})" for flag, path in files if not path.is_file()]
    return ", and ".join(gone)


def _without_inputs(gone: str, *, known: bool, same: bool, unchanged: bool) -> dict[str, Any]:
    """State and message of a plot that was done before, and whose photographs or files are not there.

    ``known``: its options were noted; ``same``: it has the same now; ``unchanged``: its results are as they were left.
    """
    if not known:
        why = "an earlier fsinfer, which did not note its options"
    elif not same:
        why = "earlier options, corrections, or another version of fsinfer"
    elif not unchanged:
        return {"state": State.outdated, "message": f"{gone}; its results were changed since the batch measured it"}
    else:
        return {"message": gone}
    return {"state": State.outdated, "message": f"{gone}; it still has the results of {why}"}


def with_files(task: PlotTask, files: Files) -> PlotTask:
    """The task with the options that name files."""
    return replace(task, options=(*task.options, *(f"{flag}={path.absolute()}" for flag, path in files)))
