"""Depth maps of several views at a time, and the feature maps that they share."""

from __future__ import annotations

import re
import threading
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fsinfer.depth import stage, view_maps
from fsinfer.depth.cost_volume import Features
from fsinfer.depth.job import DepthJob, plan_job
from fsinfer.depth.manifest import read_manifest
from fsinfer.depth.model import DepthModel
from fsinfer.depth.settings import DepthSettings
from fsinfer.depth.stage import estimate_depth
from fsinfer.depth.view_group import ViewFeatures, ViewGroup
from fsinfer.depth.view_maps import LoadedView, MapsOfViews, ViewMaps, load_view, sources_of
from fsinfer.errors import InputError
from fsinfer.notices.sentences import sentence
from fsinfer.scene import Scene, View, read_scene
from tests.support.plane_scene import write_plane_scene

SETTINGS = DepthSettings(threads=2, precision="int8")


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    return read_scene(write_plane_scene(tmp_path / "scene", height=75, width=90))


def test_features_of_several_images_are_those_of_each() -> None:
    rng = np.random.default_rng(4)
    images = [rng.integers(0, 255, (70, 96, 3), dtype=np.uint8) for _ in range(3)]
    model = DepthModel.load("cascade", threads=2, precision="int8")
    for found, image in zip(model.features_of(images), images, strict=True):
        for of_several, of_one in zip((found.quarter, found.half), vars(model.features(image)).values(), strict=True):
            assert of_several is not None
            for a, b in zip(of_several.groups, of_one.groups, strict=True):
                np.testing.assert_array_equal(a, b)


def test_maps_made_two_at_a_time_are_those_made_one_by_one(
    scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    of = MapsOfViews.of
    # The first two are computed once both have begun, or never.
    together = threading.Barrier(2, timeout=60)
    begun: list[str] = []

    def meeting(self: MapsOfViews, view: View, sources: Sequence[View]) -> ViewMaps:
        begun.append(view.name)
        if len(begun) <= 2:
            together.wait()
        return of(self, view, sources)

    monkeypatch.setattr(MapsOfViews, "of", meeting)
    told: list[str] = []
    estimate_depth(scene, tmp_path / "two", settings=SETTINGS, progress=lambda *given: told.append(given[2]))
    monkeypatch.setattr(MapsOfViews, "of", of)
    estimate_depth(scene, tmp_path / "one", settings=replace(SETTINGS, threads=1))
    for kind in ("depth", "confidence"):
        for view in scene.views:
            one, two = (tmp_path / times / kind / f"{view.name}.pfm" for times in ("one", "two"))
            assert one.read_bytes() == two.read_bytes()
    assert told == [*(f"depth of {view.name}" for view in scene.views), "depth"]


def test_views_without_sources_are_told_of(scene: Scene, tmp_path: Path) -> None:
    assert estimate_depth(scene, tmp_path / "all", settings=SETTINGS).warnings == ()
    alone = replace(scene, views=(replace(scene.views[0], sources=()), *scene.views[1:]))
    (told,) = estimate_depth(alone, tmp_path / "two", settings=SETTINGS).warnings
    assert not (tmp_path / "two" / "depth" / f"{scene.views[0].name}.pfm").exists()
    assert sentence(told) == (
        f"1 of {len(scene.views)} views have no source view in pair.txt, and no depth map ({scene.views[0].name})"
    )


@pytest.mark.parametrize("which", ["intrinsics", "cam_from_world"])
def test_cameras_that_are_no_numbers_are_refused(which: str) -> None:
    cameras = {"intrinsics": np.stack([np.eye(3)] * 2), "cam_from_world": np.stack([np.eye(4)] * 2)}
    cameras[which][1, 0, 0] = np.nan
    features = [ViewFeatures(quarter=Features.from_chw(np.zeros((4, 4, 4), np.float32)), half=None)] * 2
    with pytest.raises(InputError, match="must be finite"):
        ViewGroup.of(features, **cameras, depth_range=(1.0, 2.0))


def test_two_threads_load_a_photograph_once(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    loads: Counter[str] = Counter()

    def counted(model: DepthModel, view: View, settings: DepthSettings) -> LoadedView:
        loads[view.name] += 1
        return load_view(model, view, settings)

    monkeypatch.setattr(view_maps, "load_view", counted)
    job = plan_job(scene.views, SETTINGS)
    maps = MapsOfViews(job, plan=job.plan, threads=1)
    begin = threading.Barrier(4)

    def ask(view: View) -> None:
        begin.wait()
        maps.of(view, sources_of(scene, view, SETTINGS))

    asking = [threading.Thread(target=ask, args=(scene.views[number % 3],)) for number in range(4)]
    for one in asking:
        one.start()
    for one in asking:
        one.join()
    assert loads == {view.name: 1 for view in scene.views}


def test_a_graphics_card_and_a_worker_of_a_cluster_compute_one_at_a_time(scene: Scene) -> None:
    assert plan_job(scene.views, SETTINGS).plan.at_once == 2
    assert plan_job(scene.views, replace(SETTINGS, provider="CPUExecutionProvider")).plan.at_once == 2
    assert plan_job(scene.views, replace(SETTINGS, provider="cuda")).plan.at_once == 1
    assert plan_job(scene.views, replace(SETTINGS, scheduler="tcp://10.0.0.1:8786")).plan.at_once == 1


@pytest.mark.parametrize(("at_once", "threads"), [(1, (5, 5)), (2, (3, 4)), (3, (2, 3)), (9, (2, 3))])
def test_the_cores_are_shared_out_among_the_maps(
    scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at_once: int, threads: tuple[int, int]
) -> None:
    class AskedError(Exception):
        pass

    def planned(views: Sequence[View], settings: DepthSettings) -> DepthJob:
        job = plan_job(views, settings)
        return replace(job, plan=replace(job.plan, at_once=at_once))

    def maps(_job: DepthJob, *, plan: object, threads: int, graph_threads: int) -> None:
        raise AskedError(threads, graph_threads)

    monkeypatch.setattr(stage, "plan_job", planned)
    monkeypatch.setattr(stage, "MapsOfViews", maps)
    # Of nine at a time there are three views to share them out among.
    with pytest.raises(AskedError, match=re.escape(str(threads))):
        estimate_depth(scene, tmp_path / "out", settings=replace(SETTINGS, threads=5))


@pytest.mark.parametrize("regularizers", [1, 2])
def test_no_more_maps_are_in_the_regularizer_than_are_let_in(regularizers: int) -> None:
    inside, most = 0, 0
    lock = threading.Lock()

    class Regularizer:
        def run_two(self, _feeds: object) -> tuple[int, int]:
            nonlocal inside, most
            with lock:
                inside += 1
                most = max(most, inside)
            time.sleep(0.05)
            with lock:
                inside -= 1
            return 0, 0

    model = DepthModel(read_manifest("field"), {"regularizer": Regularizer()}, 1, "int8", regularizers=regularizers)
    asking = [threading.Thread(target=model.regularize, args=(None,)) for _ in range(5)]
    for one in asking:
        one.start()
    for one in asking:
        one.join()
    assert most == regularizers
