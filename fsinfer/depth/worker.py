"""What a worker of a cluster does for the depth of a scene: the maps of one view at a call.

A call tells all that is needed, so that a worker may come, go and start again at any time. What it keeps from one call
to the next, model and feature maps, only makes it quicker. It writes nothing of the stage: its answer is the maps.
"""

from __future__ import annotations

import socket
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import cv2

from fsinfer._version import __version__
from fsinfer.cluster.workers import memory_limit_bytes
from fsinfer.depth.job import DepthJob, plan_within
from fsinfer.depth.manifest import read_manifest
from fsinfer.depth.memory import GIGABYTE, DepthPlan
from fsinfer.depth.view_maps import MapsOfViews, ViewMaps
from fsinfer.errors import InputError, ModelError
from fsinfer.scene import View
from fsinfer.threads import cores, one_blas_thread

#: Of the limit of a worker's memory, what depth may take. Source: format; beyond it Dask begins to move data to the
#: disk, and at 0.8 it halts the worker.
MEMORY_SHARE = 0.7
#: Model and feature maps are let go when nobody has asked for so long, seconds. Source: judgement; whoever asked may
#: have been killed, and a pause of the network is shorter.
IDLE_S = 120.0
#: Between two looks for a file, seconds. Source: numerics.
_PAUSE_S = 0.2


class UnfitWorkerError(InputError):
    """This worker can compute nothing of the scene; others may."""


@dataclass(frozen=True, kw_only=True)
class ViewTask:
    """A view to compute.

    Attributes
    ----------
    scene: token of the scene and of the computation; what is kept of another one is let go.
    job: what all views have in common.
    view, sources: with paths of the photographs as the worker sees them.
    photo_bytes: sizes of these photographs, the view's own first.
    beside: workers of the worker's computer, which share its cores.
    version: of fsinfer that asks; another one would compute otherwise.
    """

    scene: str
    job: DepthJob
    view: View
    sources: tuple[View, ...]
    photo_bytes: tuple[int, ...]
    beside: int = 1
    version: str = __version__


class _Kept:
    """The model and the feature maps of the scene that was asked for last."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._scene = ""
        self._maps: MapsOfViews | None = None
        self._timer: threading.Timer | None = None

    def of(self, scene: str) -> MapsOfViews | None:
        with self._lock:
            self._stop_timer()
            if scene != self._scene:
                self._maps = None
            return self._maps

    def keep(self, scene: str, maps: MapsOfViews) -> None:
        with self._lock:
            self._stop_timer()
            self._scene, self._maps = scene, maps
            self._timer = threading.Timer(IDLE_S, self.forget, [scene])
            self._timer.daemon = True
            self._timer.start()

    def forget(self, scene: str) -> None:
        with self._lock:
            if scene == self._scene:
                self._stop_timer()
                self._maps = None

    def _stop_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None


_kept = _Kept()
#: One view at a time, whatever threads a worker has: its memory is that of one.
_one_at_a_time = threading.Lock()


@one_blas_thread()
def compute(task: ViewTask) -> ViewMaps:
    """The maps of a view.

    Raises
    ------
    UnfitWorkerError
        This computer has another fsinfer or model, sees other photographs or none, or may hold too little memory.
    ModelError, ImageError
        The model does not compute what it should, or a photograph cannot be read.
    """
    with _one_at_a_time:
        if task.version != __version__:
            _refuse(f"has fsinfer {__version__}, not {task.version}; install the same version everywhere")
        _check_photos(task)
        maps = _kept.of(task.scene)
        if maps is None:
            maps = _load(task)
        threads_before = cv2.getNumThreads()
        cv2.setNumThreads(1)  # the volume is shared out over blocks of rows already
        try:
            return maps.of(task.view, task.sources)
        finally:
            cv2.setNumThreads(threads_before)
            _kept.keep(task.scene, maps)


def sees(path: Path, text: str, seconds: float) -> bool:
    """Whether this worker sees a file with this text, within some seconds."""
    end = time.monotonic() + seconds
    while True:
        try:
            if path.read_text(encoding="utf-8") == text:
                return True
        except OSError:
            pass
        if time.monotonic() > end:
            return False
        time.sleep(_PAUSE_S)


def forget(scene: str) -> None:
    """Let go of what is kept of a scene."""
    _kept.forget(scene)


def _load(task: ViewTask) -> MapsOfViews:
    job = task.job
    threads = job.settings.threads or max(1, cores() // task.beside)
    try:
        maps = MapsOfViews(job, plan=_plan(job), threads=threads)
    except ModelError as error:
        _refuse(f"cannot use the model: {error}")
    if maps.model_sha256 != job.model_sha256:
        _refuse(f"has another model {job.settings.model!r}; install the same fsinfer everywhere")
    return maps


def _check_photos(task: ViewTask) -> None:
    for view, size in zip((task.view, *task.sources), task.photo_bytes, strict=True):
        try:
            found = view.image_path.stat().st_size
        except OSError:
            found = -1
        if found != size:
            what = "does not see" if found < 0 else "sees another file in the place of"
            _refuse(
                f"{what} {view.image_path}; put the scene onto a disk that all computers see under the same path, "
                "or give --copy, which sends the photos"
            )


def _plan(job: DepthJob) -> DepthPlan:
    """The plan of the job, or one for the memory that this worker may hold, to the same maps."""
    limit = memory_limit_bytes()
    memory_gb = job.settings.memory_gb if limit is None else MEMORY_SHARE * limit / GIGABYTE
    if memory_gb >= job.settings.memory_gb:
        return job.plan
    try:
        plan = plan_within(
            memory_gb,
            settings=job.settings,
            manifest=read_manifest(job.settings.model, trust=job.settings.trust_model),
            precision=job.precision,
            width=job.width,
            height=job.height,
        )
    except InputError:
        plan = None
    # In other tiles the maps would be others in their last digits.
    if plan is None or (plan.tile_size, plan.keeps_volume) != (job.plan.tile_size, job.plan.keeps_volume):
        _refuse(
            f"may hold {memory_gb:.1f} GB for depth, which takes more with {job.width}x{job.height} photos; start it "
            "with a larger --memory-limit, or give a smaller --memory-gb or --max-size"
        )
    return plan


def _refuse(why: str) -> NoReturn:
    msg = f"the worker on {socket.gethostname()} {why}"
    raise UnfitWorkerError(msg)
