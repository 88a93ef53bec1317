"""Single stages on folders and files of any origin, entered in the ledger of their output folder as those of a run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fsinfer.depth.maps import maps_digest
from fsinfer.depth.settings import DepthSettings
from fsinfer.depth.stage import DepthResult
from fsinfer.errors import ImageError
from fsinfer.frames.select import FrameSettings, FramesResult, list_captures
from fsinfer.fusion.fuse import FusionSettings, fuse, most_points
from fsinfer.importers.write import read_origin
from fsinfer.io.cloud import write_cloud
from fsinfer.io.files import make_folder
from fsinfer.output.json_values import as_json
from fsinfer.output.plot_json import OF_FILE, of_file, package_versions, read_plot
from fsinfer.placement.place import PlacedCloud, place_cloud
from fsinfer.poses.estimate import PosesResult
from fsinfer.poses.settings import PoseSettings
from fsinfer.progress import StageProgress, silent_stages
from fsinfer.scale.markers_seen import FILE as MARKERS_SEEN
from fsinfer.scene import read_scene, scene_digest
from fsinfer.threads import one_blas_thread
from fsinfer.workflow.camera_size import refuse_cameras_of_other_size
from fsinfer.workflow.cloud_stages import compute_depth, model_digest, refuse_maps_of_before, require_workers
from fsinfer.workflow.ledger import Ledger, Stage, StageRecord
from fsinfer.workflow.own_files import refuse_clouds_of_others
from fsinfer.workflow.photo_stages import choose_frames, register_photos, require_poses
from fsinfer.workflow.scene_source import imported_scene, our_scene
from fsinfer.workflow.settings import speedless
from fsinfer.workflow.summary import MODEL_UNITS, PHOTO_KEYS, SCENE_UNITS, update_plot


@dataclass(frozen=True, kw_only=True)
class SceneCloud:
    """A cloud fused of a scene by itself, in scene units: see :class:`fsinfer.placement.place.PlacedCloud`."""

    points: int
    cloud_from_scene: NDArray[np.float64]
    camera_height: float | None


FUSE_SCENE = Stage(name="fuse_scene", version=5, result=SceneCloud, outputs=("cloud.ply", "cloud.laz"))


def frames_of(
    source: Path, out: Path, *, settings: FrameSettings, progress: StageProgress = silent_stages
) -> StageRecord[FramesResult]:
    """``fsinfer frames``: choose frames into ``out/images``, unless that was done before.

    Raises
    ------
    ImageError
        The source is missing, or lies where the frames would go.
    """
    if not source.exists():
        msg = f"{source} does not exist; give a folder of photos or a video file"
        raise ImageError(msg)
    _refuse_overwriting(source, out, "the chosen frames")
    files = list_captures(source)
    return choose_frames(
        Ledger(make_folder(out)),
        source,
        files,
        settings=settings,
        folder=out,
        outputs=("images", "frames.csv"),
        progress=progress,
    )


@one_blas_thread()
def poses_of(
    images: Path, out: Path, *, settings: PoseSettings, progress: StageProgress = silent_stages
) -> StageRecord[PosesResult]:
    """``fsinfer poses``: register the photos of a folder and write ``out`` as a scene, unless that was done before."""
    _refuse_overwriting(images, out, "the scene")
    list_captures(images)  # a folder without photos is told before anything is written
    require_poses(out)
    return register_photos(
        Ledger(make_folder(out)),
        images,
        settings=settings,
        folder=out,
        outputs=("images", "cams", "pair.txt", "sparse", "work", "poses.json", MARKERS_SEEN),
        progress=progress,
    )


@one_blas_thread()
def depth_of(
    source: Path,
    out: Path,
    *,
    settings: DepthSettings,
    images: Path | None = None,
    progress: StageProgress = silent_stages,
) -> StageRecord[DepthResult]:
    """``fsinfer depth``: depth and confidence of every view of a scene, unless that was done before.

    A scene of another program is made a scene folder in ``OUT/scene`` first; ``images`` is the folder of its
    photographs, where they do not lie beside it.
    """
    model_digest(settings)  # a wrong name must not show after the images are undistorted
    require_workers(settings)
    folder = our_scene(source, out, images=images, progress=progress)
    scene = read_scene(folder)
    if folder == source:  # of other programs the size that a camera belongs to is known
        refuse_cameras_of_other_size(scene)
    return compute_depth(Ledger(make_folder(out)), scene, settings=settings, progress=progress)


@one_blas_thread()
def fuse_scene(
    scene_folder: Path,
    out: Path,
    *,
    level: bool | None = None,
    settings: FusionSettings | None = None,
    progress: StageProgress = silent_stages,
) -> StageRecord[SceneCloud]:
    """``fsinfer fuse``: write ``cloud.ply``, ``cloud.laz`` and what is known to ``plot.json``.

    Parameters
    ----------
    scene_folder: scene in MVSNet format, or the scene of another program that ``out`` was made of.
    out: holds ``depth/`` and ``confidence/``.
    level: turn the cloud z up. None does so for a scene made by ``fsinfer poses`` or imported from a format whose axes
        mean nothing, and keeps the coordinates of any other scene, whose axes may.

    Raises
    ------
    SceneError
        The depth maps are missing, or were computed of what the scene was before it changed.
    CloudError
        No two of them agree on anything.
    """
    settings = settings or FusionSettings()
    refuse_clouds_of_others(out)
    scene_folder = imported_scene(scene_folder, out)
    scene = read_scene(scene_folder)
    refuse_maps_of_before(scene, out)
    origin = read_origin(scene_folder)
    ours = (scene_folder / "poses.json").is_file()
    metric = origin is not None and origin.metric
    levelled = (ours or (origin is not None and not origin.z_up)) if level is None else level

    def work(_resume: bool) -> SceneCloud:
        cloud = fuse(scene, out, settings=settings, progress=progress("fuse"))
        placed = place_cloud(cloud, scene) if levelled else PlacedCloud(cloud=cloud, cloud_from_scene=np.eye(4))
        for name in FUSE_SCENE.outputs:
            write_cloud(out / name, placed.cloud)
        return SceneCloud(
            points=len(cloud.xyz), cloud_from_scene=placed.cloud_from_scene, camera_height=placed.camera_height
        )

    inputs = {
        "scene": scene_digest(scene),
        "depth": maps_digest(out),
        "settings": speedless(settings),
        "most_points": most_points(scene, out, settings=settings),
        "levelled": levelled,
    }
    record = Ledger(out).run(FUSE_SCENE, work, inputs=inputs)
    # What is told already, maybe of trees that were measured at a scale of their own, stays.
    told = of_file(read_plot(out))
    values = {key: told[key] for key in PHOTO_KEYS if key in told} | {
        # The scenes of others may well be in metres; those of structure from motion never are.
        "units": "m" if metric else MODEL_UNITS if ours or origin is not None else SCENE_UNITS,
        "scale_m_per_unit": 1.0 if metric else None,
        "scale_source": origin.program if origin is not None and metric else "none",
        "scale_rel_std": None,
        "scale_details": None,
        OF_FILE: None,
        "points": record.result.points,
        "density_per_m2": None,
        "cloud_from_scene": record.result.cloud_from_scene,
        "camera_height": record.result.camera_height,
        "versions": package_versions(),
    }
    known = all(told.get(key) == as_json(values[key]) for key in ("units", "points", "cloud_from_scene"))
    if record.ran or not known:
        update_plot(out, source=scene_folder.name, stage="fuse", seconds=record.seconds, values=values)
    return record


def _refuse_overwriting(source: Path, out: Path, what: str) -> None:
    if source.resolve() == out.resolve():
        msg = f"{what} would be written among the photos in {source}; give a folder of their own"
        raise ImageError(msg)
    if source.resolve().is_relative_to((out / "images").resolve()):
        msg = f"{source} would be overwritten by {what}; choose another output folder than {out}"
        raise ImageError(msg)
