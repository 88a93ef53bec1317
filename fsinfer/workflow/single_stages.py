"""The work behind ``fsinfer fuse`` and ``fsinfer trees``: single stages on folders and files of any origin."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fsinfer.errors import CloudError, ScaleError
from fsinfer.io.chunks import open_chunks
from fsinfer.io.cloud import PointCloud, read_cloud, write_cloud
from fsinfer.io.files import make_folder
from fsinfer.io.las import read_epsg
from fsinfer.output.json_values import as_json
from fsinfer.output.plot_json import package_versions, read_plot
from fsinfer.placement.place import PlacedCloud, density_per_m2, place_cloud, transform_cloud
from fsinfer.progress import Progress, silent
from fsinfer.scale.find import NO_SCALE, find_scale
from fsinfer.scale.request import ScaleRequest
from fsinfer.scale.scale import marker_centers
from fsinfer.scene import read_scene
from fsinfer.silhouettes.join import StemPhotos
from fsinfer.trees.edits import find_edits
from fsinfer.trees.outputs.labels import write_labelled
from fsinfer.trees.sanity import TurnedCloudError
from fsinfer.trees.thinning import ThinningSettings, thin_while_reading
from fsinfer.workflow.ledger import RECORDS_FOLDER
from fsinfer.workflow.summary import no_scale_once, update_plot
from fsinfer.workflow.tree_stage import write_tree_outputs

if TYPE_CHECKING:
    from fsinfer.scale.scale import Scale
    from fsinfer.trees import TreeSettings

MODEL_UNITS = "model units"
SCENE_UNITS = "scene units"
TREE_VALUES = (
    "trees",
    "trees_with_dbh",
    "trees_with_silhouette",
    "ground_method",
    "diagnosis",
    "stand",
    "plot_area_m2",
)


def fuse_scene(scene_folder: Path, out: Path, *, level: bool | None = None, progress: Progress = silent) -> int:
    """Fuse the depth maps in ``out`` and write ``cloud.ply``, ``cloud.laz`` and what is known to ``plot.json``.

    Parameters
    ----------
    scene_folder: scene in MVSNet format.
    out: holds ``depth/`` and ``confidence/``.
    level: turn the cloud z up. None does so for a scene made by ``fsinfer poses``, whose axes mean nothing, and keeps
        the coordinates of any other scene, whose axes may.

    Returns
    -------
    The number of points.
    """
    from fsinfer.fusion.fuse import fuse

    start = time.perf_counter()
    scene = read_scene(scene_folder)
    ours = (scene_folder / "poses.json").is_file()
    cloud = fuse(scene, out, progress=progress)
    placed = PlacedCloud(cloud=cloud, cloud_from_scene=np.eye(4))
    levelled = ours if level is None else level
    if levelled:
        placed = place_cloud(cloud, scene)
    write_cloud(out / "cloud.ply", placed.cloud)
    write_cloud(out / "cloud.laz", placed.cloud)
    summary = {
        # The scenes of others may well be in metres; those of our own structure from motion never are.
        "units": MODEL_UNITS if ours else SCENE_UNITS,
        "scale_m_per_unit": None,
        "scale_source": "none",
        "points": len(cloud.xyz),
        "density_per_m2": None,
        "cloud_from_scene": as_json(placed.cloud_from_scene),
        "camera_height": placed.camera_height,
        "versions": package_versions(),
    }
    seconds = time.perf_counter() - start
    update_plot(out, source=scene_folder.name, stage="fuse", seconds=seconds, values=summary)
    return len(cloud.xyz)


def measure_cloud_file(
    cloud_path: Path,
    out: Path,
    *,
    request: ScaleRequest,
    settings: TreeSettings,
    thinning: ThinningSettings | None = None,
    edits: Path | None = None,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Measure the trees of a cloud file (z up) into ``out``.

    Files of more than ``thinning.max_points`` points are read in pieces and thinned, which the warnings say.

    ``edits`` are corrections of the stem map by hand; without it ``edits.csv`` in ``out``, where there is one.

    The cloud is taken to be in metres, unless ``plot.json`` beside it says that it has no scale and none is given
    here: then trees get positions in model units and no DBH, and the warnings say why.

    Raises
    ------
    CloudError
        The file is no cloud.
    ScaleError
        ArUco markers were asked for, and ``out`` has no scene that the cloud came from.
    """
    start = time.perf_counter()
    if cloud_path.parent.name == "fused" and (cloud_path.parent.parent / RECORDS_FOLDER).is_dir():
        finished = cloud_path.parent.parent / "cloud.ply"
        msg = f"{cloud_path} is what a run made before it knew what is up and how long a metre is; give {finished}"
        raise CloudError(msg)
    thinning = thinning or ThinningSettings()
    corrections = find_edits(out, edits)
    chunked = open_chunks(cloud_path)
    large = chunked if chunked is not None and chunked.points > thinning.max_points else None
    origin = read_plot(cloud_path.parent)
    scale, warnings = _cloud_scale(request, cloud_path, out, origin)
    make_folder(out)
    # Nothing said and nothing known to the contrary: other people's clouds are in metres.
    metric = scale.m_per_unit is not None or origin.get("units") != MODEL_UNITS
    factor = scale.m_per_unit or 1.0
    if large is None:
        cloud = read_cloud(cloud_path)
        points = len(cloud.xyz)
        if factor != 1.0:
            cloud = transform_cloud(cloud, np.diag([factor, factor, factor, 1.0]))
    else:
        large = replace(large, factor=factor)
        thinned = thin_while_reading(large, settings=thinning, progress=progress)
        cloud, points = PointCloud(xyz=thinned.xyz), thinned.total
        warnings = (*warnings, *thinned.warnings)
    photos = _own_photos(cloud_path, origin, factor)
    measure = partial(
        write_tree_outputs,
        out=out,
        settings=settings,
        scale_rel_std=scale.rel_std if scale.rel_std is not None else origin.get("scale_rel_std"),
        metric=metric,
        camera_height=origin.get("camera_height"),
        write_labelled=None if large is None else partial(write_labelled, large),
        edits=corrections,
        marker_xyz=None if photos is None else marker_centers(_scale_record(origin), photos.cloud_from_scene.tolist()),
        photos=photos,
        progress=progress,
    )
    # A cloud that had to be scaled is not in the frame that its header names, nor is one that had to be turned.
    epsg = read_epsg(cloud_path) if cloud_path.suffix.lower() in (".las", ".laz") and factor == 1.0 else None
    try:
        result = measure(cloud, epsg=epsg)
    except TurnedCloudError as error:
        if large is not None or photos is not None:
            raise
        turn = np.eye(4)
        turn[:3, :3] = error.turn
        cloud = transform_cloud(cloud, turn)
        warnings = (*warnings, error.warning)
        result = measure(cloud)
    result["warnings"] = [*warnings, *no_scale_once(warnings, result["warnings"])]
    values = {key: result[key] for key in TREE_VALUES}
    values["trees_scale"] = {"m_per_unit": scale.m_per_unit, "source": scale.source, "rel_std": scale.rel_std}
    before = read_plot(out)
    own_cloud = cloud_path.resolve().parent == out.resolve()
    # A cloud of unknown unit that was measured as it is was taken to be in metres.
    if not own_cloud or "units" not in before or (before["units"] == SCENE_UNITS and factor == 1.0):
        values |= {"units": "m" if metric else MODEL_UNITS, "points": points, "versions": package_versions()}
        density = density_per_m2(cloud.xyz) if metric else None
        # Thinning leaves something in every cell: the area is that of the whole cloud.
        density = None if density is None else density * points / len(cloud.xyz)
        values |= {"density_per_m2": density, "warnings": result["warnings"]}
    seconds = time.perf_counter() - start
    update_plot(out, source=cloud_path.name, stage="trees", seconds=seconds, values=values)
    return result


