"""The ``fsinfer`` command: it parses, calls one function of the library, and prints what came out."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
import typer.core

from fsinfer._version import __version__
from fsinfer.cli.batch_command import register_batch
from fsinfer.cli.console import (
    Debug,
    Quiet,
    reports_errors,
    show_library_warnings,
    stage_progress,
    stop_on_signals,
    tell,
    warn,
)
from fsinfer.cli.field_commands import register_field
from fsinfer.cli.options import (
    DEFAULT_EQUALIZE,
    DEFAULT_PRECISION,
    DEFAULT_VIEWS,
    ArucoDictionary,
    ArucoLength,
    BreastHeight,
    BreastHeightRule,
    DepthCopy,
    DepthScheduler,
    Edits,
    Endpoints,
    EndpointsLength,
    EqualizeHow,
    FarStems,
    IntervalS,
    MaxSize,
    MemoryGb,
    Model,
    Out,
    PlotCenter,
    PlotPolygon,
    PlotRadius,
    PrecisionHow,
    Provider,
    ScaleFactor,
    Threads,
    TrustModel,
    Views,
    depth_settings,
    frame_settings,
    plot_border,
    pose_settings,
    scale_request,
    tree_settings,
)
from fsinfer.cli.scale_command import register_scale
from fsinfer.cli.stage_commands import register_stages
from fsinfer.cli.support_command import register_support
from fsinfer.cli.tables import demo_rows, plot_rows, scale_rows, unmeasured_rows
from fsinfer.conventions.breast_height import BREAST_HEIGHT_M, BhRule
from fsinfer.depth.settings import DepthSettings
from fsinfer.frames.settings import FrameSettings
from fsinfer.notices.numbers import counted
from fsinfer.scale.request import ScaleRequest

EXAMPLES = {
    "run": "photos my-plot",
    "batch": "plots.csv my-plots",
    "check": "photos my-plot",
    "demo": "demo-plot",
    "frames": "walk.mp4 my-frames",
    "poses": "photos my-scene",
    "depth": "my-scene my-depth",
    "fuse": "my-scene my-depth",
    "scale": "my-plot --click --length-m 1.0",
    "trees": "plot.laz my-trees",
    "evaluate": "measured.csv my-plot/trees.csv",
    "report": "my-plot",
    "support": "my-plot",
}


class _Commands(typer.core.TyperGroup):
    """Shows an example where an argument is missing."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command that was named."""
        try:
            return super().invoke(ctx)
        except typer.BadParameter as error:
            command = ctx.invoked_subcommand or ""
            # The class of a missing parameter is one that typer does not show.
            if type(error).__name__ == "MissingParameter" and command in EXAMPLES:
                error.message = f"For example: fsinfer {command} {EXAMPLES[command]}"
            raise


