"""The whole job: photos → frames → poses → depth → cloud → trees → report, each stage done once.

A second run with the same output folder goes on where the first one ended. Changing an option repeats the stages
that depend on it and no others: another scale or other tree options never repeat frames, poses, depth or fusion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from fsinfer.errors import CloudError
from fsinfer.frames.select import FramesResult
from fsinfer.geometry.similarity import scale_of
from fsinfer.io.cloud import read_cloud
from fsinfer.io.files import make_folder
from fsinfer.notices.notice import notice
from fsinfer.notices.stems import StemCode
from fsinfer.output.json_values import as_json
from fsinfer.output.plot_json import write_plot
from fsinfer.poses.estimate import PosesResult
from fsinfer.progress import StageProgress, silent_stages
from fsinfer.scale.doubts import doubt_about_all
from fsinfer.scale.find import FoundScale
from fsinfer.scale.scale import marker_centers
from fsinfer.threads import one_blas_thread
from fsinfer.trees.edit_rows import TreeEdit, find_edits
from fsinfer.workflow.cloud_stages import (
    CHECK,
    CLOUD,
    DEPTH,
    FUSE,
    SCALE,
    PlotCloud,
    compare_with_sfm,
    compute_depth,
    fuse_depth,
    measure_scale,
    model_digest,
    place_plot,
    require_workers,
    scene_of,
)
from fsinfer.workflow.folder_lock import alone_in
from fsinfer.workflow.given_edits import note_edits
from fsinfer.workflow.joined_parts import digests_of
from fsinfer.workflow.kept_clicks import kept_clicks
from fsinfer.workflow.ledger import Ledger, Stage, StageRecord
from fsinfer.workflow.own_files import BESIDE_TREES, refuse_clouds_of_others, refuse_files_of_others
from fsinfer.workflow.parts import PartResult, measure_parts
from fsinfer.workflow.photo_stages import FRAMES, POSES, choose_frames, register_photos, require_poses, source_files
from fsinfer.workflow.run_photos import photos_of_run
from fsinfer.workflow.settings import RunSettings, speedless
from fsinfer.workflow.summary import PlotRecords, summarize
from fsinfer.workflow.tree_stage import PlotCloudInput, TreeStageSettings, measure_plot, no_trees, tree_workers
from fsinfer.workflow.trees_result import TreesResult


@dataclass(frozen=True, kw_only=True)
class ReportResult:
    """The report that was written."""

    path: Path


TREES = Stage(name="trees", version=57, result=TreesResult, outputs=("trees.csv", "figures"), beside=BESIDE_TREES)
REPORT = Stage(name="report", version=1, result=ReportResult, outputs=("report.html",))
#: All that a run goes through, in its order.
STAGES: tuple[Stage[Any], ...] = (FRAMES, POSES, DEPTH, CHECK, FUSE, SCALE, CLOUD, TREES, REPORT)


@dataclass(frozen=True, kw_only=True)
class RunResult:
    """What a run left in its output folder.

    Attributes
    ----------
    out: the folder.
    plot: the content of ``plot.json``.
    records: of the stages, each with its typed result; report: of the report.
    """

    out: Path
    plot: dict[str, Any]
    records: PlotRecords
    report: StageRecord[ReportResult]

    @property
    def stages(self) -> tuple[StageRecord[Any], ...]:
        """The record of every stage, in order; ``ran`` says which were done now."""
        return (*self.records.in_order, self.report)


@one_blas_thread()
def run(
    source: Path,
    out: Path,
    *,
    settings: RunSettings | None = None,
    edits: Path | None = None,
    progress: StageProgress = silent_stages,
    apart: bool = True,
) -> RunResult:
    """Do the whole job, going on from what an earlier run into ``out`` finished.

    Parameters
    ----------
    source: a folder of photographs, or a video.
    out: output folder, made if missing. Its layout is in docs/quickstart.md.
    settings: of all stages.
    edits: corrections of the stem map by hand; without it ``OUT/edits.csv``, where there is one.
    progress: gives the progress callback for a stage's name.
    apart: parts of the walk that nothing ties to the rest are measured as well, in folders of their own.

    Raises
    ------
    FsinferError
        Any stage's error. What was finished before stays, and the same call goes on from there.
    """
    source, out = Path(source), Path(out)
    settings = _with_clicks(settings or RunSettings(), out)
    files = source_files(source, out)
    # A wrong model name, an edit that cannot be read, or tables and clouds of others in OUT must not show after an hour
    # of structure from motion.
    refuse_files_of_others(out)
    refuse_clouds_of_others(out)
    model_digest(settings.depth)
    find_edits(out, edits)
    require_poses(out)
    ledger = Ledger(make_folder(out))
    with alone_in(out):
        require_workers(settings.depth, ledger.folder)
        frames = choose_frames(ledger, source, files, settings=settings.frames, progress=progress)
        poses = register_photos(
            ledger, out / "frames" / "images", settings=settings.poses, origin=source, progress=progress
        )
        return run_from_scene(
            ledger, frames, poses, settings=settings, source=source.name, edits=edits, progress=progress, apart=apart
        )


def run_from_scene(
    ledger: Ledger,
    frames: StageRecord[FramesResult],
    poses: StageRecord[PosesResult],
    *,
    settings: RunSettings,
    source: str,
    edits: Path | None = None,
    progress: StageProgress = silent_stages,
    apart: bool = True,
) -> RunResult:
    """The stages after the poses, of which ``frames`` and ``poses`` are the records; ``source`` names the photos.

    ``apart``: parts of the walk that nothing ties to the rest are measured as well.
    """
    out = ledger.out
    corrections = find_edits(out, edits)
    scene = scene_of(out)
    depth = compute_depth(ledger, scene, settings=settings.depth, progress=progress)
    check = compare_with_sfm(ledger, scene, settings=settings.sfm_check, after=[poses, depth])
    fused = fuse_depth(ledger, scene, settings=settings.fusion, after=[depth], progress=progress)
    scale = measure_scale(
        ledger, scene, request=settings.scale, settings=settings.markers, after=[poses], progress=progress
    )
    m_per_unit = scale.result.scale.m_per_unit
    cloud = place_plot(ledger, scene, fused, m_per_unit=m_per_unit, settings=settings.level, progress=progress)
    parts: tuple[PartResult, ...] = ()
    if apart:

        def run_part(photos: Path, folder: Path, of_part: RunSettings) -> tuple[int, int, int]:
            done = run(photos, folder, settings=of_part, progress=progress, apart=False).records
            return done.poses.result.registered, done.trees.result.trees, done.trees.result.trees_with_dbh

        parts = measure_parts(out, out / "frames" / "images", poses.result, settings, run_part)
    folders = [out / part.folder for part in parts if not part.error]
    # For both, since starting them takes a second.
    with tree_workers(cloud.result.points, settings.depth.threads):
        trees = _measure_trees(
            ledger, depth, scale, cloud, settings=settings, edits=corrections, parts=folders, progress=progress
        )
        note_edits(out, edits)
        records = PlotRecords(
            frames=frames, poses=poses, depth=depth, check=check, fuse=fused, scale=scale, cloud=cloud, trees=trees
        )
        settings_json = dict(as_json(settings))
        so_far = summarize(records, settings=settings_json, source=source, parts=parts)
        report = _report(ledger, so_far, trees, progress)
    plot = summarize(records, settings=settings_json, source=source, parts=parts, report=report)
    write_plot(out, plot)
    return RunResult(out=out, plot=plot, records=records, report=report)


def _with_clicks(settings: RunSettings, out: Path) -> RunSettings:
    """The settings with the ends that were clicked for this folder, where nothing else gives the scale."""
    if settings.scale.given or settings.scale.clicks is not None:
        return settings
    used = kept_clicks(out).used
    return settings if used is None else replace(settings, scale=replace(settings.scale, clicks=used))


def _measure_trees(
    ledger: Ledger,
    depth: StageRecord[Any],
    found: StageRecord[FoundScale],
    placed: StageRecord[PlotCloud],
    *,
    settings: RunSettings,
    edits: Sequence[TreeEdit],
    parts: Sequence[Path],
    progress: StageProgress,
) -> StageRecord[TreesResult]:
    """Stage ``trees``: tables, maps and figures; with the stems of ``parts``, folders of those measured apart."""
    out, scale, cloud = ledger.out, found.result.scale, placed.result
    boards = found.result.boards

    def work(_resume: bool) -> TreesResult:
        given = PlotCloudInput(
            cloud=read_cloud(cloud.path),
            metric=scale.m_per_unit is not None,
            scale_rel_std=scale.rel_std or 0.0,
            camera_height=cloud.camera_height,
            marker_xyz=marker_centers(boards, cloud.cloud_from_scene),
            marker_numbers=tuple(marker.id for marker in boards.markers),
            photos=photos_of_run(out, scene_of(out), cloud.cloud_from_scene),
            edits=edits,
            parts=parts,
            doubt=doubt_about_all(boards),
            unit=scale_of(cloud.cloud_from_scene),
        )
        try:
            return measure_plot(given, out, settings=of_trees, progress=progress("trees"))
        except CloudError as error:
            # A cloud without ground or stems is a result of the photographs: the report has to say so.
            return no_trees(out, reason=notice(StemCode.nothing_measured, error=str(error)))

    of_trees = TreeStageSettings(
        trees=settings.trees,
        silhouettes=settings.silhouettes,
        stem_curve=settings.stem_curve,
        border=settings.border,
        walk=settings.walk,
        tops=settings.tops,
        pattern=settings.pattern,
    )
    inputs = {
        "settings": speedless(of_trees), "rel_std": scale.rel_std, "edits": edits, "parts": digests_of(parts),
    }  # fmt: skip
    return ledger.run(TREES, work, inputs=inputs, after=[depth, found, placed])


def _report(
    ledger: Ledger, plot: dict[str, Any], trees: StageRecord[TreesResult], progress: StageProgress
) -> StageRecord[ReportResult]:
    """Stage ``report``, from ``plot.json`` without the report's own time, which is not known yet."""
    from fsinfer.report import make_report  # loads matplotlib

    def work(_resume: bool) -> ReportResult:
        report = progress("report")
        report(0, 1, "report")
        write_plot(ledger.out, plot)
        path = make_report(ledger.out)
        report(1, 1, "report")
        return ReportResult(path=path)

    # Times change when a stage that came out the same is repeated.
    timeless = {key: value for key, value in plot.items() if key not in ("seconds", "peak_rss_mb")}
    return ledger.run(REPORT, work, inputs={"plot": timeless}, after=[trees])
