"""Commands for the day in the forest: boards to print before it, and what to photograph again while still there."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fsinfer.check.settings import CoverageSettings
from fsinfer.cli.console import Debug, Quiet, reports_errors, stage_progress
from fsinfer.cli.options import (
    DEFAULT_EQUALIZE,
    ArucoDictionary,
    ArucoLength,
    IntervalS,
    Out,
    SizeForDepth,
    decimal,
    decimal_within,
    frame_settings,
    pose_settings,
    scale_request,
)
from fsinfer.depth.settings import DepthSettings
from fsinfer.frames.settings import FrameSettings
from fsinfer.notices.numbers import counted
from fsinfer.scale.printed_boards import BOARDS, DICTIONARY, Paper
from fsinfer.scale.request import ScaleRequest


def register_field(app: typer.Typer) -> None:
    """Add the commands of this module to ``app``."""
    app.command()(marker)
    app.command()(check)


@reports_errors
def marker(
    out: Annotated[Path, typer.Option("--out", help="The PDF to write.")] = Path("marker.pdf"),
    paper: Annotated[Paper, typer.Option("--paper", case_sensitive=False, help="Paper in the printer.")] = Paper.a4,
    length_m: Annotated[
        float | None,
        typer.Option(
            "--length-m",
            parser=decimal,
            help="Side of the black square in metres. Default: 0.15, on A3 0.25.",
            show_default=False,
        ),
    ] = None,
    count: Annotated[int, typer.Option("--count", min=1, max=50, help="How many different boards.")] = BOARDS,
    ids: Annotated[
        str,
        typer.Option(
            "--ids",
            help="Marker numbers with commas, for example 3,4,5. Default: numbers that tell fsinfer the length.",
            show_default=False,
        ),
    ] = "",
    dictionary: Annotated[
        str, typer.Option("--aruco-dictionary", help="Which markers; only 4X4_50 tells fsinfer the length.")
    ] = DICTIONARY,
    debug: Debug = False,
) -> None:
    """Print boards that give the plot its scale: a PDF at true size, to be put up in the plot.

    Boards of 0.15, 0.2 and 0.25 m have numbers that fsinfer knows the length by: no scale option is needed later.
    """
    from fsinfer.errors import InputError
    from fsinfer.scale.board_sheet import write_marker_pdf

    try:
        numbers = [int(part) for part in ids.split(",") if part.strip()]
    except ValueError as error:
        msg = f"--ids {ids!r} are no numbers; write them with commas, for example 3,4,5"
        raise InputError(msg) from error
    boards = write_marker_pdf(
        out, paper=paper.value, length_m=length_m, numbers=numbers, count=count, dictionary=dictionary
    )
    side_mm = 1000 * boards[0].length_m
    listed = ", ".join(str(board.number) for board in boards)
    many = counted(len(boards), "board", "boards")
    typer.echo(f"{many} ({listed}), black square {side_mm:g} mm, {boards[0].paper}: {out}")
    typer.echo('Print at 100 % ("actual size") and check the bar with a ruler.')


@reports_errors
def check(
    source: Annotated[Path, typer.Argument(help="Folder of photos, or a video.", show_default=False)],
    out: Out,
    aruco_length_m: ArucoLength = None,
    aruco_dictionary: ArucoDictionary = ScaleRequest.aruco_dictionary,
    interval_s: IntervalS = FrameSettings.interval_s,
    margin_m: Annotated[
        float,
        typer.Option(
            "--margin-m", parser=decimal_within(0.0), help="Judge stems up to so many metres outside your walk."
        ),
    ] = CoverageSettings.margin_m,
    max_size: SizeForDepth = DepthSettings.max_size_px,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Say, while you are still in the forest, which trees to walk round again. Minutes.

    Draws a map: your walk, the stems, from where each was seen and from where it was not. What it has worked out
    fsinfer run does not work out again, given the same OUT.
    """
    request = scale_request(None, aruco_length_m, aruco_dictionary, None, None)
    from fsinfer.check import CheckSettings, check_capture
    from fsinfer.workflow.other_photos import refuse_other_photos

    refuse_other_photos(source, out)
    settings = CheckSettings(
        scale=request,
        coverage=CoverageSettings(margin_m=margin_m),
        frames=frame_settings(interval_s=interval_s, equalize=DEFAULT_EQUALIZE, max_size=max_size),
        poses=pose_settings(request, max_size=max_size),
    )
    with stage_progress(quiet=quiet) as progress:
        result = check_capture(source, out, settings=settings, progress=progress)
    for line in result.notes:
        typer.echo(line)
    for line in result.lines:
        typer.echo(line)
    if result.stems and not result.lines:
        typer.echo("Nothing to photograph again.")
    typer.echo(f"Map: {result.map_path}")
