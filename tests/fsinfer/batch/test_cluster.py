"""Plots on a real Dask cluster of two workers, one of which is killed in mid-run: all in the summary, each once."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from fsinfer._version import __version__
from fsinfer.batch.attempt import PlotTask
from fsinfer.batch.cluster import Cluster
from fsinfer.batch.run import BatchResult, PlotNews, run_batch
from fsinfer.batch.settings import BatchSettings
from fsinfer.cluster.pieces import write_pieces
from fsinfer.cluster.workers import scratch_of_worker
from fsinfer.errors import ClusterError
from tests.support.batch_plots import STAND_IN, behave, is_alive, kill, read_csv, started, wait_for, write_table
from tests.support.dask_cluster import RunningCluster, running_cluster

pytest.importorskip("distributed")
pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="looks processes up in /proc"),
    # What Dask says of itself, its files and its sockets is no warning of ours.
    pytest.mark.filterwarnings("default"),
]
#: Columns that tell who did it and how long it took.
OF_THE_RUN = ("attempts", "seconds", "host")


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[RunningCluster]:
    with running_cluster(tmp_path / "dask") as running:
        yield running


def summary(out: Path) -> list[dict[str, str]]:
    return [{k: v for k, v in row.items() if k not in OF_THE_RUN} for row in read_csv(out / "summary.csv")]


def test_fifty_plots_with_one_worker_killed_come_out_as_on_one_computer(
    tmp_path: Path, cluster: RunningCluster
) -> None:
    names = [f"plot {number:02d}" for number in range(50)]
    table = write_table(tmp_path, [{"name": name, "latitude_deg": 47, "longitude_deg": 8} for name in names])
    behave(tmp_path, "plot 07", exit=2, say="Error: too dark; take them by day")
    # Two plots that are under way when their worker is killed, and would be for long.
    for name in ("plot 00", "plot 01", "plot 02", "plot 03"):
        behave(tmp_path, name, seconds=600, child=True, once=True)
    out = tmp_path / "far"
    begun = [out / "plots" / name / "child.txt" for name in names[:4]]
    children: list[int] = []
    killed: list[int] = []

    def kill_the_workers() -> None:
        """Each of the two has two of the four long plots; after the first a third worker takes its place."""
        wait_for(lambda: all(path.is_file() and path.read_text() != "" for path in begun), seconds=120)
        children.extend(int(path.read_text()) for path in begun)
        first = cluster.workers[0]
        kill(first.pid)
        first.wait()
        wait_for(lambda: sum(not is_alive(child) for child in children) == 2, seconds=60)
        killed.append(first.pid)
        # The plots of the other worker are not touched by that; they end now, by themselves.
        for child_file in begun:
            if is_alive(int(child_file.read_text())):
                kill(int((child_file.parent / "pid.txt").read_text()))

    killer = threading.Thread(target=kill_the_workers)
    killer.start()
    result = run(table, out, scheduler=cluster.address)
    killer.join()
    assert killed
    assert [row["plot"] for row in read_csv(out / "summary.csv")] == names
    assert (result.counts.plots, result.counts.done, result.counts.failed) == (50, 49, 1)
    assert result.rows[7].message == "too dark; take them by day"
    # The four were tried again: two had lost their worker, two were killed alone. All others ran once.
    tries = {name: started(out / "plots" / name) for name in names}
    assert {name for name, number in tries.items() if number != 1} == set(names[:4])
    assert set(tries.values()) == {1, 2}
    assert not any(is_alive(child) for child in children)
    # The same on this computer, without the long plots.
    for name in names[:4]:
        (tmp_path / "photos" / name / "behave.json").unlink()
    near = tmp_path / "near"
    run(table, near, jobs=4)
    assert summary(out) == summary(near)
    assert (out / "trees.csv").read_bytes() == (near / "trees.csv").read_bytes()


def test_photos_are_sent_to_workers_that_share_no_disk(tmp_path: Path, cluster: RunningCluster) -> None:
    table, out = write_table(tmp_path, [{"name": name} for name in "abc"]), tmp_path / "far"
    behave(tmp_path, "b", exit=2, say="Error: too dark")
    behave(tmp_path, "c", cloud=9_000_000)
    result = run(table, out, scheduler=cluster.address, copy=True)
    assert {row.plot: row.message for row in result.rows} == {"a": "", "b": "too dark", "c": ""}
    assert (out / "plots" / "c" / "cloud.ply").stat().st_size == 9_000_000
    # It ran in the workers' own folders, of which nothing is left.
    assert not list(cluster.folder.rglob("fsinfer-*"))
    again = run(table, out, scheduler=cluster.address, copy=True)
    assert again.ran == 1
    near = tmp_path / "near"
    run(table, near, jobs=3)
    assert summary(out) == summary(near)


def test_a_batch_that_is_stopped_leaves_no_photos_on_workers(tmp_path: Path, cluster: RunningCluster) -> None:
    """Each thread of the workers is busy with a plot that takes seconds to end, and writes again at its end."""
    table, out = write_table(tmp_path, [{"name": name} for name in "abcd"]), tmp_path / "far"
    for name in "abcd":
        behave(tmp_path, name, seconds=600, end=4.0)
    pids: list[int] = []

    def texts() -> list[str]:
        return [path.read_text() for path in cluster.folder.rglob("fsinfer-*/out/*/pid.txt")]

    def stop() -> None:
        try:
            wait_for(lambda: sum(text != "" for text in texts()) == 4, seconds=120)
            pids.extend(map(int, texts()))
        finally:
            os.kill(os.getpid(), signal.SIGINT)

    stopper = threading.Thread(target=stop)
    stopper.start()
    with pytest.raises(KeyboardInterrupt):
        run(table, out, scheduler=cluster.address, copy=True)
    stopper.join()
    assert len(pids) == 4
    wait_for(lambda: not any(map(is_alive, pids)))
    # Path.rglob would stumble over folders that go away under it.
    wait_for(lambda: not any("fsinfer-" in folder for folder, _, _ in os.walk(cluster.folder)), seconds=10)


def test_when_the_scheduler_stays_away_the_batch_ends_and_keeps_what_is_finished(
    tmp_path: Path, cluster: RunningCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    table, out = write_table(tmp_path, [{"name": name} for name in "abc"]), tmp_path / "far"
    for name in "bc":
        behave(tmp_path, name, seconds=600)

    def news(item: PlotNews) -> None:
        assert item.row.plot == "a"
        monkeypatch.setattr("fsinfer.cluster.workers.ALONE_S", 3.0)
        kill(cluster.scheduler.pid)

    settings = BatchSettings(command=STAND_IN, scheduler=cluster.address)
    with pytest.raises(ClusterError, match=r"does not answer any more.*finished plots are kept"):
        run_batch(table, out, settings=settings, news=news)
    states = {row["plot"]: row["state"] for row in read_csv(out / "summary.csv")}
    assert states == {"a": "done", "b": "waiting", "c": "waiting"}


def run(table: Path, out: Path, **settings: object) -> BatchResult:
    return run_batch(table, out, settings=BatchSettings(command=STAND_IN, **settings))  # type: ignore[arg-type]


class ClosedClient:
    """A client of Dask that has given its scheduler up, while its workers are still on the list."""

    status: str = "closed"

    def nthreads(self) -> dict[str, int]:
        return {"tcp://127.0.0.1:9": 1}

    def run(self, *_: Any, **__: Any) -> dict[str, Any]:
        return {"tcp://127.0.0.1:9": __version__}

    def submit(self, *_: Any, **__: Any) -> DoneFuture:
        raise RuntimeError("closed")

    def close(self) -> None:
        pass


def test_a_client_that_gave_up_is_no_fault_of_a_plot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fsinfer.cluster.workers._connect", lambda *_: ClosedClient())
    cluster = Cluster("tcp://127.0.0.1:8")
    try:
        with pytest.raises(ClusterError, match="does not answer any more"):
            cluster.run(PlotTask(batch="b", photos=tmp_path, out=tmp_path / "out"), ())
    finally:
        cluster.close()


class DoneFuture:
    status = "finished"

    def __init__(self, value: object) -> None:
        self._value = value

    def add_done_callback(self, tell: Callable[[object], None]) -> None:
        tell(self)

    def result(self, timeout: float) -> object:
        return self._value

    def cancel(self) -> None:
        pass


class GivenUpClient(ClosedClient):
    """Its worker is this process; it is given up while photographs are sent, and still reaches workers beside that."""

    def __init__(self, scratch: Path) -> None:
        self.status = "running"
        self._scratch = scratch

    def run(self, *call: Any, **_: Any) -> dict[str, Any]:
        function, *arguments = call
        return {"tcp://127.0.0.1:9": function(*arguments)}

    def submit(self, *call: Any, **_: Any) -> DoneFuture:
        function, *arguments = call
        if self.status == "closed":
            raise RuntimeError("closed")
        if function is scratch_of_worker:
            return DoneFuture(str(self._scratch))
        value = function(*arguments)
        if function is write_pieces:
            self.status = "closed"
        return DoneFuture(value)


def test_photos_that_were_on_their_way_when_the_batch_was_stopped_are_deleted_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    write_table(tmp_path, [{"name": "a"}])
    monkeypatch.setattr("fsinfer.cluster.workers._connect", lambda *_: GivenUpClient(scratch))
    cluster = Cluster("tcp://127.0.0.1:8", copy=True)
    try:
        with pytest.raises(ClusterError):
            cluster.run(PlotTask(batch="b", photos=tmp_path / "photos" / "a", out=tmp_path / "out"), ())
        assert list(scratch.rglob("one.jpg"))
    finally:
        cluster.close()
    assert list(scratch.iterdir()) == []
