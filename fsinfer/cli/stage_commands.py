"""One command a stage, for those who want to look at, repeat or replace a single step."""

from __future__ import annotations

import json
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fsinfer.cli.console import Debug, Quiet, reports_errors, stage_progress, warn
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
    SizeForDepth,
    Threads,
    TrustModel,
    Views,
    decimal_within,
    depth_settings,
    frame_settings,
    plot_border,
    pose_settings,
    scale_request,
    tree_settings,
)
from fsinfer.cli.tables import evaluation_rows, plot_rows, unmeasured_rows
from fsinfer.conventions.breast_height import BREAST_HEIGHT_M, BhRule
from fsinfer.depth.settings import DepthSettings
from fsinfer.evaluation.settings import MAX_DISTANCE_M, Align
from fsinfer.frames.settings import FrameSettings
from fsinfer.output.layout import FRAMES_FILE, OutputFolder
from fsinfer.scale.request import ScaleRequest

if TYPE_CHECKING:
    from fsinfer.workflow.ledger import Ledger

SceneFolder = Annotated[
    Path,
    typer.Argument(
        help="Scene in MVSNet format (images/, cams/, pair.txt), or of COLMAP, OpenMVS, Metashape (XML), nerfstudio, "
        "Polycam, 3D Scanner App, Record3D, RTAB-Map.",
        show_default=False,
    ),
]


def register_stages(app: typer.Typer) -> None:
    """Add the commands of this module to ``app``."""
    for command in (frames, poses, depth, fuse, trees, evaluate, report):
        app.command()(command)