def _own_photos(cloud_path: Path, origin: dict[str, Any], factor: float) -> StemPhotos | None:
    """Return the photographs of the run that made the cloud, if they still lie beside it."""
    folder = cloud_path.parent
    cloud_from_scene = origin.get("cloud_from_scene")
    scene = (folder / "scene" / part for part in ("cams", "images", "pair.txt"))
    parts = (*scene, folder / "depth" / "depth.json", folder / "confidence")
    known = cloud_from_scene is not None and cloud_path.name in ("cloud.ply", "cloud.laz")
    if not known or not all(part.exists() for part in parts):
        return None
    scaled = np.diag([factor, factor, factor, 1.0]) @ np.asarray(cloud_from_scene, dtype=np.float64)
    return StemPhotos(scene=read_scene(folder / "scene"), depth_folder=folder, cloud_from_scene=scaled)


def _scale_record(origin: dict[str, Any]) -> dict[str, Any]:
    return {"details": origin.get("scale_details") or {}}


def _cloud_scale(
    request: ScaleRequest, cloud_path: Path, out: Path, origin: dict[str, Any]
) -> tuple[Scale, tuple[str, ...]]:
    """Metres per unit of the cloud file, with warnings; ``m_per_unit`` is None where nothing was asked for."""
    from fsinfer.scale.scale import Scale

    if not request.given:
        nothing = Scale(m_per_unit=None, source="none", rel_std=None, details={})
        return nothing, (NO_SCALE,) if origin.get("units") == MODEL_UNITS else ()
    if request.aruco_length_m is None:
        return find_scale(request, scene=None)
    cloud_from_scene = origin.get("cloud_from_scene")
    if cloud_from_scene is None or not (out / "scene").is_dir() or cloud_path.resolve().parent != out.resolve():
        msg = (
            f"--aruco-length-m looks for markers in the photos, and {out} has no scene that {cloud_path} came from; "
            "use it with fsinfer run, or give --scale or --endpoints with --length-m"
        )
        raise ScaleError(msg)
    scale, warnings = find_scale(request, scene=read_scene(out / "scene"))
    if scale.m_per_unit is None:
        return scale, warnings
    # The markers give metres per unit of the scene; the cloud may have been scaled since.
    cloud_per_scene = float(np.cbrt(np.linalg.det(np.asarray(cloud_from_scene)[:3, :3])))
    return replace(scale, m_per_unit=scale.m_per_unit / cloud_per_scene), warnings
