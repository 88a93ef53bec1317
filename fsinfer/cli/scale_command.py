"""The command that takes the scale from two ends clicked in the photographs."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from fsinfer.cli.console import Debug, Quiet, reports_errors, stage_progress, warn
from fsinfer.cli.options import decimal
from fsinfer.cli.tables import plot_rows, unmeasured_rows


def register_scale(app: typer.Typer) -> None:
    """Add the command of this module to ``app``."""
    app.command()(scale)


@reports_errors
def scale(
    out: Annotated[Path, typer.Argument(help="Output folder of fsinfer run.", show_default=False)],
    click: Annotated[bool, typer.Option("--click", help="Click the two ends in photographs, in the browser.")] = False,
    length_m: Annotated[
        float | None,
        typer.Option(
            "--length-m",
            parser=decimal,
            help="Real distance of the two ends in metres, for example 1.0.",
            show_default=False,
        ),
    ] = None,
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Open the page, or only print its address.")
    ] = True,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Give a plot its scale by the two ends of something of known length, clicked in two photographs or more.

    The page is shown by this computer to itself; nothing goes over a network. Then the cloud is put to metres and the
    trees are measured again. Later runs into the folder keep that scale, until scale_clicks.json in it is deleted.
    """
    from fsinfer.errors import InputError
    from fsinfer.importers.write import read_origin
    from fsinfer.workflow.clicked_scale import click_scale

    if not click or length_m is None:
        missing = [option for option, there in (("--click", click), ("--length-m", length_m is not None)) if not there]
        told = f"{' and '.join(missing)} {'is' if len(missing) == 1 else 'are'}"
        msg = f"{told} missing; for example: fsinfer scale {out} --click --length-m 1.0"
        raise InputError(msg)

    def show(url: str) -> None:
        typer.echo(f"Click the two ends here: {url}")
        if not (browser and _open(url)):
            typer.echo("Open this address in a browser on this computer; Ctrl-C stops, and clicks are kept.")

    with stage_progress(quiet=quiet) as progress:
        result = click_scale(out, length_m, show=show, progress=progress)
    found = result.clicked.scale
    percent = 100.0 * (found.rel_std or 0.0)
    typer.echo(f"Scale: {found.m_per_unit:.6g} m per model unit, ± {percent:.2f} %, by {_errors(result.clicked.scale)}")
    if result.run is None:
        imported = read_origin(out / "scene") is not None
        measure = f"trees {out / 'cloud.ply'} {out}"
        onwards = f"fsinfer {measure if imported else f'run with the same photos and {out}'}"
        typer.echo(f"Kept in {out / 'scale_clicks.json'}; {onwards} goes on with it.")
        return
    warn(result.run.plot["warnings"])
    trees = result.run.records.trees.result
    typer.echo(f"Trees: {trees.trees}, with DBH {trees.trees_with_dbh}, {out / 'trees.csv'}")
    for row in (*unmeasured_rows(trees.unmeasured), *plot_rows(trees.plot)):
        typer.echo(row)
    typer.echo(f"Report: {result.run.report.result.path}")


def _open(url: str) -> bool:
    """Open the page in the user's browser; False where there is no screen for one."""
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return False  # a browser of the terminal would take the terminal, and cannot show photographs
    import webbrowser

    return webbrowser.open(url)


def _errors(found: object) -> str:
    from fsinfer.scale.scale import EndpointDetails, Scale

    details = found.details if isinstance(found, Scale) else None
    if not isinstance(details, EndpointDetails):
        return "clicks"
    errors = " and ".join(f"{error:.1f}" for error in details.errors_px)
    return f"{len(details.views)} photos; the ends miss the clicks by up to {errors} pixels"
