"""``plot.json`` from the results of the stages."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fsinfer.depth.sfm_check import DepthCheck
from fsinfer.depth.stage import DepthResult
from fsinfer.frames.select import FramesResult
from fsinfer.notices.capture import NO_SCALE
from fsinfer.notices.notice import Notice, notice_json, notice_of_json
from fsinfer.notices.plots import PlotCode
from fsinfer.notices.sentences import is_remark, sentence
from fsinfer.notices.stems import StemCode
from fsinfer.output.json_values import as_json
from fsinfer.output.plot_json import finite, package_versions, read_plot, write_plot
from fsinfer.poses.estimate import PosesResult
from fsinfer.scale.find import FoundScale
from fsinfer.workflow.cloud_stages import FusedCloud, PlotCloud
from fsinfer.workflow.ledger import StageRecord
from fsinfer.workflow.parts import PartResult, folders_of_parts
from fsinfer.workflow.trees_result import TreesResult

MODEL_UNITS = "model units"
SCENE_UNITS = "scene units"
#: Codes of what the tree stage warns of.
OF_TREES = frozenset(code.value for kind in (StemCode, PlotCode) for code in kind)
#: What figures a hectare are of, in ``plot.json``.
SEEN_GROUND, WITHIN_BORDER = "seen ground only", "the plot within its border"
#: Keys of ``plot.json``, in its order; those that are not known are null.
PLOT_KEYS = (
    "source", "photos_given", "rejected", "photos", "registered", "left_out", "units", "scale_m_per_unit",
    "scale_source", "scale_rel_std", "scale_details", "cloud_from_scene", "camera_height", "points", "density_per_m2",
    "depth_vs_sfm_median_rel", "ground_method", "trees", "trees_with_dbh", "trees_with_silhouette", "diagnosis",
    "stand", "plot_area_m2", "seconds", "peak_rss_mb", "versions", "made_by", "model", "model_sha256",
    "model_precision", "warnings", "warning_codes", "settings", "per_hectare_of", "plot_border", "trees_outside",
    "parts",
)  # fmt: skip

#: Of these, what is of the photographs that a cloud was made of, and of what was warned of on the way to it.
PHOTO_KEYS = (
    "source", "photos_given", "rejected", "photos", "registered", "left_out", "depth_vs_sfm_median_rel", "model",
    "model_sha256", "model_precision", "warnings", "warning_codes", "parts",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class PlotRecords:
    """The records of all stages but the report, in the order of their run."""

    frames: StageRecord[FramesResult]
    poses: StageRecord[PosesResult]
    depth: StageRecord[DepthResult]
    check: StageRecord[DepthCheck]
    fuse: StageRecord[FusedCloud]
    scale: StageRecord[FoundScale]
    cloud: StageRecord[PlotCloud]
    trees: StageRecord[TreesResult]

    @property
    def in_order(self) -> tuple[StageRecord[Any], ...]:
        """As the stages ran."""
        return (
            self.frames, self.poses, self.depth, self.check, self.fuse, self.scale, self.cloud, self.trees,
        )  # fmt: skip


def summarize(
    records: PlotRecords,
    *,
    settings: Mapping[str, Any],
    source: str,
    parts: Sequence[PartResult] = (),
    report: StageRecord[Any] | None = None,
) -> dict[str, Any]:
    """Put the results of the stages together.

    Parameters
    ----------
    records: of the stages.
    settings: of all stages, JSON values.
    source: name of the photo folder or video, without its path.
    parts: of the walk, measured apart.
    report: record of the report, once it is written.

    Returns
    -------
    The content of ``plot.json``. ``photos`` went into the poses stage, after the ``rejected`` ones were taken out;
    ``left_out`` are those of them without a pose. ``units`` is "m", or "model units" while no scale is known.
    ``density_per_m2`` is points over the plan area of the occupied 0.25 m cells. ``cloud_from_scene`` is the 4x4
    similarity from the scene's coordinates to those of cloud.ply; ``camera_height`` is in units of the cloud.
    ``depth_vs_sfm_median_rel`` is the median of |depth - SfM depth| / SfM depth over well-observed tie points.
    ``warning_codes`` are the ``warnings`` with their codes and values, in the same order; ``made_by`` is the version of
    fsinfer that did each stage, which may be older than that in ``versions``. ``stand`` is of the seen ground in any
    case; ``plot_border`` holds the plot within its border and its figures a hectare, and ``per_hectare_of`` says
    which of the two is the plot. ``parts`` were measured apart; ``joined`` tells how one lies in the plot whose stems
    are in its tables, and is null for one that stands alone.
    """
    frames, poses, scale = records.frames.result, records.poses.result, records.scale.result.scale
    cloud, trees, depth = records.cloud.result, records.trees.result, records.depth.result
    joined = {part.name: part for part in trees.joined}
    done = (*records.in_order, *(() if report is None else (report,)))
    seconds = {record.name: record.seconds for record in done}
    peaks = [record.peak_rss_mb for record in done if record.peak_rss_mb is not None]
    plot = {
        "source": source,
        "photos_given": len(frames.rows),
        "rejected": [{"name": row.name, "reason": row.reason} for row in frames.rows if not row.kept],
        "photos": poses.photos,
        "registered": poses.registered,
        "left_out": poses.left_out,
        "units": MODEL_UNITS if scale.m_per_unit is None else "m",
        "scale_m_per_unit": scale.m_per_unit,
        "scale_source": scale.source,
        "scale_rel_std": scale.rel_std,
        "scale_details": {} if scale.details is None else scale.details,
        "cloud_from_scene": cloud.cloud_from_scene,
        "camera_height": cloud.camera_height,
        "points": cloud.points,
        "density_per_m2": cloud.density_per_m2,
        "depth_vs_sfm_median_rel": records.check.result.median_rel,
        **tree_values(trees),
        "seconds": seconds | {"total": round(sum(seconds.values()), 3)},
        "peak_rss_mb": max(peaks, default=None),
        "versions": package_versions(),
        "made_by": {record.name: record.made_by for record in done},
        "model": depth.model,
        "model_sha256": depth.model_sha256,
        "model_precision": depth.precision,
        **warning_values(all_warnings(records, joined)),
        "settings": dict(settings),
        **border_values(trees),
        "parts": [as_json(part) | {"joined": as_json(joined.get(part.folder))} for part in parts],
    }
    return dict(finite(as_json(plot)))


def tree_values(trees: TreesResult) -> dict[str, Any]:
    """What ``plot.json`` tells of the trees."""
    return {
        "ground_method": trees.ground_method,
        "trees": trees.trees,
        "trees_with_dbh": trees.trees_with_dbh,
        "trees_with_silhouette": trees.trees_with_silhouette,
        "diagnosis": sentence(trees.diagnosis),
        "stand": trees.stand,
        "plot_area_m2": trees.plot_area_m2,
    }


def border_values(trees: TreesResult) -> dict[str, Any]:
    """What ``plot.json`` tells of the borders of plot and walk, and what figures a hectare are of."""
    return {
        "per_hectare_of": SEEN_GROUND if trees.plot is None else WITHIN_BORDER,
        "plot_border": trees.plot,
        "trees_outside": trees.trees_outside,
    }


def warning_values(warnings: Iterable[Notice]) -> dict[str, Any]:
    """``warnings`` as sentences, and ``warning_codes`` as codes with values."""
    given = tuple(warnings)
    codes = [notice_json(item) | {"text": sentence(item), "remark": is_remark(item)} for item in given]
    return {"warnings": [sentence(item) for item in given], "warning_codes": codes}


def all_warnings(records: PlotRecords, joined: Collection[str] = ()) -> tuple[Notice, ...]:
    """What all stages warn of; that there is no scale is said once, by the stage that looked for one.

    Of the parts that the poses left apart those in ``joined`` (their folders) were tied to the rest later.
    """
    found = records.scale.result.warnings
    apart = folders_of_parts(records.poses.result)
    return (
        *records.frames.result.warnings,
        *(told for told in records.poses.result.warnings if apart.get(told) not in joined),
        *records.depth.result.warnings,
        *found,
        *records.cloud.result.warnings,
        *no_scale_once(found, records.trees.result.warnings),
    )


def of_other_stages(plot: Mapping[str, Any]) -> tuple[Notice, ...]:
    """What the stages before that of the trees warned of, by a ``plot.json``."""
    told = plot.get("warning_codes")
    entries = told if isinstance(told, list) else []
    notices = [notice_of_json(entry) for entry in entries]
    return tuple(item for item in notices if item.code not in OF_TREES)


def no_scale_once(said: Iterable[Notice], more: Iterable[Notice]) -> tuple[Notice, ...]:
    """Warnings ``more``, without that there is no scale where it was ``said`` already."""
    told = any(item.code in NO_SCALE for item in said)
    return tuple(item for item in more if not (told and item.code == StemCode.model_units))


def update_plot(out: Path, *, source: str, stage: str, seconds: float, values: Mapping[str, Any]) -> dict[str, Any]:
    """Put what a single command found into ``plot.json``, which need not exist yet; return its new content."""
    plot = read_plot(out) or dict.fromkeys(PLOT_KEYS) | {
        "source": source,
        "units": MODEL_UNITS,
        "scale_source": "none",
        "versions": package_versions(),
        "settings": {},
        **warning_values(()),
    }
    times = {key: value for key, value in (plot.get("seconds") or {}).items() if key != "total"}
    times[stage] = round(seconds, 3)
    plot |= dict(values) | {"seconds": times | {"total": round(sum(times.values()), 3)}}
    write_plot(out, plot)
    return plot
