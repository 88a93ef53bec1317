"""The command for many plots: a table of them, each measured in a process of its own."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fsinfer.cli.console import Debug, Quiet, reports_errors, say, warn
from fsinfer.cli.options import DEFAULT_PRECISION, MemoryGb, Model, PrecisionHow, Provider, decimal
from fsinfer.cli.remaining import as_words
from fsinfer.depth.settings import DepthSettings
from fsinfer.notices.numbers import counted, noun

if TYPE_CHECKING:
    from fsinfer.batch.estimates import ForestEstimates
    from fsinfer.batch.estimator import Estimate
    from fsinfer.batch.rows import PlotRow
    from fsinfer.batch.run import BatchResult, PlotNews

#: Exit code when the batch came to its end, but not every plot did. Source: format; what the shell is told.
EXIT_SOME_FAILED = 3

_WHERE = "Where"
_LIMITS = "Limits of a plot"
_PLOTS = "For all plots, as in fsinfer run"


def register_batch(app: typer.Typer) -> None:
    """Add the command of this module to ``app``."""
    app.command()(batch)


@reports_errors
def batch(
    context: typer.Context,
    plots: Annotated[
        Path,
        typer.Argument(
            metavar="PLOTS.csv", help="Table, a plot a row: name, photos (folder or video), ...", show_default=False
        ),
    ],
    out: Annotated[Path, typer.Argument(help="Output folder of all plots; made if missing.", show_default=False)],
    jobs: Annotated[
        int, typer.Option("--jobs", "-j", min=1, help="Plots at once on this computer.", rich_help_panel=_WHERE)
    ] = 1,
    scheduler: Annotated[
        str,
        typer.Option(
            "--scheduler",
            metavar="ADDRESS",
            help="Dask scheduler, like tcp://10.0.0.5:8786: its workers measure the plots. Needs fsinfer\\[cluster].",
            rich_help_panel=_WHERE,
            show_default=False,
        ),
    ] = "",
    copy: Annotated[
        bool,
        typer.Option(
            "--copy",
            help="Send the photos to the workers' own disks and fetch the results. Default: workers see PLOTS' paths "
            "and OUT as this computer does.",
            rich_help_panel=_WHERE,
        ),
    ] = False,
    retries: Annotated[
        int,
        typer.Option(
            "--retries",
            min=0,
            help="Try a plot so often again that was killed, ran out of memory, or lost its worker.",
            rich_help_panel=_LIMITS,
        ),
    ] = 2,
    limit_minutes: Annotated[
        float | None,
        typer.Option(
            "--limit-minutes",
            parser=decimal,
            help="End a plot after so many minutes. Running it again goes on from there.",
            rich_help_panel=_LIMITS,
        ),
    ] = None,
    limit_gb: Annotated[
        float | None,
        typer.Option(
            "--limit-gb",
            parser=decimal,
            help="End a plot that holds more memory, in GB, with all that it has started.",
            rich_help_panel=_LIMITS,
        ),
    ] = None,
    threads: Annotated[
        int,
        typer.Option(
            "--threads",
            min=0,
            help="Processor cores of each plot; 0 = its share of the computer.",
            rich_help_panel=_PLOTS,
        ),
    ] = 0,
    memory_gb: MemoryGb = DepthSettings.memory_gb,
    model: Model = DepthSettings.model,
    provider: Provider = DepthSettings.provider,
    precision: PrecisionHow = DEFAULT_PRECISION,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Measure many plots: fsinfer run for each row of a table, and one summary, map and report over all of them.

    Columns: name, photos, and any of scale, aruco_length_m, aruco_dictionary, endpoints, length_m, interval_s,
    equalize, views, max_size, bh, bh_rule, plot_radius_m, plot_center, plot_polygon, edits, far_stems (as the options
    of fsinfer run), latitude_deg, longitude_deg, stratum, stratum_ha. A plot that fails touches no other. Run again to
    go on: what is finished and unchanged is not repeated.

    Exit code: 0 when all plots are measured; 3 when some failed, or have only results of earlier options because their
    photos are not there, each with its reason in OUT/summary.csv; 2 when the table, an option or the cluster cannot be
    used.
    """
    from fsinfer.batch.run import run_batch
    from fsinfer.batch.settings import BatchSettings

    settings = BatchSettings(
        jobs=jobs,
        retries=retries,
        limit_minutes=limit_minutes,
        limit_gb=limit_gb,
        scheduler=scheduler,
        copy=copy,
        threads=threads,
        options=(
            f"--memory-gb={memory_gb!r}",
            # A manifest is a file, which the plots are to find from wherever they run.
            f"--model={Path(model).absolute() if Path(model).is_file() else model}",
            f"--provider={provider}",
            f"--precision={precision.value}",
        ),
    )
    _check_rows(plots, out, context)
    result = run_batch(plots, out, settings=settings, news=_say_nothing if quiet else _say_news)
    for line in _lines(result):
        typer.echo(line)
    if result.counts.failed or result.counts.outdated:
        raise typer.Exit(EXIT_SOME_FAILED)


