"""Depth maps by processes: the same as by threads, whatever ends meanwhile."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from fsinfer import processes
from fsinfer.depth import in_processes, job, stage
from fsinfer.depth.in_processes import _Maps
from fsinfer.depth.job import plan_job
from fsinfer.depth.settings import DepthSettings
from fsinfer.depth.stage import estimate_depth
from fsinfer.depth.view_maps import sources_of
from fsinfer.errors import ImageError
from fsinfer.process_worker import Answer
from fsinfer.scene import Scene, read_scene
from tests.support.plane_scene import write_plane_scene

SETTINGS = DepthSettings(threads=2, precision="int8")


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Scene:
    monkeypatch.setattr(job, "LEAST_APART", 3)
    monkeypatch.setattr(in_processes, "_LEAST_OF_ONE", 1)
    return read_scene(write_plane_scene(tmp_path / "scene", height=75, width=90))


def maps_in(folder: Path) -> dict[str, bytes]:
    return {f"{path.parent.name}/{path.name}": path.read_bytes() for path in sorted(folder.glob("*/*.pfm"))}


def by_threads(scene: Scene, out: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, bytes]:
    with monkeypatch.context() as patch:
        patch.setattr(job, "LEAST_APART", 1000)
        patch.setattr(stage, "maps_in_processes", None)  # cannot be called
        estimate_depth(scene, out, settings=SETTINGS)
    return maps_in(out)


def test_the_same_maps_and_every_view_is_told(scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[tuple[int, int]] = []
    there: set[int] = set()
    ask = processes._Worker.ask

    def noted(self: Any, work: Callable[[Any], Any], item: Any) -> Answer:
        there.add(self._process.pid)
        return ask(self, work, item)

    monkeypatch.setattr(processes._Worker, "ask", noted)
    estimate_depth(
        scene, tmp_path / "apart", settings=SETTINGS, progress=lambda done, all_, _: told.append((done, all_))
    )
    assert len(there) == 2
    found = maps_in(tmp_path / "apart")
    assert len(found) == 2 * len(scene.views)
    assert found == by_threads(scene, tmp_path / "here", monkeypatch)
    count = len(scene.views)
    assert told[0] == (0, count)
    assert told[-1] == (count, count)
    assert [done for done, _ in told] == sorted(done for done, _ in told)


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="kills by signals")
def test_what_a_process_had_to_do_that_was_killed_is_done_here(
    scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    ask = processes._Worker.ask
    killed: list[int] = []

    def kill_first(self: Any, work: Callable[[Any], Any], item: Any) -> Answer:
        if not killed:
            killed.append(self._process.pid)
            os.kill(self._process.pid, signal.SIGKILL)
        return ask(self, work, item)

    monkeypatch.setattr(processes._Worker, "ask", kill_first)
    estimate_depth(scene, tmp_path / "apart", settings=SETTINGS)
    assert killed
    assert "its share is done by the run itself" in caplog.text
    assert maps_in(tmp_path / "apart") == by_threads(scene, tmp_path / "here", monkeypatch)


def test_a_photo_that_cannot_be_read_is_told_and_what_was_finished_is_kept(
    scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # It is a source of the last view alone, which comes when another is finished.
    last = len(scene.views) - 1
    views = tuple(
        replace(view, sources=tuple(source for source in view.sources if source != last)) for view in scene.views[:last]
    )
    scene = replace(scene, views=(*views, scene.views[last]))
    damaged = scene.views[last].image_path
    whole = damaged.read_bytes()
    damaged.write_bytes(whole[: len(whole) // 2])
    ask = processes._Worker.ask

    def last_at_the_end(self: Any, work: Callable[[Any], Any], item: Any) -> Answer:
        until = time.monotonic() + 60.0
        while item[0] == last and not maps_in(tmp_path / "apart") and time.monotonic() < until:
            time.sleep(0.01)
        return ask(self, work, item)

    monkeypatch.setattr(processes._Worker, "ask", last_at_the_end)
    with pytest.raises(ImageError, match=damaged.name):
        estimate_depth(scene, tmp_path / "apart", settings=SETTINGS)
    damaged.write_bytes(whole)
    kept = {name: path.stat().st_mtime_ns for name, path in _written(tmp_path / "apart").items()}
    assert kept
    estimate_depth(scene, tmp_path / "apart", settings=SETTINGS, resume=True)
    assert maps_in(tmp_path / "apart") == by_threads(scene, tmp_path / "here", monkeypatch)
    after = _written(tmp_path / "apart")
    assert all(after[name].stat().st_mtime_ns == changed for name, changed in kept.items())


def test_going_on_where_nothing_is_left(scene: Scene, tmp_path: Path) -> None:
    estimate_depth(scene, tmp_path, settings=SETTINGS)
    before = maps_in(tmp_path)
    told: list[str] = []
    estimate_depth(scene, tmp_path, settings=SETTINGS, resume=True, progress=lambda *given: told.append(given[2]))
    assert maps_in(tmp_path) == before
    assert told[-1] == "depth"


@pytest.mark.parametrize("why", ["few views", "no interpreter"])
def test_threads_where_processes_do_not_pay_or_cannot_be_started(
    scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, why: str
) -> None:
    monkeypatch.setattr(processes, "start", None)  # cannot be called
    if why == "few views":
        monkeypatch.setattr(in_processes, "_LEAST_OF_ONE", 15)
    else:
        monkeypatch.setattr(sys, "executable", "/opt/qgis/bin/qgis")
    estimate_depth(scene, tmp_path / "any", settings=SETTINGS)
    assert maps_in(tmp_path / "any") == by_threads(scene, tmp_path / "here", monkeypatch)


def _written(folder: Path) -> dict[str, Path]:
    return {f"{path.parent.name}/{path.name}": path for path in folder.glob("*/*.pfm")}


def test_the_model_is_loaded_where_the_maps_are_made(scene: Scene) -> None:
    import pickle

    planned = plan_job(scene.views, SETTINGS)
    assert planned.plan.processes == 2
    maps = _Maps(planned, threads=1)
    asked = (0, scene.views[0], sources_of(scene, scene.views[0], SETTINGS))
    before = len(pickle.dumps(maps))
    number, made = maps(asked)
    assert number == 0
    # Sent anew it takes no model along.
    assert len(pickle.dumps(maps)) == before
    again = pickle.loads(pickle.dumps(maps))
    assert (again(asked)[1].depth == made.depth).all()
