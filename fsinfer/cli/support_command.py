"""The command for when a plot failed: what to send to somebody who is to find out why."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fsinfer.cli.console import Debug, reports_errors


def register_support(app: typer.Typer) -> None:
    """Add the command of this module to ``app``."""
    app.command()(support)


@reports_errors
def support(
    out: Annotated[Path, typer.Argument(help="Output folder of the run.", show_default=False)],
    zip_file: Annotated[
        Path | None, typer.Option("--zip", help="The zip file to write. Default: OUT-support.zip.", show_default=False)
    ] = None,
    photos: Annotated[bool, typer.Option("--photos", help="Put the photographs in as well.")] = False,
    debug: Debug = False,
) -> None:
    """Pack tables, records and versions into a zip to send when a plot failed. No photographs unless asked for.

    Folders of this computer and your user name are taken out.
    """
    from fsinfer.output.support import write_support_zip

    # A folder given as "." or ".." has its name only when it is resolved.
    named = out if out.name not in ("", "..") else out.resolve()
    target = zip_file or named.with_name(f"{named.name}-support.zip")
    written = write_support_zip(out, target, photos=photos)
    typer.echo(f"{written} ({written.stat().st_size / 1e6:.2f} MB)")
    typer.echo(
        "The photographs are in it; look whether you may pass them on."
        if photos
        else "No photographs are in it, except small pictures of frames that were left out, if there are any."
    )