def _check_rows(table: Path, out: Path, context: typer.Context) -> None:
    """What ``fsinfer run`` would refuse of a row is told before any plot is measured, and rows of the same photos.

    A file of a plot that is finished may lie on a disk that is not there, as its photographs may.

    Raises
    ------
    InputError
        With the row.
    """
    from fsinfer.batch.outcome import State, read_outcome
    from fsinfer.batch.plots_table import read_plots, same_photos
    from fsinfer.batch.rows import PLOTS_FOLDER
    from fsinfer.errors import InputError

    group = context.parent.command if context.parent is not None else None
    run = getattr(group, "commands", {}).get("run")
    plots = read_plots(table)
    for plot in plots:
        before = read_outcome(out / PLOTS_FOLDER / plot.name)
        finished = before is not None and before.state is State.done
        for option, path in plot.files:
            if not path.is_file() and not finished:
                msg = f"{plot.row}: the file of {option}, {path}, does not exist; correct the cell"
                raise InputError(msg)
        if run is None:
            continue
        try:
            run.make_context("run", [str(plot.photos), str(table), *plot.options])
        except typer.BadParameter as error:
            msg = f"{plot.row}: {error.format_message().rstrip('.')}; correct the cell"
            raise InputError(msg) from error
    # Nobody's error where one walk is measured with several borders; the sample has one plot fewer all the same.
    warn(
        f"{', '.join(names)} have the same photos: as rows of their own they count as {len(names)} plots in the "
        "summary and in the estimates for the forest, which then seem surer than they are; give each plot its own "
        "photos, or a table of its own to each border"
        for names in same_photos(plots)
    )


def _say_nothing(_: PlotNews) -> None:
    pass


def _say_news(news: PlotNews) -> None:
    row = news.row
    if row.state.value == "failed":
        told = f"failed: {row.message}"
    else:
        told = f"{counted(row.trees or 0, 'tree', 'trees')}, {row.trees_with_dbh} with DBH"
        told += f", {as_words(row.seconds or 0.0)}" if news.ran else ", done before"
        told += f"; {row.message}" if row.message else ""
    left = "" if not news.seconds_left else f"; about {as_words(news.seconds_left)} left"
    say(f"{news.finished}/{news.plots} {row.plot}: {told}{left}")


def _why_none(row: PlotRow) -> str:
    if not row.trees:
        return "no tree was found; see warning_text in summary.csv"
    if row.units != "m":
        return "it has no scale; give its aruco_length_m or scale, see warning_text in summary.csv"
    none = noun(row.trees, "its only tree could not", f"none of its {row.trees} trees could")
    return f"{none} be measured; see its report"


def _forest_lines(estimates: ForestEstimates) -> list[str]:
    """What the plots say of the forest, and what they do not."""
    from fsinfer.notices.sentences import sentences

    if not estimates.rows:
        return [f"Forest: {text}" for text in sentences(estimates.notices)]
    of_all = estimates.rows[0]
    figures = ((of_all.stems_per_ha, "stems/ha", 0), (of_all.basal_area_m2_per_ha, "m²/ha", 1))
    told = [_figure(found, unit, digits) for found, unit, digits in figures if found is not None]
    totals = ((of_all.stems, "stems", 0), (of_all.basal_area_m2, "m²", 0))
    on_area = [f"{found.value:.{digits}f} {unit}" for found, unit, digits in totals if found is not None]
    lines = [f"Forest by {counted(of_all.plots, 'plot', 'plots')} ({of_all.method}): {'; '.join(told)}"]
    if on_area:
        lines.append(f"  On {of_all.area_ha:.10g} ha: {', '.join(on_area)}")
    return [*lines, *(f"  Beware: {text}" for text in sentences(estimates.notices))]


def _figure(found: Estimate, unit: str, digits: int) -> str:
    if found.lo95 is None or found.hi95 is None:
        return f"{found.value:.{digits}f} {unit}"
    told = f"{found.value:.{digits}f} {unit} ({found.lo95:.{digits}f} to {found.hi95:.{digits}f}"
    share = found.sampling_error_percent
    return f"{told})" if share is None else f"{told}, sampling error {share:.1f} %)"


def _lines(result: BatchResult) -> list[str]:
    counts = result.counts
    lines = [] if result.ran or counts.outdated else ["Nothing to do: everything was finished before."]
    outdated = f", {counts.outdated} with outdated results" if counts.outdated else ""
    lines.append(f"Plots: {counts.done} of {counts.plots} measured{outdated}, {counts.failed} failed")
    lines.append(f"Trees: {counts.trees}, with DBH {counts.trees_with_dbh}")
    for row in result.rows:
        if row.state.value == "failed":
            lines.append(f"  {row.plot} failed: {row.message}")
            continue
        if row.message:
            lines.append(f"  {row.plot}: {row.message}")
        if row.state.value == "done" and not row.trees_with_dbh:
            lines.append(f"  {row.plot} has no DBH: {_why_none(row)}")
    # Who neither has given borders nor strata has not asked for it.
    if any(row.has_border or row.stratum for row in result.rows):
        lines += _forest_lines(result.estimates)
    lines.append(f"Summary: {result.out / 'summary.csv'}, {result.out / 'summary.xlsx'}")
    lines.append(f"Report: {result.report}")
    return lines
