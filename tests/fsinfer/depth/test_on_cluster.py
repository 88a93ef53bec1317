"""Depth on a real Dask cluster of two workers: the same bytes as here, though one is killed; and what goes wrong."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from fsinfer.cluster.workers import Workers
from fsinfer.depth import on_workers
from fsinfer.depth.manifest import models_folder
from fsinfer.depth.settings import DepthSettings
from fsinfer.depth.worker import ViewTask
from fsinfer.errors import InputError
from fsinfer.progress import Progress
from fsinfer.workflow.single_stages import depth_of
from tests.support.command_line import Call
from tests.support.dask_cluster import RunningCluster, running_cluster
from tests.support.plane_scene import write_plane_scene
from tests.support.time_limit import within

pytest.importorskip("distributed")
pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="stops a worker by a signal"),
    pytest.mark.skipif(not (models_folder() / "field.json").is_file(), reason="the depth model is not in this tree"),
    # What Dask says of itself, its files and its sockets is no warning of ours.
    pytest.mark.filterwarnings("default"),
]
VIEWS = 10


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_plane_scene(tmp_path_factory.mktemp("plane") / "scene", views=VIEWS)


@pytest.fixture(scope="module")
def near(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Computed on this computer."""
    out = tmp_path_factory.mktemp("near") / "out"
    depth_of(scene, out, settings=DepthSettings())
    return out


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningCluster]:
    """Two workers, of which the last test kills one."""
    with running_cluster(tmp_path_factory.mktemp("dask") / "dask") as running:
        workers = Workers(running.address, name="test", kept="")
        try:
            with workers.changed:
                assert workers.changed.wait_for(lambda: len(workers.threads) == 2, timeout=120)
        finally:
            workers.close()
        yield running


@pytest.fixture(autouse=True)
def not_for_ever() -> Iterator[None]:
    with within(300):
        yield


@pytest.fixture
def tasks(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, ViewTask]]:
    """Views that were given to workers."""
    given: list[tuple[str, ViewTask]] = []
    real = Workers.call

    def call(self: Workers, worker: str, function: Callable[..., Any], *arguments: Any) -> Any:
        if arguments and isinstance(arguments[0], ViewTask):
            given.append((worker, arguments[0]))
        return real(self, worker, function, *arguments)

    monkeypatch.setattr(Workers, "call", call)
    return given


def content(out: Path) -> dict[str, bytes]:
    return {
        path.relative_to(out).as_posix(): path.read_bytes()
        for name in ("depth", "confidence")
        for path in sorted((out / name).iterdir())
    }


def watched(strike: Callable[[int], None]) -> Callable[[str], Progress]:
    return lambda _stage: lambda done, _total, _what: strike(done)


def test_the_command_line_gives_the_same_bytes_from_copied_photos(
    scene: Path,
    near: Path,
    cluster: RunningCluster,
    tasks: list[tuple[str, ViewTask]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    call: Call,
) -> None:
    monkeypatch.chdir(scene.parent)
    code, told, said = call("depth", scene.name, tmp_path / "far", "--scheduler", cluster.address, "--copy")
    assert (code, told.split()[0]) == (0, str(VIEWS)), said
    assert f"depth: {VIEWS}/{VIEWS} depth" in said
    assert content(tmp_path / "far") == content(near)
    # The photographs were read from the workers' own folders, of which nothing is left.
    paths = {view.image_path for _, task in tasks for view in (task.view, *task.sources)}
    assert paths
    assert all(path.is_relative_to(cluster.folder) for path in paths)
    assert not list(cluster.folder.rglob("fsinfer-*"))
    # Done is done, wherever: the cluster is no part of what the maps hang on.
    assert not depth_of(scene, tmp_path / "far", settings=DepthSettings()).ran


def test_a_run_that_was_stopped_goes_on_without_repeating_a_view(
    scene: Path, near: Path, cluster: RunningCluster, tasks: list[tuple[str, ViewTask]], tmp_path: Path
) -> None:
    out, settings = tmp_path / "far", DepthSettings(scheduler=cluster.address)

    def stop(done: int) -> None:
        if done == 4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        depth_of(scene, out, settings=settings, progress=watched(stop))
    finished = {path: path.stat().st_mtime_ns for path in (out / "depth").glob("*.pfm")}
    assert len(finished) == 4
    tasks.clear()
    depth_of(scene, out, settings=settings)
    assert {task.view.name for _, task in tasks} == {str(n) for n in range(VIEWS)} - {path.stem for path in finished}
    assert {path: path.stat().st_mtime_ns for path in finished} == finished
    assert content(out) == content(near)
    # Each worker had neighbours: of two runs, of which the finished ones are taken out.
    for worker in {worker for worker, _ in tasks}:
        own = [int(task.view.name) for name, task in tasks if name == worker]
        assert sum(b < a for a, b in pairwise(own)) <= 1


def test_a_worker_that_does_not_see_the_folder_is_told_before_any_work(
    scene: Path, cluster: RunningCluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: Call
) -> None:
    monkeypatch.setattr(on_workers, "SEEN_S", 0.0)
    monkeypatch.setattr(on_workers, "write_text", lambda *_: None)
    code, _, said = call("run", scene / "images", tmp_path / "out", "--scheduler", cluster.address)
    assert code == 2
    assert "does not see" in said
    assert "give --copy" in said
    assert not (tmp_path / "out" / "frames").exists()
    # Of a scene that lies elsewhere than in OUT the photographs tell.
    monkeypatch.setattr(on_workers, "_size", lambda path: path.stat().st_size + 1)
    code, _, said = call("depth", scene, tmp_path / "far", "--scheduler", cluster.address)
    assert code == 2
    assert "sees another file in the place of" in said
    assert said.count("Error") == 1


def test_what_a_killed_worker_had_is_done_by_the_other(
    scene: Path,
    near: Path,
    cluster: RunningCluster,
    tasks: list[tuple[str, ViewTask]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    victim = cluster.workers[0]

    def strike(done: int) -> None:
        if done == 2:
            # From here on it answers nothing: the view that it was given stays with it until it dies.
            os.kill(victim.pid, signal.SIGSTOP)
        elif done == 4:
            victim.kill()

    # A path that leads nowhere from where the workers stand.
    monkeypatch.chdir(scene.parent)
    out, settings = tmp_path / "far", DepthSettings(scheduler=cluster.address)
    depth_of(Path(scene.name), out, settings=settings, progress=watched(strike))
    assert victim.wait(60) == -signal.SIGKILL
    assert content(out) == content(near)
    given = [task.view.name for _, task in tasks]
    assert len({worker for worker, _ in tasks}) == 2
    # All once, but for the one that was under way.
    assert len(given) == VIEWS + 1
    assert set(given) == {str(number) for number in range(VIEWS)}


@pytest.mark.parametrize("command", ["run", "depth"])
def test_a_scheduler_that_does_not_answer_is_told_before_any_work(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: Call, command: str
) -> None:
    monkeypatch.setattr("fsinfer.cluster.workers.CONNECT_S", 0.3)
    source = scene if command == "depth" else scene / "images"
    code, _, said = call(command, source, tmp_path / "out", "--scheduler", "tcp://127.0.0.1:9")
    assert code == 2
    assert "no Dask scheduler answers at tcp://127.0.0.1:9" in said
    assert said.count("Error") == 1
    assert not [path for path in (tmp_path / "out").glob("*") if path.name != ".fsinfer"]


def test_without_dask_the_way_to_it_is_told(scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"pip install 'fsinfer\[cluster\]'"):
        depth_of(scene, tmp_path / "out", settings=DepthSettings(scheduler="tcp://127.0.0.1:9"))
