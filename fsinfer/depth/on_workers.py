"""The depth maps of one scene on the workers of a cluster, each of which computes runs of neighbouring views."""

from __future__ import annotations

import logging
import queue
import secrets
import threading
from collections import Counter
from collections.abc import Callable, Generator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from fsinfer.cluster.pieces import remove_scratch
from fsinfer.cluster.workers import LOOK_S, Workers
from fsinfer.depth.job import DepthJob
from fsinfer.depth.runs_of_views import RunsOfViews
from fsinfer.depth.sent_photos import SentPhotos
from fsinfer.depth.settings import DepthSettings
from fsinfer.depth.view_maps import ViewMaps, sources_of
from fsinfer.depth.worker import UnfitWorkerError, ViewTask, compute, forget, sees
from fsinfer.errors import ClusterError, InputError, WorkerLostError
from fsinfer.io.files import write_text
from fsinfer.scene import Scene, View

_log = logging.getLogger(__name__)

#: How often a view is given out again whose worker was lost or ran out of memory. Source: judgement; as a plot of a
#: batch.
RETRIES = 2
#: Maps that wait to be written. Source: numerics.
_MOST_WAITING = 8
#: In which workers must see a file that was just written, seconds. Source: judgement; network file systems look anew
#: every few seconds for what was not there.
SEEN_S = 8.0
#: File by which workers show that they see a folder.
_SEEN_FILE = "seen-by-workers"


def check_workers(settings: DepthSettings, folder: Path | None = None) -> None:
    """See that the scheduler of the settings answers, before hours of work that leads up to depth.

    ``folder``: one that the workers must see, unless photographs are sent to them.

    Raises
    ------
    InputError
        No scheduler answers, or a worker does not see the folder.
    ClusterError
        A worker has no fsinfer, or another version.
    """
    workers = _connect(settings)
    try:
        if folder is not None and not settings.copy_photos:
            _check_disk(workers, folder)
    finally:
        workers.close()


def maps_on_workers(
    job: DepthJob, scene: Scene, views: Sequence[View], tell: Callable[[View], None]
) -> Generator[tuple[View, ViewMaps], None, None]:
    """Views and their maps in the order in which they get ready; ``tell`` is told of each that was taken.

    Workers may come and go. What one that is lost was computing is given to others, ``RETRIES`` times.

    Raises
    ------
    InputError
        No scheduler answers, or a worker that was there at the beginning cannot do it.
    ClusterError
        The cluster is gone, or a view has lost worker after worker.
    """
    if not views:
        return
    workers = _connect(job.settings)
    try:
        computation = _Computation(job, scene, views, workers)
        tell(views[0])
        try:
            for view, maps in computation.results():
                yield view, maps
                tell(view)
        finally:
            computation.stop()
    finally:
        workers.close()