app = typer.Typer(
    name="fsinfer",
    cls=_Commands,
    help="Forest plots from photographs: point cloud, stem map and DBH with intervals. Offline, on a laptop.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"fsinfer {__version__}")
        raise typer.Exit


@app.callback()
def _main_options(
    _version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    pass


@app.command()
@reports_errors
def demo(
    out: Out,
    model: Model = DepthSettings.model,
    threads: Threads = DepthSettings.threads,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Measure a small plot that comes with fsinfer, and compare the result with the truth."""
    from fsinfer.workflow.demo import run_demo

    with stage_progress(quiet=quiet) as progress:
        result = run_demo(out, model=model, threads=threads, progress=progress)
    for row in demo_rows(result):
        typer.echo(row)
    typer.echo("")
    warn(result.run.plot["warnings"])
    typer.echo(f"Report: {out / 'report.html'}")


@app.command()
@reports_errors
def run(
    source: Annotated[Path, typer.Argument(help="Folder of photos, or a video.", show_default=False)],
    out: Out,
    scale: ScaleFactor = None,
    aruco_length_m: ArucoLength = None,
    aruco_dictionary: ArucoDictionary = ScaleRequest.aruco_dictionary,
    endpoints: Endpoints = None,
    length_m: EndpointsLength = None,
    interval_s: IntervalS = FrameSettings.interval_s,
    equalize: EqualizeHow = DEFAULT_EQUALIZE,
    model: Model = DepthSettings.model,
    views: Views = DEFAULT_VIEWS,
    max_size: MaxSize = DepthSettings.max_size_px,
    bh: BreastHeight = BREAST_HEIGHT_M,
    bh_rule: BreastHeightRule = BhRule.midpoint,
    plot_radius_m: PlotRadius = None,
    plot_center: PlotCenter = None,
    plot_polygon: PlotPolygon = None,
    edits: Edits = None,
    far_stems: FarStems = False,
    threads: Threads = DepthSettings.threads,
    memory_gb: MemoryGb = DepthSettings.memory_gb,
    provider: Provider = DepthSettings.provider,
    precision: PrecisionHow = DEFAULT_PRECISION,
    trust_model: TrustModel = False,
    scheduler: DepthScheduler = DepthSettings.scheduler,
    copy: DepthCopy = DepthSettings.copy_photos,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Do everything: photos to point cloud, stem map, DBH and report. Run again to go on after a stop.

    Boards printed by fsinfer marker give the scale by themselves. Without them and without a scale option the cloud is
    in model units and no DBH is measured; adding one later takes seconds.
    """
    request = scale_request(scale, aruco_length_m, aruco_dictionary, endpoints, length_m)
    border = plot_border(plot_radius_m, plot_center, plot_polygon)
    from fsinfer.cli.remaining import RemainingTime
    from fsinfer.fusion.fuse import FusionSettings
    from fsinfer.silhouettes.walk import WalkSettings
    from fsinfer.workflow.other_photos import refuse_other_photos
    from fsinfer.workflow.pipeline import run as run_pipeline
    from fsinfer.workflow.settings import RunSettings

    refuse_other_photos(source, out)
    settings = RunSettings(
        frames=frame_settings(interval_s=interval_s, equalize=equalize, max_size=max_size),
        poses=pose_settings(request, threads=threads, max_size=max_size),
        depth=depth_settings(
            model=model,
            views=views,
            max_size=max_size,
            threads=threads,
            memory_gb=memory_gb,
            provider=provider,
            precision=precision,
            trust_model=trust_model,
            scheduler=scheduler,
            copy=copy,
        ),
        fusion=FusionSettings(memory_gb=memory_gb),
        trees=tree_settings(bh_m=bh, bh_rule=bh_rule),
        scale=request,
        border=border,
        walk=WalkSettings(measure_far=far_stems),
    )
    elsewhere = ("depth",) if scheduler else ()
    with stage_progress(quiet=quiet, whole=RemainingTime(elsewhere=elsewhere)) as progress:
        result = run_pipeline(source, out, settings=settings, edits=edits, progress=progress)
    poses, cloud, trees = result.records.poses.result, result.records.cloud.result, result.records.trees.result
    warn(result.plot["warnings"])
    if not any(record.ran for record in result.stages):
        typer.echo("Nothing to do: everything was finished before.")
    typer.echo(f"Photos: {poses.registered} of {poses.photos} placed")
    for row in scale_rows(result.records.scale.result.scale):
        typer.echo(row)
    typer.echo(f"Cloud: {cloud.points} points in {result.plot['units']}, {cloud.path}")
    typer.echo(f"Trees: {trees.trees}, with DBH {trees.trees_with_dbh}, {out / 'trees.csv'}")
    for row in unmeasured_rows(trees.unmeasured):
        typer.echo(row)
    for row in plot_rows(trees.plot):
        typer.echo(row)
    typer.echo(f"Report: {result.report.result.path}")
    for part in result.plot["parts"]:
        told = part["error"] or f"{counted(part['trees'], 'tree', 'trees')}, with DBH {part['trees_with_dbh']}"
        typer.echo(f"Apart from the rest, {part['photos']} photos: {told}, {out / part['folder'] / 'report.html'}")


register_batch(app)
register_field(app)
register_scale(app)
register_stages(app)
register_support(app)


def main() -> None:
    """Entry point of the ``fsinfer`` command."""
    show_library_warnings()
    stop_on_signals()
    try:
        app()
    except Exception as error:
        # Only what happens outside a command: a fault in parsing or in printing.
        raise SystemExit(tell(error)) from error


if __name__ == "__main__":
    main()
