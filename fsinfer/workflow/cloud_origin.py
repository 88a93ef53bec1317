"""Where a cloud file comes from: the run, import or photographs beside it, and what they tell of its unit and scale."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import ScaleError, SceneError
from fsinfer.geometry.similarity import apply, scale_of
from fsinfer.importers.write import read_origin
from fsinfer.notices.capture import CaptureCode
from fsinfer.notices.notice import notice
from fsinfer.output.json_values import of_json
from fsinfer.scale.clicks.file import read_clicks
from fsinfer.scale.find import FoundScale, find_scale
from fsinfer.scale.request import ClickedLength, ScaleRequest
from fsinfer.scale.scale import UNKNOWN, MarkerDetails, Scale
from fsinfer.scene import Scene, read_scene
from fsinfer.silhouettes.join import StemPhotos
from fsinfer.workflow.cloud_stages import refuse_maps_of_before
from fsinfer.workflow.cloud_units import plot_of_cloud
from fsinfer.workflow.run_photos import photos_of_run
from fsinfer.workflow.summary import MODEL_UNITS

#: Links that lead to links, at most; then they lead round. Source: numerics; Linux follows 40.
_MOST_LINKS = 40
#: The median height of a scene's cameras in its cloud is what was noted then, but for this share of their extent.
#: Source: numerics; both are of the same numbers with twelve digits.
_SAME_HEIGHT = 1e-6


@dataclass(frozen=True, kw_only=True)
class CloudOrigin:
    """What is known of a cloud by what lies beside it; everything None where there is none."""

    units: str | None = None
    scale_rel_std: float | None = None
    camera_height: float | None = None
    cloud_from_scene: NDArray[np.float64] | None = None
    markers: Scale = UNKNOWN


def links_of(cloud_path: Path) -> tuple[Path, ...]:
    """The path of a cloud, and those that links lead to one after the other; the last is no link."""
    paths = [cloud_path]
    while paths[-1].is_symlink() and len(paths) < _MOST_LINKS:
        paths.append(paths[-1].parent / paths[-1].readlink())
    return tuple(paths)


def known_path(links: Sequence[Path]) -> Path:
    """Of :func:`links_of` the one beside which something is known of the cloud, or else the last.

    A link leads to a run's cloud, whose unit stands beside that; or it lies in a run's folder itself, whose cloud was
    moved to another disk. Points are read by the path as it was given: what a link leads to need not have a suffix.
    """
    return next((path for path in reversed(links) if plot_of_cloud(path.parent)), links[-1])


def origin_of_cloud(folder: Path) -> CloudOrigin:
    """What ``plot.json`` in the folder of a cloud tells of it."""
    plot = plot_of_cloud(folder)
    similarity = plot.get("cloud_from_scene")
    return CloudOrigin(
        units=plot.get("units"),
        scale_rel_std=plot.get("scale_rel_std"),
        camera_height=plot.get("camera_height"),
        cloud_from_scene=None if similarity is None else np.asarray(similarity, dtype=np.float64),
        markers=_markers(plot.get("scale_details")),
    )


def _markers(details: Any) -> Scale:
    """The markers that ``plot.json`` tells of."""
    try:
        return replace(UNKNOWN, details=of_json(MarkerDetails, details))
    except (TypeError, ValueError, KeyError):
        return UNKNOWN


def is_of_run(cloud_path: Path, origin: CloudOrigin) -> bool:
    """Whether the cloud is the one that a run or an import wrote into this folder."""
    return origin.cloud_from_scene is not None and cloud_path.name in ("cloud.ply", "cloud.laz")


def own_photos(cloud_path: Path, origin: CloudOrigin, factor: float) -> StemPhotos | None:
    """The photographs of the run that made the cloud, if they still lie beside it.

    Raises
    ------
    SceneError
        They, or their depth maps, were made once more since, and do not fit to the cloud or to each other.
    """
    folder = cloud_path.parent
    scene = (folder / "scene" / part for part in ("cams", "images", "pair.txt"))
    parts = (*scene, folder / "depth" / "depth.json", folder / "confidence")
    if not is_of_run(cloud_path, origin) or not all(part.exists() for part in parts):
        return None
    found = _scene_of(folder, origin)
    # A run with other photos that was stopped leaves maps in its unit, also where the places of before are back.
    refuse_maps_of_before(found, folder)
    scaled = np.diag([factor, factor, factor, 1.0]) @ origin.cloud_from_scene
    return photos_of_run(folder, found, scaled)


def _scene_of(folder: Path, origin: CloudOrigin) -> Scene:
    """The scene beside a cloud of this origin.

    Raises
    ------
    SceneError
        Its photos were placed once more since: in another frame and unit, in which the cloud is not.
    """
    scene = read_scene(folder / "scene")
    if origin.cloud_from_scene is None or origin.camera_height is None:
        return scene
    centers = np.array([view.camera.center for view in scene.views])
    height = float(np.median(apply(origin.cloud_from_scene, centers)[:, 2]))
    extent = float(np.ptp(centers, axis=0).max()) * scale_of(origin.cloud_from_scene)
    if abs(height - origin.camera_height) > _SAME_HEIGHT * extent:
        msg = (
            f"the photos in {folder / 'scene'} were placed once more after the cloud in {folder} was made, and their "
            "new places do not fit to it; give the last command there again to finish it (fsinfer run, or depth and "
            "fuse), or copy the cloud into a folder of its own, without its photos"
        )
        raise SceneError(msg)
    return scene


def cloud_scale(request: ScaleRequest, cloud_path: Path, out: Path, origin: CloudOrigin) -> FoundScale:
    """Metres per unit of the cloud file; unknown where nothing was asked for."""
    clicked = None if request.given else _clicks_of_import(cloud_path, out, origin)
    if clicked is not None:
        return _per_cloud(find_scale(replace(request, clicks=clicked), scene=_scene_of(out, origin)), origin)
    if not request.given:
        unscaled = origin.units == MODEL_UNITS
        return FoundScale(scale=UNKNOWN, warnings=(notice(CaptureCode.no_scale_given),) if unscaled else ())
    if request.aruco_length_m is None:
        return find_scale(request, scene=None)
    own = cloud_path.resolve().parent == out.resolve() and (out / "scene").is_dir()
    if origin.cloud_from_scene is None or not own:
        msg = (
            f"--aruco-length-m looks for markers in the photos, and {out} has no scene that {cloud_path} came from; "
            "use it with fsinfer run, or give --scale or --endpoints with --length-m"
        )
        raise ScaleError(msg)
    return _per_cloud(find_scale(request, scene=_scene_of(out, origin)), origin)


def _clicks_of_import(cloud_path: Path, out: Path, origin: CloudOrigin) -> ClickedLength | None:
    """The ends clicked in the photographs of a scene of another program, whose cloud this is; a run uses its own."""
    own = cloud_path.resolve().parent == out.resolve() and origin.cloud_from_scene is not None
    return read_clicks(out).used if own and read_origin(out / "scene") is not None else None


def _per_cloud(found: FoundScale, origin: CloudOrigin) -> FoundScale:
    if found.scale.m_per_unit is None or origin.cloud_from_scene is None:
        return found
    # Photographs give metres per unit of the scene; the cloud may have been scaled since.
    per_cloud = found.scale.m_per_unit / scale_of(origin.cloud_from_scene)
    return replace(found, scale=replace(found.scale, m_per_unit=per_cloud))
