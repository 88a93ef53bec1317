"""The guard of a plot's process: it ends in time, within its memory, with all that it has started, and alone."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from fsinfer.batch.guard import Ended, GuardTask, guard
from fsinfer.batch.lease import LEASE_FILE, Lease
from fsinfer.batch.tree_memory import check_can_look, resident_gb
from fsinfer.errors import InputError, OutputError
from tests.support.batch_plots import is_alive, kill, wait_for

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="looks processes up in /proc")

PARENT = """
import subprocess, sys, time
code = "import time; held = bytearray(%d); held[::4096] = b'1' * len(held[::4096]); time.sleep(600)"
child = subprocess.Popen([sys.executable, "-c", code])
print(child.pid, flush=True)
time.sleep(600)
"""


def task(folder: Path, code: str, **limits: float) -> GuardTask:
    return GuardTask(
        command=(sys.executable, "-c", code), log=str(folder / "run.log"), lease_folder=str(folder), **limits
    )


def child_of(folder: Path) -> int:
    """The process that ``PARENT`` has started."""
    log = folder / "run.log"
    wait_for(lambda: log.is_file() and log.read_text().endswith("\n"))
    return int(log.read_text().split()[-1])


def test_a_command_ends_by_itself(tmp_path: Path) -> None:
    result = guard(task(tmp_path, "print('said'); raise SystemExit(7)"), threading.Event())
    assert (result.ended, result.returncode, result.peak_gb) == (Ended.itself, 7, None)
    assert (tmp_path / "run.log").read_text() == "said\n"
    assert not (tmp_path / LEASE_FILE).exists()


def test_it_is_ended_after_its_time_with_what_it_started(tmp_path: Path) -> None:
    result = guard(task(tmp_path, PARENT % 0, limit_minutes=0.05), threading.Event())
    assert result.ended is Ended.time
    child = child_of(tmp_path)
    wait_for(lambda: not is_alive(child))


def test_memory_of_what_it_started_counts(tmp_path: Path) -> None:
    result = guard(task(tmp_path, PARENT % 300_000_000, limit_gb=0.25, limit_minutes=1), threading.Event())
    assert result.ended is Ended.memory
    assert result.peak_gb is not None
    assert 0.25 < result.peak_gb < 0.6
    child = child_of(tmp_path)
    wait_for(lambda: not is_alive(child))


def test_memory_is_seen_without_proc_as_well(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("psutil")
    process = subprocess.Popen([sys.executable, "-c", PARENT % 200_000_000], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        child = int(process.stdout.readline())
        wait_for(lambda: resident_gb(child) > 0.2)
        by_proc = resident_gb(process.pid)
        monkeypatch.setattr("fsinfer.batch.tree_memory._PROC_IS_THERE", False)
        check_can_look()
        assert resident_gb(process.pid) == pytest.approx(by_proc, rel=0.05)
        assert resident_gb(child) < by_proc
        kill(child)
    finally:
        process.kill()
        process.communicate()
    assert resident_gb(process.pid) == 0.0
    monkeypatch.setitem(sys.modules, "psutil", None)
    with pytest.raises(InputError, match="--limit-gb needs the package psutil"):
        check_can_look()


def test_what_a_finished_command_left_behind_is_ended(tmp_path: Path) -> None:
    result = guard(task(tmp_path, PARENT.replace("time.sleep(600)\n", "") % 0), threading.Event())
    assert result.ended is Ended.itself
    child = child_of(tmp_path)
    wait_for(lambda: not is_alive(child))


def test_the_plot_ends_with_whoever_asked_for_it(tmp_path: Path) -> None:
    """As when a worker is killed: the guard is left alone, and so is the plot."""
    given = json.dumps(vars(task(tmp_path, PARENT % 0)))
    code = (
        "import subprocess, sys, time\n"
        "subprocess.Popen([sys.executable, '-m', 'fsinfer.batch.guard', sys.argv[1]], stdin=subprocess.PIPE,"
        " stdout=subprocess.DEVNULL, start_new_session=True)\n"
        "time.sleep(600)"
    )
    asker = subprocess.Popen([sys.executable, "-c", code, given])
    try:
        child = child_of(tmp_path)
        assert is_alive(child)
    finally:
        kill(asker.pid)
        asker.wait()
    wait_for(lambda: not is_alive(child))
    # The next one need not wait.
    wait_for(lambda: not (tmp_path / LEASE_FILE).exists())


def test_two_never_run_in_one_folder(tmp_path: Path) -> None:
    first, second = Lease(tmp_path), Lease(tmp_path)
    assert first.take(lambda: False)
    end = time.monotonic() + 0.5
    assert not second.take(lambda: time.monotonic() > end, pause_s=0.02)
    first.give_back()
    assert second.take(lambda: False)
    # Who has lost it does not take it from the next one.
    first.give_back()
    assert (tmp_path / LEASE_FILE).is_file()


def test_the_folder_of_a_dead_one_is_free_at_once_and_that_of_a_silent_one_later(tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, check=True)
    lease = tmp_path / LEASE_FILE
    import socket

    lease.write_text(json.dumps({"host": socket.gethostname(), "pid": int(done.stdout), "token": "1"}))
    # Long before it would be stale.
    end = time.monotonic() + 20
    assert Lease(tmp_path).take(lambda: time.monotonic() > end)
    lease.write_text(json.dumps({"host": "elsewhere", "pid": 1, "token": "2"}))
    start = time.monotonic()
    assert Lease(tmp_path, stale_s=0.4).take(lambda: False, pause_s=0.02)
    assert time.monotonic() - start > 0.35


def test_the_file_of_a_dead_one_that_cannot_be_moved_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The folder became read-only, or the file is another user's in a folder that all share."""
    lease = tmp_path / LEASE_FILE
    lease.write_text(json.dumps({"host": "elsewhere", "pid": 1, "token": "2"}))
    tried: list[Path] = []

    def refused(path: Path, _: Path) -> None:
        tried.append(path)
        raise PermissionError(1, "Operation not permitted")

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", refused)
        patch.setattr("fsinfer.batch.lease.STUCK_S", 0.5)
        end = time.monotonic() + 20
        words = (
            rf"{LEASE_FILE} is of a run that is gone, and cannot be taken away \(Operation not permitted\); delete it"
        )
        with pytest.raises(OutputError, match=words):
            Lease(tmp_path, stale_s=0.0).take(lambda: time.monotonic() > end)
        # With a pause between two tries.
        assert 2 <= len(tried) < 10
        patch.setattr("fsinfer.batch.guard.Lease", lambda folder: Lease(folder, stale_s=0.0))
        result = guard(task(tmp_path, ""), threading.Event())
        assert (result.ended, result.returncode) == (Ended.unable, None)
        assert "cannot be taken away" in result.message
    # What stood in the way for a moment is no reason to give up.
    with monkeypatch.context() as patch:
        move = Path.replace
        patch.setattr(Path, "replace", lambda path, to: move(path, to) if len(tried) > 30 else refused(path, to))
        tried[:] = [lease] * 28
        assert Lease(tmp_path, stale_s=0.0).take(lambda: False, pause_s=0.02)


def test_a_holder_that_shows_itself_keeps_the_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fsinfer.batch.lease.FRESH_S", 0.0)
    holder, other = Lease(tmp_path), Lease(tmp_path, stale_s=1.0)
    assert holder.take(lambda: False)
    end = time.monotonic() + 2.5

    def stop() -> bool:
        holder.keep()
        return time.monotonic() > end

    assert not other.take(stop, pause_s=0.02)
