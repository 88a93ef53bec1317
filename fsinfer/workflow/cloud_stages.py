"""The stages from a scene to the cloud of the plot: depth, its check, fusion, scale, and the plot's frame."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsinfer.depth.manifest import read_manifest
from fsinfer.depth.precision import INT8, choose_precision
from fsinfer.depth.settings import DepthSettings
from fsinfer.depth.sfm_check import DepthCheck, SfmCheckSettings, check_depth
from fsinfer.depth.stage import DepthResult, estimate_depth
from fsinfer.errors import InputError, SceneError
from fsinfer.fusion.fuse import FusionSettings, fuse, most_points
from fsinfer.io.cloud import read_cloud, write_cloud
from fsinfer.notices.notice import Notice
from fsinfer.output.json_values import as_json
from fsinfer.output.plot_json import of_file, read_plot
from fsinfer.placement.place import density_per_m2, place_cloud
from fsinfer.placement.settings import LevelSettings
from fsinfer.poses.sparse import read_sparse
from fsinfer.progress import StageProgress, silent_stages
from fsinfer.scale.doubts import EarlierScale, doubt_endpoints, doubt_height, unknown_error
from fsinfer.scale.find import FoundScale, find_scale
from fsinfer.scale.request import ScaleRequest
from fsinfer.scale.scale import UNKNOWN
from fsinfer.scale.square_fit import MarkerSettings
from fsinfer.scene import Scene, read_scene, scene_digest
from fsinfer.workflow.ledger import Ledger, Stage, StageRecord
from fsinfer.workflow.settings import speedless

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class FusedCloud:
    """The fused cloud in scene units, in ``path``."""

    path: Path
    points: int


@dataclass(frozen=True, kw_only=True)
class PlotCloud:
    """The cloud in the plot's frame, in ``path`` and beside it as LAZ.

    Attributes
    ----------
    points: how many.
    density_per_m2: points a square metre of plan area; None while no scale is known.
    cloud_from_scene: (4, 4) float64 similarity from scene coordinates to those of the cloud.
    camera_height: median height of the cameras over z = 0, in units of the cloud.
    """

    path: Path
    points: int
    density_per_m2: float | None
    cloud_from_scene: NDArray[np.float64]
    camera_height: float | None
    warnings: tuple[Notice, ...] = ()


DEPTH = Stage(name="depth", version=6, result=DepthResult, outputs=("depth", "confidence"), keeps_partial=True)
CHECK = Stage(name="check", version=1, result=DepthCheck)
FUSE = Stage(name="fuse", version=4, result=FusedCloud, outputs=("fused",))
SCALE = Stage(name="scale", version=6, result=FoundScale, later={"others": as_json(UNKNOWN)})
CLOUD = Stage(name="cloud", version=5, result=PlotCloud, outputs=("cloud.ply", "cloud.laz"))


def model_digest(settings: DepthSettings) -> str:
    """Hash of the graphs that depth will be computed with; errors of a wrong model or precision come here."""
    manifest = read_manifest(settings.model, trust=settings.trust_model)
    precision = choose_precision(settings.precision, manifest, provider=settings.provider)
    return manifest.sha256_of(int8=precision == INT8)


def require_workers(settings: DepthSettings, folder: Path | None = None) -> None:
    """See that the cluster that is to compute depth can be used, and sees ``folder``, before any work begins.

    Raises
    ------
    InputError, ClusterError
        It cannot.
    """
    if settings.scheduler:
        from fsinfer.depth.on_workers import check_workers  # loads Dask

        check_workers(settings, folder)


def compute_depth(
    ledger: Ledger, scene: Scene, *, settings: DepthSettings, progress: StageProgress = silent_stages
) -> StageRecord[DepthResult]:
    """Stage ``depth``: ``OUT/depth`` and ``OUT/confidence``. It hangs on what the scene holds, not on who made it."""
    return ledger.run(
        DEPTH,
        lambda resume: estimate_depth(scene, ledger.out, settings=settings, resume=resume, progress=progress("depth")),
        inputs={
            "scene": scene_digest(scene),
            "settings": speedless(settings),
            "model_sha256": model_digest(settings),
        },
    )


def refuse_maps_of_before(scene: Scene, out: Path) -> None:
    """Refuse depth maps of other cameras: those of photographs placed anew have another unit, and some of both agree.

    Of maps that no depth stage made, or that were replaced since, nobody knows. A stage that was stopped had emptied
    its folders before, so that what lies there is its own; that some of its maps are missing is logged.

    Raises
    ------
    SceneError
        The maps in ``out`` were computed, as far as they were, of what the scene was before it changed.
    """
    ledger = Ledger(out)
    stopped = ledger.is_begun(DEPTH.name)
    if not stopped and ledger.recall(DEPTH) is None:
        return
    computed_of = (ledger.inputs_of(DEPTH.name, begun=True) or {}).get("scene")
    if computed_of is not None and computed_of != scene_digest(scene):
        msg = (
            f"the depth maps in {out} are not those of {scene.folder} as it is now: its photos, cameras or pairs have "
            f"changed since; run again: fsinfer depth {scene.folder} {out}"
        )
        raise SceneError(msg)
    if stopped:
        _log.warning(
            "depth in %s was stopped before all its maps were made, and fewer photos see each stem; run again first: "
            "fsinfer run with the same photos, or fsinfer depth",
            out,
        )


def compare_with_sfm(
    ledger: Ledger, scene: Scene, *, settings: SfmCheckSettings, after: Sequence[StageRecord[Any]]
) -> StageRecord[DepthCheck]:
    """Stage ``check``: the depth maps against the tie points."""
    return ledger.run(
        CHECK,
        lambda _: check_depth(scene, read_sparse(scene.folder / "sparse"), ledger.out, settings=settings),
        inputs={"settings": settings},
        after=after,
    )


def fuse_depth(
    ledger: Ledger,
    scene: Scene,
    *,
    settings: FusionSettings,
    after: Sequence[StageRecord[Any]],
    progress: StageProgress = silent_stages,
) -> StageRecord[FusedCloud]:
    """Stage ``fuse``: one cloud in scene units, ``OUT/fused/cloud.ply``."""

    def work(_resume: bool) -> FusedCloud:
        cloud = fuse(scene, ledger.out, settings=settings, progress=progress("fuse"))
        path = ledger.out / "fused" / "cloud.ply"
        write_cloud(path, cloud)
        return FusedCloud(path=path, points=len(cloud.xyz))

    # Of the memory only the number of points shows in the cloud.
    limit = most_points(scene, ledger.out, settings=settings)
    return ledger.run(FUSE, work, inputs={"settings": speedless(settings), "most_points": limit}, after=after)


def measure_scale(
    ledger: Ledger,
    scene: Scene,
    *,
    request: ScaleRequest,
    settings: MarkerSettings,
    after: Sequence[StageRecord[Any]],
    progress: StageProgress = silent_stages,
) -> StageRecord[FoundScale]:
    """Stage ``scale``: metres per scene unit, with what is doubtful about it."""

    def work(_resume: bool) -> FoundScale:
        found = find_scale(request, scene=scene, settings=settings, progress=progress("scale"))
        doubts = doubt_endpoints(request, earlier_scale(ledger.out)) + unknown_error(found.scale)
        return replace(found, warnings=found.warnings + doubts)

    return ledger.run(SCALE, work, inputs={"request": request, "settings": settings}, after=after)


def place_plot(
    ledger: Ledger,
    scene: Scene,
    fused: StageRecord[FusedCloud],
    *,
    m_per_unit: float | None,
    settings: LevelSettings,
    progress: StageProgress = silent_stages,
) -> StageRecord[PlotCloud]:
    """Stage ``cloud``: z up, metres where the scale is known; ``OUT/cloud.ply`` and ``OUT/cloud.laz``."""

    def work(_resume: bool) -> PlotCloud:
        report = progress("cloud")
        report(0, 3, "levelling")
        placed = place_cloud(read_cloud(fused.result.path), scene, m_per_unit=m_per_unit, settings=settings)
        for done, name in enumerate(CLOUD.outputs, start=1):
            report(done, 3, f"writing {name}")
            write_cloud(ledger.out / name, placed.cloud)
        report(3, 3, "cloud")
        return PlotCloud(
            path=ledger.out / "cloud.ply",
            points=len(placed.cloud.xyz),
            density_per_m2=None if m_per_unit is None else density_per_m2(placed.cloud.xyz),
            cloud_from_scene=placed.cloud_from_scene,
            camera_height=placed.camera_height,
            warnings=(*placed.warnings, *(() if m_per_unit is None else doubt_height(placed.camera_height))),
        )

    return ledger.run(CLOUD, work, inputs={"m_per_unit": m_per_unit, "settings": settings}, after=[fused])


def earlier_scale(out: Path) -> EarlierScale:
    """What ``plot.json`` of an earlier run says of the scale; nothing where there is none, or a damaged one."""
    try:
        plot = of_file(read_plot(out))
    except InputError:
        return EarlierScale()
    details = plot.get("scale_details")
    given = details.get("endpoints") if isinstance(details, dict) else None
    ends = None
    if isinstance(given, list) and len(given) == 2:
        first, second = ((float(x), float(y), float(z)) for x, y, z in given)
        ends = (first, second)
    return EarlierScale(
        m_per_unit=plot.get("scale_m_per_unit"), endpoints=ends, camera_height=plot.get("camera_height")
    )


def scene_of(out: Path) -> Scene:
    """The scene that the poses stage left in an output folder."""
    return read_scene(out / "scene")
