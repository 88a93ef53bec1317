"""What the tree stage leaves in the output folder: tables, maps, labelled points, figures, and why there are none."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import OutputError
from fsinfer.progress import Progress, silent
from fsinfer.scale.scale import CAMERA_HEIGHT_M
from fsinfer.trees.outputs.workbook import write_tables
from fsinfer.trees.posts import without_posts

if TYPE_CHECKING:
    from fsinfer.io.cloud import PointCloud
    from fsinfer.silhouettes.join import StemPhotos
    from fsinfer.trees import PlotResult, TreeSettings
    from fsinfer.trees.edits import TreeEdit

# Everything but trees.csv and the figures: what an earlier measurement in metres may have left.
MAPS = ("trees.gpkg", "trees.geojson", "trees.laz", "trees.xlsx", "stem_curve.csv", "dbh_sources.csv")


def write_tree_outputs(
    cloud: PointCloud,
    out: Path,
    *,
    settings: TreeSettings,
    scale_rel_std: float | None = None,
    metric: bool = True,
    camera_height: float | None = None,
    marker_xyz: NDArray[np.float64] | None = None,
    epsg: int | None = None,
    write_labelled: Callable[[Path, PlotResult], None] | None = None,
    edits: Sequence[TreeEdit] = (),
    photos: StemPhotos | None = None,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Measure the trees of a cloud (z up) and write table, maps, labelled points and figures into ``out``.

    Parameters
    ----------
    cloud: z up; metres, or model units with ``metric=False``: then the trees get positions and no DBH.
    out: receives ``trees.csv`` and ``figures/*.png``, and in metres ``trees.gpkg`` (``trees.geojson`` too where the
        frame is of WGS84) and ``trees.laz``, the cloud with a ``TreeID``, ``stem_curve.csv`` and ``trees.xlsx`` (all
        tables as sheets), with ``photos`` also ``dbh_sources.csv`` and ``figures/*_edges.png``; what an earlier
        measurement left is removed.
    settings: of the measurement.
    scale_rel_std: relative standard deviation of the scale, if known; it widens every interval.
    camera_height: median height of the cameras above the ground, in units of the cloud; a person holds a camera at
        about 1.5 m, which tells roughly how large the trees are while the scale is unknown.
    marker_xyz: (M, 3) centres of the markers that gave the scale, in the cloud's frame: see :func:`without_posts`.
    epsg: code of the cloud's horizontal frame; None for local metres.
    edits: corrections by hand (:mod:`fsinfer.trees.edits`), applied to what was found.
    photos: those the cloud was made of; the stems' edges in them make the diameters sharper (metres only).
    write_labelled: writes ``trees.laz`` instead, for a cloud of which only a part is in memory.

    Returns
    -------
    JSON values: ``trees``, ``trees_with_dbh``, ``ground_method``, ``diagnosis``, ``stand`` (the stand table),
    ``plot_area_m2`` (None when unknown), and ``warnings``, which repeat the diagnosis when no tree was found.

    Raises
    ------
    CloudError
        The cloud holds no plot: too few points, no ground, or a size that cannot be in metres.
    """
    from fsinfer.io.cloud import write_cloud
    from fsinfer.trees import analyse_plot
    from fsinfer.trees.outputs.figures import write_figures
    from fsinfer.trees.outputs.labels import label_points
    from fsinfer.trees.outputs.maps import write_maps
    from fsinfer.trees.outputs.table import write_trees
    from fsinfer.trees.stem_curve import stem_curves, write_curves

    hint = None if camera_height is None or camera_height <= 0 else camera_height / CAMERA_HEIGHT_M
    result = analyse_plot(
        cloud.xyz,
        settings=settings,
        scale_rel_std=scale_rel_std or 0.0,
        metric=metric,
        units_per_m_hint=None if metric else hint,
        turned=camera_height is not None,
        progress=progress,
    )
    if marker_xyz is not None and metric:
        result = without_posts(result, marker_xyz)
    found = set(result.trees)
    if edits:
        from fsinfer.trees.edits import apply_edits

        result = apply_edits(
            result, cloud.xyz, edits, settings=settings, scale_rel_std=scale_rel_std or 0.0, metric=metric
        )
    _clear_figures(out)
    _clear_maps(out)
    if photos is not None and metric:
        from fsinfer.silhouettes.join import measure_silhouettes, write_sources

        result = measure_silhouettes(
            result,
            photos,
            scale_rel_std=scale_rel_std or 0.0,
            dbh=settings.dbh,
            figures=out / "figures",
            kept={tree.tree_id for tree in result.trees if tree not in found},  # by hand: a person knows better
            progress=progress,
        )
        write_sources(out / "dbh_sources.csv", result)
    write_trees(out / "trees.csv", result.trees)
    curves = stem_curves(cloud.xyz, result) if metric else {}
    write_figures(out / "figures", result, curves=curves)
    if metric:
        write_curves(out / "stem_curve.csv", curves.values())
        write_tables(out / "trees.xlsx", result, curves)
        write_maps(out, result.trees, epsg=epsg)
        if write_labelled is None:
            labels = label_points(cloud.xyz, result)
            write_cloud(out / "trees.laz", replace(cloud, extra=cloud.extra | {"TreeID": labels}))
        else:
            write_labelled(out / "trees.laz", result)
    return {
        "trees": len(result.trees),
        "trees_with_dbh": sum(tree.dbh_cm is not None for tree in result.trees),
        "trees_with_silhouette": sum(section.silhouette is not None for section in result.sections),
        "ground_method": None if result.ground is None else result.ground.method,
        "diagnosis": result.diagnosis,
        "stand": asdict(result.stand),
        "plot_area_m2": result.plot_area_m2 or None,
        "warnings": [*result.warnings, *(() if result.trees else (result.diagnosis,))],
    }


def write_no_trees(out: Path, *, reason: str) -> dict[str, Any]:
    """Write an empty ``trees.csv`` where measuring is impossible; returns what :func:`write_tree_outputs` does."""
    from fsinfer.trees.outputs.table import write_trees

    write_trees(out / "trees.csv", [])
    _clear_figures(out)
    _clear_maps(out)
    nothing = {"ground_method": None, "stand": None, "plot_area_m2": None}
    return {
        "trees": 0,
        "trees_with_dbh": 0,
        "trees_with_silhouette": 0,
        **nothing,
        "diagnosis": reason,
        "warnings": [reason],
    }


def _clear_figures(out: Path) -> None:
    _remove((out / "figures").glob("*.png"))


def _clear_maps(out: Path) -> None:
    _remove(path for name in MAPS if (path := out / name).is_file())


def _remove(paths: Iterable[Path]) -> None:
    for path in paths:
        try:
            path.unlink()
        except OSError as error:
            msg = f"cannot remove the old {path}: {error.strerror or error}; close the program that shows it"
            raise OutputError(msg) from error
