"""The whole job: photos → frames → poses → depth → cloud → trees → report, each stage done once.

A second run with the same output folder goes on where the first one ended. Changing an option repeats the stages
that depend on it and no others: another scale or other tree options never repeat frames, poses, depth or fusion.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from fsinfer.depth.manifest import read_manifest
from fsinfer.depth.precision import INT8, choose_precision
from fsinfer.depth.sfm_check import check_depth
from fsinfer.depth.stage import DepthSettings, estimate_depth
from fsinfer.errors import CloudError, InputError
from fsinfer.frames.select import FrameSettings
from fsinfer.fusion.fuse import FusionSettings, fuse, most_points
from fsinfer.io.cloud import read_cloud, write_cloud
from fsinfer.io.files import make_folder
from fsinfer.output.json_values import as_json
from fsinfer.output.plot_json import package_versions, read_plot, write_plot
from fsinfer.placement.place import density_per_m2, place_cloud
from fsinfer.poses.colmap import PoseSettings
from fsinfer.poses.sparse import read_sparse
from fsinfer.progress import StageProgress, silent_stages
from fsinfer.scale.doubts import doubt_endpoints, doubt_height, unknown_error
from fsinfer.scale.find import find_scale
from fsinfer.scale.request import ScaleRequest
from fsinfer.scale.scale import marker_centers
from fsinfer.scene import Scene, read_scene
from fsinfer.silhouettes.join import StemPhotos
from fsinfer.trees import TreeSettings
from fsinfer.trees.edits import TreeEdit, find_edits
from fsinfer.workflow.ledger import StageBook, StageRecord
from fsinfer.workflow.photo_stages import choose_frames, place_photos, source_files, speedless
from fsinfer.workflow.summary import summarize
from fsinfer.workflow.tree_stage import write_no_trees, write_tree_outputs


@dataclass(frozen=True, kw_only=True)
class RunSettings:
    """The settings of every stage; the defaults suit a plot photographed with a phone."""

    frames: FrameSettings = field(default_factory=FrameSettings)
    poses: PoseSettings = field(default_factory=PoseSettings)
    depth: DepthSettings = field(default_factory=DepthSettings)
    fusion: FusionSettings = field(default_factory=FusionSettings)
    trees: TreeSettings = field(default_factory=TreeSettings)
    scale: ScaleRequest = field(default_factory=ScaleRequest)


@dataclass(frozen=True, kw_only=True)
class RunResult:
    """What a run left in its output folder.

    Attributes
    ----------
    out: the folder.
    plot: the content of ``plot.json``.
    stages: the record of every stage, in order; ``ran`` says which were done now.
    """

    out: Path
    plot: dict[str, Any]
    stages: tuple[StageRecord, ...]


@dataclass(frozen=True, kw_only=True)
class _Job:
    source: Path
    files: list[Path]
    out: Path
    settings: RunSettings
    model_sha256: str
    book: StageBook
    progress: StageProgress
    edits: tuple[TreeEdit, ...] = ()

    def scene(self) -> Scene:
        return read_scene(self.out / "scene")


def run(
    source: Path,
    out: Path,
    *,
    settings: RunSettings | None = None,
    edits: Path | None = None,
    progress: StageProgress = silent_stages,
) -> RunResult:
    """Do the whole job, going on from what an earlier run into ``out`` finished.

    Parameters
    ----------
    source: a folder of photographs, or a video.
    out: output folder, made if missing. Its layout is in docs/quickstart.md.
    settings: of all stages.
    edits: corrections of the stem map by hand; without it ``OUT/edits.csv``, where there is one.
    progress: gives the progress callback for a stage's name.

    Raises
    ------
    FsinferError
        Any stage's error. What was finished before stays, and the same call goes on from there.
    """
    source, out = Path(source), Path(out)
    settings = settings or RunSettings()
    files = source_files(source, out)
    # A wrong model name must not show after an hour of structure from motion.
    manifest = read_manifest(settings.depth.model)
    precision = choose_precision(settings.depth.precision, manifest, provider=settings.depth.provider)
    corrections = find_edits(out, edits)
    make_folder(out)
    job = _Job(
        source=source,
        files=files,
        out=out,
        settings=settings,
        model_sha256=manifest.sha256_of(int8=precision == INT8),
        book=StageBook(out),
        progress=progress,
        edits=corrections,
    )
    for stage in (_frames, _poses, _depth, _check, _fuse, _scale, _cloud, _trees):
        stage(job)
    _report(job)
    records = job.book.records
    plot = summarize(records, settings=_settings_json(job.settings), source=source.name)
    write_plot(out, plot)
    return RunResult(out=out, plot=plot, stages=tuple(records.values()))


def _frames(job: _Job) -> None:
    choose_frames(job.book, job.source, job.files, settings=job.settings.frames, progress=job.progress)


def _poses(job: _Job) -> None:
    place_photos(job.book, job.source, settings=job.settings.poses, progress=job.progress)


def _depth(job: _Job) -> None:
    def work() -> Mapping[str, Any]:
        result = estimate_depth(job.scene(), job.out, settings=job.settings.depth, progress=job.progress("depth"))
        return {
            "views": result.views,
            "model": result.model,
            "model_sha256": result.model_sha256,
            "precision": result.precision,
        }

    job.book.run(
        "depth",
        work,
        inputs={"settings": speedless(job.settings.depth), "model_sha256": job.model_sha256},
        after=["poses"],
        outputs=["depth", "confidence"],
        keeps_partial=True,
    )


def _check(job: _Job) -> None:
    def work() -> Mapping[str, Any]:
        scene = job.scene()
        return {"depth_vs_sfm_median_rel": check_depth(scene, read_sparse(scene.folder / "sparse"), job.out).median_rel}

    job.book.run("check", work, inputs={}, after=["poses", "depth"])


def _fuse(job: _Job) -> None:
    def work() -> Mapping[str, Any]:
        cloud = fuse(job.scene(), job.out, settings=job.settings.fusion, progress=job.progress("fuse"))
        write_cloud(job.out / "fused" / "cloud.ply", cloud)
        return {"points": len(cloud.xyz)}

    job.book.run(
        "fuse",
        work,
        # Of the memory only this shows in the cloud.
        inputs={
            "settings": speedless(job.settings.fusion),
            "most_points": most_points(job.scene(), job.out, settings=job.settings.fusion),
        },
        after=["poses", "depth"],
        outputs=["fused"],
    )


def _scale(job: _Job) -> None:
    def work() -> Mapping[str, Any]:
        request = job.settings.scale
        scale, warnings = find_scale(request, scene=job.scene(), progress=job.progress("scale"))
        doubts = doubt_endpoints(request, _plot_before(job.out)) + unknown_error(scale.source, scale.rel_std)
        return {**as_json(scale), "warnings": [*warnings, *doubts]}

    job.book.run("scale", work, inputs={"request": job.settings.scale}, after=["poses"])


def _plot_before(out: Path) -> dict[str, Any]:
    """``plot.json`` as an earlier run left it; {} where there is none, or a damaged one, which this run replaces."""
    try:
        return read_plot(out)
    except InputError:
        return {}


def _cloud(job: _Job) -> None:
    m_per_unit = job.book.records["scale"].result["m_per_unit"]

    def work() -> Mapping[str, Any]:
        report = job.progress("cloud")
        report(0, 3, "levelling")
        placed = place_cloud(read_cloud(job.out / "fused" / "cloud.ply"), job.scene(), m_per_unit=m_per_unit)
        for done, name in enumerate(("cloud.ply", "cloud.laz"), start=1):
            report(done, 3, f"writing {name}")
            write_cloud(job.out / name, placed.cloud)
        report(3, 3, "cloud")
        density = None if m_per_unit is None else density_per_m2(placed.cloud.xyz)
        return {
            "points": len(placed.cloud.xyz),
            "density_per_m2": density,
            "cloud_from_scene": placed.cloud_from_scene,
            "camera_height": placed.camera_height,
            "warnings": () if m_per_unit is None else doubt_height(placed.camera_height),
        }

    job.book.run(
        "cloud",
        work,
        inputs={"m_per_unit": m_per_unit, "versions": package_versions()["fsinfer"]},
        after=["poses", "fuse"],
        outputs=["cloud.ply", "cloud.laz"],
    )


def _trees(job: _Job) -> None:
    scale = job.book.records["scale"].result

    def work() -> Mapping[str, Any]:
        try:
            return write_tree_outputs(
                read_cloud(job.out / "cloud.ply"),
                job.out,
                settings=job.settings.trees,
                scale_rel_std=scale["rel_std"],
                metric=scale["m_per_unit"] is not None,
                camera_height=job.book.records["cloud"].result["camera_height"],
                marker_xyz=marker_centers(scale, job.book.records["cloud"].result["cloud_from_scene"]),
                edits=job.edits,
                photos=_stem_photos(job),
                progress=job.progress("trees"),
            )
        except CloudError as error:
            # A cloud without ground or stems is a result of the photographs: the report has to say so.
            return write_no_trees(job.out, reason=f"no trees measured: {error}")

    job.book.run(
        "trees",
        work,
        inputs={
            "settings": speedless(job.settings.trees),
            "rel_std": scale["rel_std"],
            "edits": job.edits,
            "versions": package_versions()["fsinfer"],
        },
        after=["poses", "depth", "cloud"],
        outputs=["trees.csv", "figures"],
    )


def _stem_photos(job: _Job) -> StemPhotos:
    return StemPhotos(
        scene=job.scene(),
        depth_folder=job.out,
        cloud_from_scene=np.asarray(job.book.records["cloud"].result["cloud_from_scene"], dtype=np.float64),
    )


def _report(job: _Job) -> None:
    # Without the times: they change when a stage that came out the same is repeated, and the report's own is unknown.
    plot = summarize(job.book.records, settings=_settings_json(job.settings), source=job.source.name)

    def work() -> Mapping[str, Any]:
        from fsinfer.report import make_report

        report = job.progress("report")
        report(0, 1, "report")
        write_plot(job.out, plot)
        make_report(job.out)
        report(1, 1, "report")
        return {}

    timeless = {key: value for key, value in plot.items() if key not in ("seconds", "peak_rss_mb")}
    job.book.run("report", work, inputs={"plot": timeless}, after=["trees"], outputs=["report.html"])


def _settings_json(settings: RunSettings) -> dict[str, Any]:
    return dict(as_json(settings))