@reports_errors
def frames(
    source: Annotated[Path, typer.Argument(help="Folder of photos, or a video.", show_default=False)],
    out: Out,
    interval_s: IntervalS = FrameSettings.interval_s,
    equalize: EqualizeHow = DEFAULT_EQUALIZE,
    max_size: SizeForDepth = DepthSettings.max_size_px,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Choose sharp, well exposed photos or video frames and even out their brightness."""
    settings = frame_settings(interval_s=interval_s, equalize=equalize, max_size=max_size)
    from fsinfer.notices.sentences import sentences
    from fsinfer.workflow.single_stages import frames_of

    with stage_progress(quiet=quiet) as progress:
        result = frames_of(source, out, settings=settings, progress=progress).result
    warn(sentences(result.warnings))
    typer.echo(f"{len(result.images)} of {len(result.rows)} frames chosen; reasons in {out / FRAMES_FILE}")


@reports_errors
def poses(
    images: Annotated[Path, typer.Argument(help="Folder of photos.", show_default=False)],
    out: Out,
    max_size: SizeForDepth = DepthSettings.max_size_px,
    threads: Threads = DepthSettings.threads,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Find where each photo was taken; writes a scene in MVSNet format and the COLMAP model."""
    from fsinfer.notices.sentences import sentences
    from fsinfer.workflow.single_stages import poses_of

    settings = pose_settings(ScaleRequest(), threads=threads, max_size=max_size)
    with stage_progress(quiet=quiet) as progress:
        result = poses_of(images, out, settings=settings, progress=progress).result
    warn(sentences(result.warnings))
    typer.echo(f"{result.registered} of {result.photos} photos placed; scene in {result.scene}")


@reports_errors
def depth(
    scene: SceneFolder,
    out: Out,
    images: Annotated[
        Path | None,
        typer.Option(
            "--images",
            help="Folder of the photos of another program's scene. Default: beside its files.",
            show_default=False,
        ),
    ] = None,
    model: Model = DepthSettings.model,
    views: Views = DEFAULT_VIEWS,
    max_size: MaxSize = DepthSettings.max_size_px,
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
    """Estimate depth and confidence for every view of a scene. Run again to go on after a stop.

    The scene of another program is made a scene of ours in OUT/scene first.
    """
    settings = depth_settings(
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
    )
    from fsinfer.notices.sentences import sentences
    from fsinfer.workflow.single_stages import depth_of

    with stage_progress(quiet=quiet) as progress:
        record = depth_of(scene, out, settings=settings, images=images, progress=progress)
    warn(sentences(record.result.warnings))
    typer.echo(f"{record.result.views} depth maps in {OutputFolder(out).depth}, {record.seconds:.0f} s")


@reports_errors
def fuse(
    scene: SceneFolder,
    out: Annotated[Path, typer.Argument(help="Folder that holds depth/ and confidence/.", show_default=False)],
    level: Annotated[
        bool | None,
        typer.Option(
            "--level/--no-level",
            help="Turn the cloud so that z points up. Default: for scenes made by fsinfer poses, and those of other "
            "programs whose axes do not say what is up (COLMAP, OpenMVS, nerfstudio, Record3D, Metashape with local "
            "coordinates); scene folders of others keep their axes.",
            show_default=False,
        ),
    ] = None,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Fuse the depth maps of a scene into one cloud: cloud.ply and cloud.laz."""
    from fsinfer.workflow.single_stages import fuse_scene

    with stage_progress(quiet=quiet) as progress:
        cloud = fuse_scene(scene, out, level=level, progress=progress).result
    typer.echo(f"{cloud.points} points in {OutputFolder(out).cloud_ply} and {OutputFolder(out).cloud_laz}")


@reports_errors
def trees(
    cloud: Annotated[
        Path, typer.Argument(help="Point cloud with z up: PLY, LAS, LAZ or text (x y z).", show_default=False)
    ],
    out: Out,
    scale: ScaleFactor = None,
    aruco_length_m: ArucoLength = None,
    aruco_dictionary: ArucoDictionary = ScaleRequest.aruco_dictionary,
    endpoints: Endpoints = None,
    length_m: EndpointsLength = None,
    bh: BreastHeight = BREAST_HEIGHT_M,
    bh_rule: BreastHeightRule = BhRule.midpoint,
    plot_radius_m: PlotRadius = None,
    plot_center: PlotCenter = None,
    plot_polygon: PlotPolygon = None,
    edits: Edits = None,
    far_stems: FarStems = False,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Find the trees of a cloud and measure their DBH: trees.csv, a figure for each tree, maps, labelled points.

    A cloud is taken to be in metres unless fsinfer made it without a scale.
    """
    request = scale_request(scale, aruco_length_m, aruco_dictionary, endpoints, length_m)
    border = plot_border(plot_radius_m, plot_center, plot_polygon)
    from fsinfer.notices.sentences import sentences
    from fsinfer.silhouettes.walk import WalkSettings
    from fsinfer.workflow.measure_cloud import MeasureSettings, measure_cloud_file
    from fsinfer.workflow.tree_stage import TreeStageSettings

    stage = TreeStageSettings(
        trees=tree_settings(bh_m=bh, bh_rule=bh_rule), border=border, walk=WalkSettings(measure_far=far_stems)
    )
    settings = MeasureSettings(stage=stage)
    reported = OutputFolder(out).report.exists()
    with stage_progress(quiet=quiet) as progress:
        found = measure_cloud_file(
            cloud, out, request=request, settings=settings, edits=edits, progress=progress("trees")
        ).result.trees
    warn(sentences(found.warnings))
    trees = "tree" if found.trees == 1 else "trees"
    typer.echo(f"{found.trees} {trees}, {found.trees_with_dbh} with DBH, in {OutputFolder(out).trees_csv}")
    for row in unmeasured_rows(found.unmeasured):
        typer.echo(row)
    for row in plot_rows(found.plot):
        typer.echo(row)
    if reported and not OutputFolder(out).report.exists():
        typer.echo(f"{OutputFolder(out).report} was of an earlier measurement and is gone: fsinfer report {out}")


@reports_errors
def evaluate(
    measured: Annotated[Path, typer.Argument(help="CSV: tree_id, x_m, y_m, dbh_cm.", show_default=False)],
    extracted: Annotated[Path, typer.Argument(help="trees.csv of fsinfer.", show_default=False)],
    max_distance_m: Annotated[
        float,
        typer.Option(
            "--max-distance-m",
            parser=decimal_within(0.0),
            help="Farthest that two positions of one tree may lie apart.",
        ),
    ] = MAX_DISTANCE_M,
    by_id: Annotated[bool, typer.Option("--by-id", help="Match by tree_id instead of by position.")] = False,
    align: Annotated[
        Align, typer.Option("--align", help="Move and turn the positions onto the measured ones first.")
    ] = Align.auto,
    area_margin_m: Annotated[
        float | None,
        typer.Option(
            "--area-margin-m",
            parser=decimal_within(0.0),
            help="Do not judge trees farther than this outside the measured ones' hull.",
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    figure: Annotated[
        Path | None, typer.Option("--figure", help="Draw extracted against measured DBH, counts, differences (PNG).")
    ] = None,
    debug: Debug = False,
) -> None:
    """Compare extracted trees with measured ones: trees found, RMSE, bias, accuracy."""
    from fsinfer.evaluation.figure import plot_evaluation, refuse_no_figure
    from fsinfer.evaluation.measured import read_measured, seem_swapped
    from fsinfer.evaluation.metrics import evaluate as compare

    if figure is not None:
        refuse_no_figure(figure)
    result = compare(
        read_measured(measured, need_position=not by_id),
        # Not only a trees.csv of ours: any table with these four columns, DBH empty where it was not measured.
        read_measured(extracted, need_dbh=False, need_position=not by_id),
        max_distance_m=max_distance_m,
        by_id=by_id,
        align=align.value,
        area_margin_m=area_margin_m,
    )
    if seem_swapped(measured, extracted):
        warn(
            [
                f"{measured} is a table of fsinfer, and {extracted} is none: they seem to be interchanged, and so are "
                "bias, omitted and false; give the measured trees first"
            ]
        )
    if as_json:
        typer.echo(json.dumps(result.to_dict(), indent=2))
    else:
        for row in evaluation_rows(result, by_id=by_id):
            typer.echo(row)
    # Last: the figures stand there where a full disk has no room for the drawing.
    if figure is not None:
        plot_evaluation(result, figure)


@reports_errors
def report(
    out: Annotated[Path, typer.Argument(help="Output folder of fsinfer run or trees.", show_default=False)],
    debug: Debug = False,
) -> None:
    """Write report.html from what the output folder holds."""
    from fsinfer.report import make_report
    from fsinfer.workflow.folder_lock import alone_in
    from fsinfer.workflow.ledger import Ledger

    ledger = Ledger(out)
    # What a run is at work on would be drawn half old, half new. Where none ever was, the lock's folder is not made.
    with alone_in(out) if ledger.folder.is_dir() else nullcontext():
        _tell_mixture(ledger)
        typer.echo(str(make_report(out)))


def _tell_mixture(ledger: Ledger) -> None:
    """Warn where tables and figures may be of two measurements, because the last one was stopped on the way."""
    from fsinfer.workflow.measure_cloud import MEASURE
    from fsinfer.workflow.pipeline import TREES

    # The other one may have come to its end since: then the tables are its own.
    whole = ledger.recall(TREES) is not None or ledger.recall(MEASURE) is not None
    # One that was refused before it wrote any table has mixed nothing.
    tables = OutputFolder(ledger.out).trees_csv.is_file()
    if tables and not whole and any(ledger.is_begun(stage) for stage in (TREES.name, MEASURE.name)):
        warn(
            [
                f"the trees in {ledger.out} were being measured when that was stopped: its tables and figures may be "
                "of two measurements; run the same fsinfer trees, or fsinfer run, again, and then this"
            ]
        )