class _Computation:
    """One that is under way: a thread for each worker gives it view after view, and puts the maps into a queue."""

    def __init__(self, job: DepthJob, scene: Scene, views: Sequence[View], workers: Workers) -> None:
        model = Path(job.settings.model)
        # The manifest of a model, too, is a file that a worker has to find.
        found = replace(job.settings, model=str(model.absolute())) if model.is_file() else job.settings
        self._job = replace(job, settings=found)
        self._scene = scene
        self._views = views
        self._workers = workers
        self._token = secrets.token_hex(8)
        self._at_first = frozenset(workers.threads)
        self._runs = RunsOfViews(len(views), workers=len(self._at_first))
        self._ready: queue.Queue[tuple[View, ViewMaps] | Exception] = queue.Queue(_MOST_WAITING)
        self._stopped = threading.Event()
        self._threads: dict[str, threading.Thread] = {}
        self._lost: set[str] = set()
        self._unfit: dict[str, UnfitWorkerError] = {}
        self._failures: Counter[int] = Counter()
        self._scratch: list[str] = []

    def results(self) -> Generator[tuple[View, ViewMaps], None, None]:
        """Each view once; raises what any worker raises that others would raise as well."""
        left = len(self._views)
        while left:
            self._employ()
            try:
                ready = self._ready.get(timeout=LOOK_S)
            except queue.Empty:
                continue
            if isinstance(ready, Exception):
                raise ready
            left -= 1
            yield ready

    def stop(self) -> None:
        """Let the workers forget what they hold; one that computes a view ends it, and nobody takes it."""
        self._stopped.set()
        self._workers.give_up("depth was stopped")
        self._workers.everywhere(forget, self._token)
        for folder in self._scratch:
            self._workers.everywhere(remove_scratch, folder)
        for thread in self._threads.values():
            thread.join()

    def _employ(self) -> None:
        """Give work to workers that are there and have none: new ones, and all others where views came back."""
        self._workers.check()
        there = self._workers.threads
        self._lost &= set(there)
        fit = [worker for worker in there if worker not in self._lost and worker not in self._unfit]
        busy = {worker for worker, thread in self._threads.items() if thread.is_alive()}
        if not fit and not busy and self._unfit:
            raise next(iter(self._unfit.values()))
        for worker in fit:
            if worker not in busy and self._runs.left:
                self._threads[worker] = threading.Thread(target=self._serve, args=[worker], daemon=True)
                self._threads[worker].start()

    def _serve(self, worker: str) -> None:
        """Give the worker views as long as there are any."""
        photos: SentPhotos | None = None

        def call(function: Callable[..., Any], *arguments: object) -> Any:
            return self._workers.call(worker, function, *arguments)

        while not self._stopped.is_set() and (number := self._runs.take(worker)) is not None:
            view = self._views[number]
            needed = [view, *sources_of(self._scene, view, self._job.settings)]
            try:
                if self._job.settings.copy_photos and photos is None:
                    photos = SentPhotos(call)
                    self._scratch.append(photos.folder)
                maps = call(compute, self._task(worker, needed, photos))
            except UnfitWorkerError as error:
                self._runs.give_back(worker, number)
                self._leave_aside(worker, error)
                return
            except WorkerLostError as error:
                self._lost.add(worker)
                self._runs.give_back(worker, number)
                self._count_failure(number, str(error))
                return
            except MemoryError:
                self._runs.give_back(worker, number)
                self._count_failure(number, f"the worker {worker} has not enough free memory")
            except Exception as error:
                self._put(error)
                return
            else:
                self._put((view, maps))

    def _task(self, worker: str, needed: Sequence[View], photos: SentPhotos | None) -> ViewTask:
        sizes = tuple(_size(view.image_path) for view in needed)
        # A worker stands in another folder, so that a relative path would lead elsewhere.
        here = [replace(view, image_path=view.image_path.absolute()) for view in needed]
        view, *sources = here if photos is None else photos.send(here)
        return ViewTask(
            scene=self._token,
            job=self._job,
            view=view,
            sources=tuple(sources),
            photo_bytes=sizes,
            beside=max(1, len(self._workers.neighbours(worker))),
        )

    def _leave_aside(self, worker: str, error: UnfitWorkerError) -> None:
        if worker in self._at_first:
            self._put(error)
        else:
            # Others are at work, maybe for hours: one that came later and cannot do it ends nothing.
            _log.warning("%s; it is left aside", error)
            self._unfit[worker] = error

    def _count_failure(self, number: int, why: str) -> None:
        self._failures[number] += 1
        if self._failures[number] > RETRIES:
            name = self._views[number].name
            msg = (
                f"depth of {name} failed {RETRIES + 1} times, at last because {why}; mostly memory is short: start "
                "workers with more, or give a smaller --max-size. Finished maps are kept, and the same command goes on"
            )
            self._put(ClusterError(msg))

    def _put(self, what: tuple[View, ViewMaps] | Exception) -> None:
        while not self._stopped.is_set():
            try:
                self._ready.put(what, timeout=LOOK_S)
            except queue.Full:
                continue
            return


def _connect(settings: DepthSettings) -> Workers:
    return Workers(settings.scheduler, name="fsinfer-depth", kept="finished depth maps are kept")


def _check_disk(workers: Workers, folder: Path) -> None:
    path, token = folder / _SEEN_FILE, secrets.token_hex(8)
    write_text(path, token)
    try:
        for worker in workers.threads:
            try:
                seen = workers.call(worker, sees, path.absolute(), token, SEEN_S)
            except WorkerLostError:
                continue
            if not seen:
                msg = (
                    f"the worker {worker} does not see {folder.absolute()}; put the output folder onto a disk that all "
                    "computers see under the same path, or give --copy, which sends the photos"
                )
                raise InputError(msg)
    finally:
        path.unlink(missing_ok=True)


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError as error:
        msg = f"cannot read {path}: {error.strerror or error}"
        raise InputError(msg) from error
