"""``plot.json``: one file that says what a run found, how, with what, and how long it took."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from fsinfer.output.json_values import as_json
from fsinfer.output.plot_json import finite, package_versions, read_plot, write_plot
from fsinfer.workflow.ledger import StageRecord


def summarize(records: Mapping[str, StageRecord], *, settings: Mapping[str, Any], source: str) -> dict[str, Any]:
    """Put the results of the stages together.

    Parameters
    ----------
    records: by stage name, in the order they ran; stages that are missing leave their keys ``None``.
    settings: of all stages, JSON values.
    source: name of the photo folder or video, without its path.

    Returns
    -------
    The content of ``plot.json``. ``photos`` went into the poses stage, after the ``rejected`` ones were taken out;
    ``left_out`` are those of them without a pose. ``units`` is "m", or "model units" while no scale is known.
    ``density_per_m2`` is points over the plan area of the occupied 0.25 m cells. ``cloud_from_scene`` is the 4x4
    similarity from the scene's coordinates to those of cloud.ply; ``camera_height`` is in units of the cloud.
    ``depth_vs_sfm_median_rel`` is the median of |depth - SfM depth| / SfM depth over well-observed SfM points.
    """
    results: dict[str, dict[str, Any]] = {name: record.result for name, record in records.items()}

    def value(stage: str, key: str) -> Any:
        return results.get(stage, {}).get(key)

    seconds = {name: record.seconds for name, record in records.items()}
    peaks = [record.peak_rss_mb for record in records.values() if record.peak_rss_mb is not None]
    plot = {
        "source": source,
        "photos_given": value("frames", "given"),
        "rejected": value("frames", "rejected"),
        "photos": value("poses", "photos"),
        "registered": value("poses", "registered"),
        "left_out": value("poses", "left_out"),
        "units": "model units" if value("scale", "m_per_unit") is None else "m",
        "scale_m_per_unit": value("scale", "m_per_unit"),
        "scale_source": value("scale", "source") or "none",
        "scale_rel_std": value("scale", "rel_std"),
        "scale_details": value("scale", "details"),
        "cloud_from_scene": value("cloud", "cloud_from_scene"),
        "camera_height": value("cloud", "camera_height"),
        "points": value("cloud", "points"),
        "density_per_m2": value("cloud", "density_per_m2"),
        "depth_vs_sfm_median_rel": value("check", "depth_vs_sfm_median_rel"),
        "ground_method": value("trees", "ground_method"),
        "trees": value("trees", "trees"),
        "trees_with_dbh": value("trees", "trees_with_dbh"),
        "trees_with_silhouette": value("trees", "trees_with_silhouette"),
        "diagnosis": value("trees", "diagnosis"),
        "stand": value("trees", "stand"),
        "plot_area_m2": value("trees", "plot_area_m2"),
        "seconds": seconds | {"total": round(sum(seconds.values()), 3)},
        "peak_rss_mb": max(peaks, default=None),
        "versions": package_versions(),
        "model": value("depth", "model"),
        "model_sha256": value("depth", "model_sha256"),
        "model_precision": value("depth", "precision"),
        "warnings": _warnings(results),
        "settings": dict(settings),
    }
    return dict(finite(as_json(plot)))


def _warnings(results: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """What all stages warn of; that there is no scale is said once, by the stage that looked for one."""
    said = results.get("scale", {}).get("warnings") or ()
    texts: list[str] = []
    for name, result in results.items():
        own = result.get("warnings") or ()
        texts += no_scale_once(said, own) if name == "trees" else own
    return texts


def no_scale_once(said: Iterable[str], more: Iterable[str]) -> list[str]:
    """Warnings ``more``, without that there is no scale where it was ``said`` already."""
    told = any(text.startswith("no scale") for text in said)
    return [text for text in more if not (told and text.startswith("no scale"))]


def update_plot(out: Path, *, source: str, stage: str, seconds: float, values: Mapping[str, Any]) -> dict[str, Any]:
    """Put what a single command found into ``plot.json``, which need not exist yet; return its new content."""
    plot = read_plot(out) or summarize({}, settings={}, source=source)
    times = {key: value for key, value in (plot.get("seconds") or {}).items() if key != "total"}
    times[stage] = round(seconds, 3)
    plot |= dict(values) | {"seconds": times | {"total": round(sum(times.values()), 3)}}
    write_plot(out, plot)
    return plot
