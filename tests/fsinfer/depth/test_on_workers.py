"""Depth given to workers that are calls of a function here: what is tried again, left aside, told, and kept."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from fsinfer.depth import on_workers, worker
from fsinfer.depth.job import DepthJob, plan_job, plan_within
from fsinfer.depth.manifest import models_folder, read_manifest
from fsinfer.depth.memory import DepthPlan
from fsinfer.depth.settings import DepthSettings
from fsinfer.depth.stage import _write_index, estimate_depth
from fsinfer.depth.view_maps import MapsOfViews, sources_of
from fsinfer.depth.worker import UnfitWorkerError, ViewTask, compute
from fsinfer.errors import ClusterError, ImageError, InputError, WorkerLostError
from fsinfer.scene import Scene, read_scene
from tests.support.places import ROOT
from tests.support.plane_scene import write_plane_scene
from tests.support.time_limit import within

pytestmark = pytest.mark.skipif(
    not (models_folder() / "field.json").is_file(), reason="the depth model is not in this source tree"
)
VIEWS = 6
SETTINGS = DepthSettings(scheduler="tcp://127.0.0.1:8", threads=1)
Strike = Callable[[str, ViewTask], None]


class FakeWorkers:
    """Workers that compute in threads of this process; ``strike`` is called before each view."""

    def __init__(self, strike: Strike, *names: str) -> None:
        self.strike = strike
        self.threads = dict.fromkeys(names, 2)
        self.tries: Counter[str] = Counter()
        self.forgotten: list[str] = []
        self.gone = threading.Event()

    def neighbours(self, worker: str) -> list[str]:
        return [worker]

    def check(self) -> None:
        pass

    def call(self, name: str, function: Callable[..., Any], *arguments: Any) -> Any:
        if function is not compute:
            return function(*arguments)
        self.tries[arguments[0].view.name] += 1
        self.strike(name, arguments[0])
        return compute(*arguments)

    def everywhere(self, function: Callable[..., Any], *arguments: Any) -> None:
        function(*arguments)

    def give_up(self, why: str) -> None:
        self.gone.set()

    def close(self) -> None:
        assert self.gone.is_set()


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return read_scene(write_plane_scene(tmp_path_factory.mktemp("plane") / "scene", views=VIEWS))


@pytest.fixture(autouse=True)
def worker_here(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(worker, "memory_limit_bytes", lambda: None)
    monkeypatch.setattr(on_workers, "LOOK_S", 0.02)
    with within(120):
        yield


@pytest.fixture
def employ(monkeypatch: pytest.MonkeyPatch) -> Callable[..., FakeWorkers]:
    def employ(strike: Strike, *names: str) -> FakeWorkers:
        workers = FakeWorkers(strike, *names)
        monkeypatch.setattr(on_workers, "Workers", lambda *_, **__: workers)
        return workers

    return employ


def no_strike(_name: str, _task: ViewTask) -> None:
    pass


def test_a_view_that_loses_worker_after_worker_ends_it_with_one_message(
    scene: Scene, tmp_path: Path, employ: Callable[..., FakeWorkers]
) -> None:
    def strike(name: str, task: ViewTask) -> None:
        if task.view.name == "4":
            # As the scheduler sees it: another has taken its place.
            workers.threads = {f"{name}+": 2}
            raise WorkerLostError(f"its worker {name} was lost")

    workers = employ(strike, "a")
    with pytest.raises(ClusterError, match=r"depth of 4 failed 3 times, at last because its worker a\+\+ was lost"):
        estimate_depth(scene, tmp_path, settings=SETTINGS)
    assert workers.tries["4"] == 1 + on_workers.RETRIES
    # What was finished before is kept, and the next attempt does the rest alone.
    before = set(json.loads((tmp_path / "depth" / "depth.json").read_text(encoding="utf-8"))["views"])
    assert before == {"0", "1", "2", "3"}
    again = employ(no_strike, "b")
    estimate_depth(scene, tmp_path, settings=SETTINGS, resume=True)
    assert set(again.tries) == {"4", "5"}


def test_the_index_is_written_now_and_then(
    scene: Scene, tmp_path: Path, employ: Callable[..., FakeWorkers], monkeypatch: pytest.MonkeyPatch
) -> None:
    written = []

    def counted(out: Path, index: dict[str, Any]) -> None:
        written.append(len(index["views"]))
        _write_index(out, index)

    monkeypatch.setattr("fsinfer.depth.stage._write_index", counted)
    for seconds, sizes in ((0.0, [1, 2, 3, 4, 5, 6, 6]), (1e9, [6])):
        monkeypatch.setattr("fsinfer.depth.stage._INDEX_EVERY_S", seconds)
        employ(no_strike, "a")
        estimate_depth(scene, tmp_path, settings=SETTINGS)
        assert written == sizes
        written.clear()


def test_memory_that_runs_out_once_is_tried_again(
    scene: Scene, tmp_path: Path, employ: Callable[..., FakeWorkers]
) -> None:
    def strike(_name: str, task: ViewTask) -> None:
        if task.view.name == "2" and workers.tries["2"] == 1:
            raise MemoryError

    workers = employ(strike, "a")
    assert estimate_depth(scene, tmp_path, settings=SETTINGS).views == VIEWS
    assert {view: number for view, number in workers.tries.items() if number > 1} == {"2": 2}


def test_a_photo_that_cannot_be_read_is_told_at_once(
    scene: Scene, tmp_path: Path, employ: Callable[..., FakeWorkers]
) -> None:
    def strike(_name: str, task: ViewTask) -> None:
        if task.view.name == "3":
            raise ImageError("3.png is damaged")

    workers = employ(strike, "a", "b")
    with pytest.raises(ImageError, match=r"3\.png is damaged"):
        estimate_depth(scene, tmp_path, settings=SETTINGS)
    assert workers.tries["3"] == 1


def test_one_that_cannot_do_it_is_told_at_first_and_left_aside_later(
    scene: Scene, tmp_path: Path, employ: Callable[..., FakeWorkers], caplog: pytest.LogCaptureFixture
) -> None:
    def strike(name: str, _task: ViewTask) -> None:
        if name == "blind":
            raise UnfitWorkerError("the worker on blind does not see it")
        workers.threads["blind"] = 2

    workers = employ(strike, "a")
    assert estimate_depth(scene, tmp_path / "later", settings=SETTINGS).views == VIEWS
    assert "does not see it; it is left aside" in caplog.text
    workers = employ(strike, "a", "blind")
    with pytest.raises(UnfitWorkerError):
        estimate_depth(scene, tmp_path / "first", settings=SETTINGS)


def test_when_only_one_that_cannot_do_it_is_left_that_is_told(
    scene: Scene, tmp_path: Path, employ: Callable[..., FakeWorkers]
) -> None:
    def strike(name: str, _task: ViewTask) -> None:
        if name == "blind":
            raise UnfitWorkerError("the worker on blind does not see it")
        workers.threads = {"blind": 2}
        raise WorkerLostError("lost")

    workers = employ(strike, "a")
    with pytest.raises(UnfitWorkerError, match="does not see it"):
        estimate_depth(scene, tmp_path, settings=SETTINGS)


def task_of(scene: Scene, job: DepthJob, number: int = 0) -> ViewTask:
    view = scene.views[number]
    sources = sources_of(scene, view, job.settings)
    sizes = tuple(v.image_path.stat().st_size for v in (view, *sources))
    return ViewTask(scene="token", job=job, view=view, sources=tuple(sources), photo_bytes=sizes)


def test_a_worker_refuses_what_it_would_compute_otherwise(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    job = plan_job(scene.views, SETTINGS)
    task = task_of(scene, job)
    gone = replace(task.view, image_path=Path("/nowhere/0.png"))
    model = replace(SETTINGS, model="nonsense")
    refused = {
        r"does not see .*0\.png; .* or give --copy": replace(task, view=gone),
        r"sees another file in the place of": replace(task, photo_bytes=(1, *task.photo_bytes[1:])),
        r"has fsinfer .*, not 0\.0\.1": replace(task, version="0.0.1"),
        r"has another model 'cascade'": replace(task, job=replace(job, model_sha256="0" * 64)),
        r"cannot use the model: .*nonsense": replace(task, job=replace(job, settings=model)),
    }
    for why, wrong in refused.items():
        worker.forget("token")
        with pytest.raises(UnfitWorkerError, match=why):
            compute(wrong)


def test_a_worker_stays_within_its_memory_or_says_so(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = replace(SETTINGS, model="field", precision="float32")
    job = plan_job(scene.views, settings)
    manifest = read_manifest("field")
    plan = plan_within(
        settings.memory_gb, settings=settings, manifest=manifest, precision="float32", width=1280, height=720
    )
    job = replace(job, width=1280, height=720, plan=plan)

    def planned(limit_gb: float) -> DepthPlan:
        monkeypatch.setattr(worker, "memory_limit_bytes", lambda: int(limit_gb * 1e9))
        return worker._plan(job)

    assert planned(8.0) == plan
    less = planned(2.0)
    assert 5 <= less.cached_views < plan.cached_views
    assert less.peak_bytes <= worker.MEMORY_SHARE * 2.0e9
    # One map fits only in tiles, whose last digits are others; then not even so.
    for limit_gb, share in ((1.6, "1.1"), (0.6, "0.4")):
        with pytest.raises(UnfitWorkerError, match=rf"may hold {share} GB for depth, .* larger --memory-limit"):
            planned(limit_gb)


def test_what_a_worker_keeps_serves_the_next_view_and_goes(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    loaded: list[str] = []

    def load(*arguments: Any, **options: Any) -> Any:
        loaded.append("model")
        return MapsOfViews(*arguments, **options)

    monkeypatch.setattr(worker, "MapsOfViews", load)
    task = task_of(scene, plan_job(scene.views, SETTINGS))
    compute(task)
    compute(task_of(scene, task.job, 1))
    assert loaded == ["model"]
    compute(replace(task, scene="another"))
    assert loaded == ["model"] * 2
    worker.forget("token")  # of another scene: what is kept stays
    compute(replace(task, scene="another"))
    assert loaded == ["model"] * 2
    monkeypatch.setattr(worker, "IDLE_S", 0.01)
    compute(replace(task, scene="another"))
    time.sleep(0.3)
    compute(replace(task, scene="another"))
    assert loaded == ["model"] * 3


def test_without_a_scheduler_dask_is_not_loaded_and_copying_is_refused(scene: Scene, tmp_path: Path) -> None:
    code = (
        "import sys; from fsinfer.cli.app import main\n"
        f"sys.argv = ['fsinfer', 'depth', {str(scene.folder)!r}, {str(tmp_path / 'out')!r}, '--quiet']\n"
        "try: main()\n"
        "finally: print([name for name in ('dask', 'distributed', 'fsinfer.cluster') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.stdout.splitlines()[-1] == "[]", done.stderr
    assert (tmp_path / "out" / "depth" / "depth.json").is_file()
    with pytest.raises(InputError, match="--copy was given without --scheduler"):
        DepthSettings(copy_photos=True)
