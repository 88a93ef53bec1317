"""One command a stage, for those who want to look at, repeat or replace a single step."""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from fsinfer.cli.console import Debug, Quiet, reports_errors, stage_progress, warn
from fsinfer.cli.options import (
    ArucoDictionary,
    ArucoLength,
    BhRule,
    BreastHeight,
    BreastHeightRule,
    Edits,
    Endpoints,
    EndpointsLength,
    Equalize,
    EqualizeHow,
    IntervalS,
    MaxSize,
    MemoryGb,
    Model,
    Out,
    Precision,
    PrecisionHow,
    Provider,
    ScaleFactor,
    Threads,
    Views,
    depth_settings,
    frame_settings,
    scale_request,
    tree_settings,
)
from fsinfer.cli.tables import evaluation_rows, unmeasured_rows

SceneFolder = Annotated[
    Path, typer.Argument(help="Scene in MVSNet format: images/, cams/, pair.txt.", show_default=False)
]


class Align(StrEnum):
    """Whether the extracted positions may be moved and turned onto the measured ones."""

    auto = "auto"
    never = "never"
    always = "always"


def register_stages(app: typer.Typer) -> None:
    """Add the commands of this module to ``app``."""
    for command in (frames, poses, depth, fuse, trees, evaluate, report):
        app.command()(command)


