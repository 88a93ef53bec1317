"""Stage ``depth``: a depth and a confidence map for every view of a scene folder."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2

from fsinfer.depth.in_processes import maps_in_processes, processes_for
from fsinfer.depth.job import DepthJob, plan_job
from fsinfer.depth.maps import read_depth_index
from fsinfer.depth.settings import DepthSettings
from fsinfer.depth.view_maps import MapsOfViews, ViewMaps, sources_of
from fsinfer.errors import OutputError, SceneError
from fsinfer.io.files import make_folder, write_text
from fsinfer.io.pfm import read_pfm, write_pfm
from fsinfer.notices.capture import CaptureCode
from fsinfer.notices.notice import Notice, notice
from fsinfer.progress import Progress, silent
from fsinfer.scene import Scene, View
from fsinfer.threads import cores, in_order, one_blas_thread

#: The index, which names all views, is written as often: with each view it would cost by the square of their number,
#: two seconds of 300 quick looks. Maps that it does not name yet are made again after a kill, and after no other end.
#: Source: numerics.
_INDEX_EVERY_S = 2.0

#: Views and their maps as they get ready, in any order.
Computed = Generator[tuple[View, ViewMaps], None, None]


@dataclass(frozen=True, kw_only=True)
class DepthResult:
    """What the stage wrote: ``depth_folder/depth/*.pfm`` and ``depth_folder/confidence/*.pfm``.

    ``precision`` is the one that was used; ``model_sha256`` is over the graphs of that precision. ``warnings`` name the
    views without a depth map.
    """

    depth_folder: Path
    views: int
    model: str
    model_sha256: str
    precision: str
    warnings: tuple[Notice, ...] = ()


@one_blas_thread()
def estimate_depth(
    scene: Scene,
    out: Path,
    *,
    settings: DepthSettings | None = None,
    resume: bool = False,
    progress: Progress = silent,
) -> DepthResult:
    """Write ``out/depth/NAME.pfm``, ``out/confidence/NAME.pfm`` and ``out/depth/depth.json``.

    ``resume``: views whose maps are there already are kept; for an attempt with the same scene, settings and model,
    which was stopped.

    Raises
    ------
    SceneError
        A view has no source view. ModelError, ImageError, OutputError as their names say.
    InputError
        A depth map takes more than ``settings.memory_gb``, or the cluster of ``settings.scheduler`` cannot be used.
    ClusterError
        The cluster is gone; the maps that are finished are kept.
    """
    settings = settings or DepthSettings()
    usable = [view for view in scene.views if view.sources]
    alone = tuple(view.name for view in scene.views if not view.sources)
    if not usable:
        msg = f"{scene.folder / 'pair.txt'} gives no view a source view; the photos do not overlap"
        raise SceneError(msg)
    # A photograph without a depth map of its own may still be a source, and the largest of all.
    read = {one.name: one for view in usable for one in (view, *sources_of(scene, view, settings))}
    job = plan_job(list(read.values()), settings)
    make_folder(out / "depth")
    make_folder(out / "confidence")
    index = _begin(out, settings, job.model_sha256, resume=resume)
    finished = 0

    def tell(view: View) -> None:
        progress(finished, len(usable), f"depth of {view.name}")

    left = []
    for view in usable:
        if view.name in index["views"] and _complete(out, view.name):
            tell(view)
            finished += 1
        else:
            left.append(view)
    written = time.monotonic()
    try:
        with closing(_computed(job, scene, left, tell)) as computed:
            for view, maps in computed:
                write_pfm(out / "depth" / f"{view.name}.pfm", maps.depth)
                write_pfm(out / "confidence" / f"{view.name}.pfm", maps.confidence)
                _enter(index, view, maps, usable)
                finished += 1
                if time.monotonic() >= written + _INDEX_EVERY_S:
                    _write_index(out, index)
                    written = time.monotonic()
    except BaseException:
        with suppress(OutputError):  # the disk may be what is wrong
            _write_index(out, index)
        raise
    _write_index(out, index)
    progress(len(usable), len(usable), "depth")
    return DepthResult(
        depth_folder=out,
        views=len(usable),
        model=job.model,
        model_sha256=job.model_sha256,
        precision=job.precision,
        warnings=() if not alone else (notice(CaptureCode.views_without_sources, names=alone, views=len(scene.views)),),
    )


def _computed(job: DepthJob, scene: Scene, views: Sequence[View], tell: Callable[[View], None]) -> Computed:
    """The maps of views, from this computer or from the workers of the settings' scheduler."""
    if not job.settings.scheduler:
        count = processes_for(job, len(views))
        return maps_in_processes(job, scene, views, tell, count=count) if count > 1 else _here(job, scene, views, tell)
    from fsinfer.depth.on_workers import maps_on_workers  # loads Dask

    return maps_on_workers(job, scene, views, tell)


def _here(job: DepthJob, scene: Scene, views: Sequence[View], tell: Callable[[View], None]) -> Computed:
    """On this computer, as many views at a time as memory allows; ``tell`` is told of each that is waited for."""
    # Threads that share out one view wait for each other in every layer of the network; views do not.
    at_once = max(1, min(job.plan.at_once, len(views)))
    all_threads = job.settings.threads or cores()
    # A plan for processes keeps what one of them needs.
    needed = at_once * (job.settings.source_views + 1)
    maps = MapsOfViews(
        job,
        plan=replace(job.plan, cached_views=max(job.plan.cached_views, needed)),
        threads=-(-all_threads // at_once),
        # Those of onnxruntime are shared by all who ask it, and who asks works too.
        graph_threads=max(1, all_threads - at_once + 1),
    )
    threads_before = cv2.getNumThreads()
    cv2.setNumThreads(1)  # the volume is shared out over blocks of rows already

    def compute(view: View) -> ViewMaps:
        return maps.of(view, sources_of(scene, view, job.settings))

    try:
        with closing(in_order(compute, views, at_once)) as made:
            for view in views:
                tell(view)
                yield view, next(made)
    finally:
        cv2.setNumThreads(threads_before)


def _begin(out: Path, settings: DepthSettings, model_sha256: str, *, resume: bool) -> dict[str, Any]:
    """The index to go on with: that of the attempt before, or one without views."""
    # The model's hash stands for its name and its precision too: two manifests of the same graphs give the same maps.
    index: dict[str, Any] = {
        "model": settings.model,
        "model_sha256": model_sha256,
        "source_views": settings.source_views,
        "max_size_px": settings.max_size_px,
        "views": {},
    }
    try:
        before = read_depth_index(out) if resume else index
    except SceneError:
        return index
    return before if before.get("model_sha256") == model_sha256 else index


def _enter(index: dict[str, Any], view: View, maps: ViewMaps, usable: Sequence[View]) -> None:
    """Say in the index where the pixels of a view's maps lie; its views stand in the order of the scene."""
    height, width = maps.depth.shape
    entries = index["views"]
    entry = entries[view.name] = {
        "width": width,
        "height": height,
        "pixel_step_x": maps.stride / maps.scale_x,
        "pixel_step_y": maps.stride / maps.scale_y,
        "offset_x_px": 0.5 / maps.scale_x - 0.5,
        "offset_y_px": 0.5 / maps.scale_y - 0.5,
    }
    index["views"] = {other.name: entries[other.name] for other in usable if other.name in entries}
    if view.name == usable[0].name:
        # The same for all views of one camera; a quick look should not have to search for it.
        index.update({k: entry[k] for k in ("width", "height", "pixel_step_x", "pixel_step_y")})


def _write_index(out: Path, index: dict[str, Any]) -> None:
    write_text(out / "depth" / "depth.json", json.dumps(index, indent=1))


def _complete(out: Path, name: str) -> bool:
    try:
        read_pfm(out / "depth" / f"{name}.pfm")
        read_pfm(out / "confidence" / f"{name}.pfm")
    except SceneError:
        return False
    return True
