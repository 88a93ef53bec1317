"""Depth maps of one scene by several processes of this computer, each of which computes a run of neighbouring views.

Threads of one process wait for Python's lock some thousand times a view: two of them take an eighth longer for the same
maps (docs/trials-speed.md). Each process has the model and the feature maps of its own neighbours, which costs memory:
:func:`fsinfer.depth.memory.plan_depth` tells whether there is enough.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Generator, Sequence
from dataclasses import replace
from typing import Any

import cv2

from fsinfer.depth.job import DepthJob
from fsinfer.depth.runs_of_views import RunsOfViews
from fsinfer.depth.view_maps import MapsOfViews, ViewMaps, sources_of
from fsinfer.processes import as_ready, can_start, worker_processes
from fsinfer.scene import Scene, View
from fsinfer.threads import cores

#: Views of one process at least. Source: numerics; it takes two seconds to start.
_LEAST_OF_ONE = 15


def maps_in_processes(
    job: DepthJob, scene: Scene, views: Sequence[View], tell: Callable[[View], None], *, count: int
) -> Generator[tuple[View, ViewMaps], None, None]:
    """Views and their maps in the order in which they get ready; ``tell`` is told of each when it is.

    ``count`` processes of :func:`processes_for`, two or more, share them. One that ends leaves its share to this one.
    Errors as those of :class:`MapsOfViews`.
    """
    runs = RunsOfViews(len(views), workers=count)
    compute = _Maps(job, threads=-(-(job.settings.threads or cores()) // count))

    def take(process: int) -> tuple[int, View, list[View]] | None:
        number = runs.take(str(process))
        return None if number is None else (number, views[number], sources_of(scene, views[number], job.settings))

    tell(views[0])
    threads_before = cv2.getNumThreads()
    cv2.setNumThreads(1)  # for a share that is left to this process
    try:
        with worker_processes([__name__], count=count):
            for number, maps in as_ready(compute, take):
                yield views[number], maps
                tell(views[number])
    finally:
        cv2.setNumThreads(threads_before)


def processes_for(job: DepthJob, views: int) -> int:
    """Processes that so many views are worth, 1 where this one does as well or no other can be started."""
    return max(1, min(job.plan.processes, views // _LEAST_OF_ONE)) if can_start() else 1


class _Maps:
    """The maps of views in whatever process it is sent to, which loads the model when it is asked for the first."""

    def __init__(self, job: DepthJob, *, threads: int) -> None:
        plan = replace(job.plan, at_once=1, regularizers=1)
        self._job, self._plan, self._threads = job, plan, threads
        self._lock = threading.Lock()
        self._maps: MapsOfViews | None = None

    def __getstate__(self) -> dict[str, Any]:
        return {"_job": self._job, "_plan": self._plan, "_threads": self._threads}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__ |= state
        self._lock, self._maps = threading.Lock(), None

    def __call__(self, asked: tuple[int, View, list[View]]) -> tuple[int, ViewMaps]:
        number, view, sources = asked
        with self._lock:
            if self._maps is None:
                self._maps = MapsOfViews(self._job, plan=self._plan, threads=self._threads)
        return number, self._maps.of(view, sources)
