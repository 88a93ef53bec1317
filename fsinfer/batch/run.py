"""A batch: all plots of a table, each once, and after each of them the summary of all."""

from __future__ import annotations

import secrets
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from dataclasses import dataclass, replace
from itertools import count as count_from
from pathlib import Path

from fsinfer.batch.attempt import PlotTask
from fsinfer.batch.estimates import ForestEstimates, forest_estimates
from fsinfer.batch.outcome import Outcome, State, read_outcome
from fsinfer.batch.places_to_run import PlaceToRun, ThisComputer
from fsinfer.batch.plots_table import Plot, read_plots
from fsinfer.batch.remaining import RemainingPlots
from fsinfer.batch.report import REPORT_FILE, write_report
from fsinfer.batch.rows import PLOTS_FOLDER, PlotRow, PlotTrees, plot_row
from fsinfer.batch.settings import BatchSettings
from fsinfer.batch.summary import Counts, count, write_plots, write_trees_and_workbook
from fsinfer.batch.tree_memory import check_can_look
from fsinfer.errors import ClusterError, FsinferError, WorkerLostError
from fsinfer.io.files import make_folder

#: Tables, workbook and report of thousands of plots take a while to write: after a plot they wait until so many times
#: their last writing has passed. Source: judgement; at most a twentieth of the time is spent on each of both.
_PAUSE_FACTOR = 20.0


@dataclass(frozen=True, kw_only=True)
class PlotNews:
    """A plot that has come to its end.

    Attributes
    ----------
    row: in the summary. ran: False where it was done before.
    finished, plots: how many of how many are at their end. seconds_left: of the batch; None as long as it is unknown.
    """

    row: PlotRow
    ran: bool
    finished: int
    plots: int
    seconds_left: float | None


@dataclass(frozen=True, kw_only=True)
class BatchResult:
    """The rows of the summary in the order of the table, how many stand where, how many were measured now."""

    out: Path
    rows: tuple[PlotRow, ...]
    counts: Counts
    ran: int
    report: Path

    @property
    def estimates(self) -> ForestEstimates:
        """What the plots say of the forest that they sample."""
        return forest_estimates(self.rows)


def run_batch(
    table: Path,
    out: Path,
    *,
    settings: BatchSettings | None = None,
    news: Callable[[PlotNews], None] = lambda _: None,
) -> BatchResult:
    """Measure all plots of a table into ``out``; those that are finished and unchanged are not run again.

    Parameters
    ----------
    table: PLOTS.csv (:func:`fsinfer.batch.plots_table.read_plots`).
    out: output folder; each plot has its own in ``plots/NAME``. With a cluster that shares a disk the workers must see
        it, and the photographs, under the same paths.
    news: is told of each plot that has come to its end.

    Returns
    -------
    The summary, which stands in ``out`` as well. A plot that failed is a row with a message, never an error.

    Raises
    ------
    InputError
        The table or the settings cannot be used, or no cluster answers; nothing was run.
    ClusterError
        The cluster is gone for good. What was finished is in the summary, and the same call goes on.
    OutputError
        The summary cannot be written.
    """
    settings = settings or BatchSettings()
    plots = read_plots(Path(table))
    if settings.limit_gb is not None:
        check_can_look()
    out = make_folder(Path(out).absolute())
    place = _place(settings)
    try:
        return _Batch(plots, out, settings, place, news, title=f"Plots of {Path(table).stem}").run()
    finally:
        place.close()


def _place(settings: BatchSettings) -> PlaceToRun:
    if not settings.scheduler:
        return ThisComputer(settings.jobs)
    from fsinfer.batch.cluster import Cluster  # loads Dask

    return Cluster(settings.scheduler, copy=settings.copy)


