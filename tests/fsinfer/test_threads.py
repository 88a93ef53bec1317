"""Linear algebra works in one thread inside fsinfer, and results do not depend on the environment."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import fsinfer
from fsinfer.depth.settings import DepthSettings
from fsinfer.scale.request import ScaleRequest
from fsinfer.scene import read_scene
from fsinfer.threads import one_blas_thread
from tests.support.places import ROOT
from tests.support.plane_scene import write_plane_scene


def blas_threads() -> set[int]:
    return {entry["num_threads"] for entry in threadpool_info() if entry["user_api"] == "blas"}


@pytest.fixture(autouse=True)
def many() -> Any:
    """As many threads as a library would take by itself on a larger machine."""
    import scipy.linalg  # noqa: F401

    with threadpool_limits(limits=3, user_api="blas"):
        if blas_threads() != {3}:
            pytest.skip("this NumPy is built without a library whose threads can be set")
        yield


def test_one_inside_and_as_before_afterwards() -> None:
    with one_blas_thread():
        assert blas_threads() == {1}
        with one_blas_thread():
            assert blas_threads() == {1}
        assert blas_threads() == {1}
    assert blas_threads() == {3}

    @one_blas_thread()
    def work(value: int) -> set[int]:
        assert value == 5
        return blas_threads()

    assert (work(5), work(value=5)) == ({1}, {1})
    with pytest.raises(ValueError, match="x"), one_blas_thread():
        raise ValueError("x")
    assert blas_threads() == {3}


def test_calls_that_overlap_do_not_undo_each_other() -> None:
    entered, leave = threading.Event(), threading.Event()

    def hold() -> None:
        with one_blas_thread():
            entered.set()
            leave.wait()

    other = threading.Thread(target=hold)
    with one_blas_thread():
        other.start()
        entered.wait()
    assert blas_threads() == {1}
    leave.set()
    other.join()
    assert blas_threads() == {3}


def seen_in(monkeypatch: pytest.MonkeyPatch, name: str, call: Callable[[], Any]) -> set[int]:
    """Threads of BLAS when the function of that name is called inside ``call``."""

    class Seen(Exception):
        pass

    def look(*_args: object, **_options: object) -> None:
        raise Seen(*blas_threads())

    monkeypatch.setattr(name, look)
    with pytest.raises(Seen) as caught:
        call()
    return set(caught.value.args)


def test_every_way_into_fsinfer_sets_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from fsinfer.check import check_capture
    from fsinfer.depth.stage import estimate_depth
    from fsinfer.workflow.measure_cloud import measure_cloud_file
    from fsinfer.workflow.pipeline import run

    folder = write_plane_scene(tmp_path / "scene")
    scene = read_scene(folder)
    out = tmp_path / "out"
    cloud = tmp_path / "a.ply"
    cloud.touch()
    ways: dict[str, Callable[[], Any]] = {
        "fsinfer.workflow.pipeline.Ledger": lambda: run(folder / "images", out),
        "fsinfer.depth.job.view_image_size": lambda: estimate_depth(scene, out, settings=DepthSettings(threads=1)),
        "fsinfer.workflow.measure_cloud.find_edits": lambda: measure_cloud_file(cloud, out, request=ScaleRequest()),
        "fsinfer.check.run.Ledger": lambda: check_capture(folder / "images", out),
        "fsinfer.trees.measure.clean": lambda: fsinfer.measure_trees(np.zeros((10, 3))),
    }
    for name, call in ways.items():
        with monkeypatch.context() as patch:
            assert seen_in(patch, name, call) == {1}, name
    model = fsinfer.DepthModel.load("field", threads=1)
    image = np.zeros((64, 96, 3), np.uint8)
    views = [image, image], np.stack([np.eye(3)] * 2), np.stack([np.eye(4)] * 2), (1.0, 2.0)
    for volume in ("model.plane_correlation_volume", "narrow_volumes.weighted_correlation_volume"):
        with monkeypatch.context() as patch:
            assert seen_in(patch, f"fsinfer.depth.{volume}", lambda: model.predict(*views)) == {1}
    assert blas_threads() == {3}


def test_the_environment_does_not_change_depth(tmp_path: Path) -> None:
    code = (
        "import hashlib, sys, numpy as np, fsinfer\n"
        "from tests.bench.speed import make_views\n"
        "model = fsinfer.DepthModel.load('field', threads=2, precision='float32')\n"
        "found = model.predict(*make_views(3, 96, 160))\n"
        "print(hashlib.sha256(found.depth.tobytes() + found.confidence.tobytes()).hexdigest())\n"
    )
    digests = set()
    for threads in ("1", "2", "7"):
        environment = os.environ | {"OPENBLAS_NUM_THREADS": threads, "PYTHONPATH": str(ROOT)}
        done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
        digests.add(done.stdout)
    assert len(digests) == 1