@reports_errors
def frames(
    source: Annotated[Path, typer.Argument(help="Folder of photos, or a video.", show_default=False)],
    out: Out,
    interval_s: IntervalS = 2.0,
    equalize: EqualizeHow = Equalize.none,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Choose sharp, well exposed photos or video frames and even out their brightness."""
    settings = frame_settings(interval_s=interval_s, equalize=equalize)
    from fsinfer.frames.select import select_frames

    with stage_progress(quiet=quiet) as progress:
        result = select_frames(source, out, settings=settings, progress=progress("frames"))
    warn(result.warnings)
    typer.echo(f"{len(result.images)} of {len(result.rows)} frames chosen; reasons in {out / 'frames.csv'}")


@reports_errors
def poses(
    images: Annotated[Path, typer.Argument(help="Folder of photos.", show_default=False)],
    out: Out,
    threads: Threads = 0,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Find where each photo was taken; writes a scene in MVSNet format and the COLMAP model."""
    from fsinfer.poses.estimate import PoseSettings, estimate_poses

    with stage_progress(quiet=quiet) as progress:
        result = estimate_poses(images, out, settings=PoseSettings(threads=threads), progress=progress("poses"))
    warn(result.warnings)
    typer.echo(f"{result.registered} of {result.photos} photos placed; scene in {result.scene}")


@reports_errors
def depth(
    scene: SceneFolder,
    out: Out,
    model: Model = "field",
    views: Views = 5,
    max_size: MaxSize = 1280,
    threads: Threads = 0,
    memory_gb: MemoryGb = 3.0,
    provider: Provider = "cpu",
    precision: PrecisionHow = Precision.auto,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Estimate depth and confidence for every view of a scene. Run again to go on after a stop."""
    settings = depth_settings(
        model=model,
        views=views,
        max_size=max_size,
        threads=threads,
        memory_gb=memory_gb,
        provider=provider,
        precision=precision,
    )
    from fsinfer.depth.stage import estimate_depth
    from fsinfer.scene import read_scene

    with stage_progress(quiet=quiet) as progress:
        result = estimate_depth(read_scene(scene), out, settings=settings, progress=progress("depth"))
    typer.echo(f"{result.views} depth maps in {out / 'depth'}, {result.seconds:.0f} s")


@reports_errors
def fuse(
    scene: SceneFolder,
    out: Annotated[Path, typer.Argument(help="Folder that holds depth/ and confidence/.", show_default=False)],
    level: Annotated[
        bool | None,
        typer.Option(
            "--level/--no-level",
            help="Turn the cloud so that z points up. Default: only for scenes made by fsinfer poses.",
            show_default=False,
        ),
    ] = None,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Fuse the depth maps of a scene into one cloud: cloud.ply and cloud.laz."""
    from fsinfer.workflow.single_stages import fuse_scene

    with stage_progress(quiet=quiet) as progress:
        points = fuse_scene(scene, out, level=level, progress=progress("fuse"))
    typer.echo(f"{points} points in {out / 'cloud.ply'} and {out / 'cloud.laz'}")


@reports_errors
def trees(
    cloud: Annotated[Path, typer.Argument(help="Point cloud with z up: PLY, LAS or LAZ.", show_default=False)],
    out: Out,
    scale: ScaleFactor = None,
    aruco_length_m: ArucoLength = None,
    aruco_dictionary: ArucoDictionary = "4X4_50",
    endpoints: Endpoints = None,
    length_m: EndpointsLength = None,
    bh: BreastHeight = 1.3,
    bh_rule: BreastHeightRule = BhRule.midpoint,
    edits: Edits = None,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Find the trees of a cloud and measure their DBH: trees.csv, a figure for each tree, maps, labelled points.

    A cloud is taken to be in metres unless fsinfer made it without a scale.
    """
    request = scale_request(scale, aruco_length_m, aruco_dictionary, endpoints, length_m)
    from fsinfer.trees.outputs.table import read_trees
    from fsinfer.workflow.single_stages import measure_cloud_file

    with stage_progress(quiet=quiet) as progress:
        result = measure_cloud_file(
            cloud,
            out,
            request=request,
            settings=tree_settings(bh_m=bh, bh_rule=bh_rule),
            edits=edits,
            progress=progress("trees"),
        )
    warn(result["warnings"])
    trees = "tree" if result["trees"] == 1 else "trees"
    typer.echo(f"{result['trees']} {trees}, {result['trees_with_dbh']} with DBH, in {out / 'trees.csv'}")
    for row in unmeasured_rows(read_trees(out / "trees.csv")):
        typer.echo(row)


@reports_errors
def evaluate(
    measured: Annotated[Path, typer.Argument(help="CSV: tree_id, x_m, y_m, dbh_cm.", show_default=False)],
    extracted: Annotated[Path, typer.Argument(help="trees.csv of fsinfer.", show_default=False)],
    max_distance_m: Annotated[
        float, typer.Option("--max-distance-m", min=0.0, help="Farthest that two positions of one tree may lie apart.")
    ] = 0.5,
    by_id: Annotated[bool, typer.Option("--by-id", help="Match by tree_id instead of by position.")] = False,
    align: Annotated[
        Align, typer.Option("--align", help="Move and turn the positions onto the measured ones first.")
    ] = Align.auto,
    area_margin_m: Annotated[
        float | None,
        typer.Option("--area-margin-m", help="Do not judge trees farther than this outside the measured ones' hull."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    figure: Annotated[
        Path | None, typer.Option("--figure", help="Draw extracted against measured DBH, counts, differences (PNG).")
    ] = None,
    debug: Debug = False,
) -> None:
    """Compare extracted trees with measured ones: trees found, RMSE, bias, accuracy."""
    from fsinfer.evaluation.figure import plot_evaluation
    from fsinfer.evaluation.metrics import evaluate as compare
    from fsinfer.evaluation.metrics import read_measured

    result = compare(
        read_measured(measured, need_position=not by_id),
        # Not only a trees.csv of ours: any table with these four columns, DBH empty where it was not measured.
        read_measured(extracted, need_dbh=False, need_position=not by_id),
        max_distance_m=max_distance_m,
        by_id=by_id,
        align=align.value,
        area_margin_m=area_margin_m,
    )
    if figure is not None:
        plot_evaluation(result, figure)
    if as_json:
        typer.echo(json.dumps(result.to_dict(), indent=2))
    else:
        for row in evaluation_rows(result):
            typer.echo(row)


@reports_errors
def report(out: Out, debug: Debug = False) -> None:
    """Write report.html from what the output folder holds."""
    from fsinfer.report import make_report

    typer.echo(str(make_report(out)))