class _Batch:
    """One batch under way."""

    def __init__(
        self,
        plots: Sequence[Plot],
        out: Path,
        settings: BatchSettings,
        place: PlaceToRun,
        news: Callable[[PlotNews], None],
        *,
        title: str,
    ) -> None:
        self._plots = plots
        self._out = out
        self._settings = settings
        self._place = place
        self._news = news
        self._title = title
        self._token = secrets.token_hex(8)
        self._remaining = RemainingPlots()
        # What earlier batches left stands in the summary from the beginning; failed ones will be tried again.
        self._rows: dict[str, tuple[PlotRow, PlotTrees]] = {
            plot.name: plot_row(plot, self._folder(plot), _if_done(read_outcome(self._folder(plot)))) for plot in plots
        }
        self._stopping = threading.Event()
        self._tables = _Writing(lambda: write_plots(out, self._rows_in_order()))
        self._pages = _Writing(self._write_pages)
        self._ran = 0

    def run(self) -> BatchResult:
        """Give out all plots, take in what becomes of them."""
        self._write_all()
        threads = ThreadPoolExecutor(min(len(self._plots), self._place.most_at_once))
        futures = {threads.submit(self._measure, plot): plot for plot in self._plots}
        try:
            self._take_in(futures)
        except BaseException:
            self._stopping.set()
            threads.shutdown(wait=False, cancel_futures=True)
            self._place.stop(self._token)
            threads.shutdown(wait=True)
            self._write_all()
            raise
        threads.shutdown()
        self._write_all()
        rows = tuple(self._rows_in_order())
        report = self._out / REPORT_FILE
        return BatchResult(out=self._out, rows=rows, counts=count(rows), ran=self._ran, report=report)

    def _take_in(self, futures: Mapping[Future[Outcome], Plot]) -> None:
        for finished, future in enumerate(as_completed(futures), start=1):
            plot, outcome = futures[future], future.result()
            row, trees = plot_row(plot, self._folder(plot), outcome)
            changed = self._rows[plot.name] != (row, trees)
            self._rows[plot.name] = row, trees
            if outcome.ran:
                self._ran += 1
                self._remaining.add(outcome.seconds)
            self._tables.after_plot(changed=changed)
            self._pages.after_plot(changed=changed)
            left = len(futures) - finished
            self._news(
                PlotNews(
                    row=row,
                    ran=outcome.ran,
                    finished=finished,
                    plots=len(futures),
                    seconds_left=self._remaining.seconds(left, self._place.at_once),
                )
            )

    def _measure(self, plot: Plot) -> Outcome:
        """All attempts at a plot; only the end of the whole cluster is an error."""
        task = PlotTask(
            batch=self._token,
            photos=plot.photos,
            out=self._folder(plot),
            options=(*plot.options, *self._settings.options),
            command=self._settings.command,
            threads=self._settings.threads,
            beside=self._place.at_once,
            limit_minutes=self._settings.limit_minutes,
            limit_gb=self._settings.limit_gb,
        )
        for attempt in count_from(1):
            try:
                outcome = self._place.run(replace(task, attempt=attempt), plot.files)
            except ClusterError:
                raise
            except WorkerLostError as error:
                outcome = Outcome(state=State.failed, message=str(error), again=True, attempts=attempt)
            except (FsinferError, OSError) as error:
                outcome = Outcome(state=State.failed, message=str(error), attempts=attempt)
            except Exception as error:
                # A fault of ours costs one plot, not the night.
                told = f"fault of fsinfer: {type(error).__name__}: {error}"
                outcome = Outcome(state=State.failed, message=told, attempts=attempt)
            if not outcome.again or attempt > self._settings.retries or self._stopping.is_set():
                break
        return outcome

    def _folder(self, plot: Plot) -> Path:
        return self._out / PLOTS_FOLDER / plot.name

    def _rows_in_order(self) -> list[PlotRow]:
        """Of all plots, as the table has them."""
        return [self._rows[plot.name][0] for plot in self._plots]

    def _write_all(self) -> None:
        self._tables.write()
        self._pages.write()

    def _write_pages(self) -> None:
        """Workbook, trees and report, which take longer than the tables of plots."""
        rows = self._rows_in_order()
        write_trees_and_workbook(self._out, rows, [self._rows[plot.name][1] for plot in self._plots])
        write_report(self._out, rows, title=self._title)


class _Writing:
    """Something that is written after a plot, where that has changed it and the last writing is long enough ago."""

    def __init__(self, write: Callable[[], object]) -> None:
        self._write = write
        self._old = False
        self._until = 0.0

    def after_plot(self, *, changed: bool) -> None:
        """Write it, if it is due."""
        self._old |= changed
        if self._old and time.monotonic() >= self._until:
            self.write()

    def write(self) -> None:
        """Write it at once."""
        start = time.monotonic()
        self._write()
        self._old = False
        self._until = time.monotonic() + _PAUSE_FACTOR * (time.monotonic() - start)


def _if_done(outcome: Outcome | None) -> Outcome | None:
    return outcome if outcome is not None and outcome.state is State.done else None
