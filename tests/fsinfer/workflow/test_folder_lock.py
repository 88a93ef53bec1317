"""One run at a time in an output folder, and no lock that outlives its run."""

from __future__ import annotations

import errno
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from fsinfer.errors import OutputError
from fsinfer.workflow import folder_lock
from fsinfer.workflow.folder_lock import alone_in
from tests.support.places import ROOT

HOLD = """
import sys
from pathlib import Path
from fsinfer.workflow.folder_lock import alone_in
with alone_in(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def other(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(tmp_path)], cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    with process:
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        yield process
        process.kill()


def test_another_process_is_told_that_one_is_at_work(tmp_path: Path, other: subprocess.Popen[str]) -> None:
    with (
        pytest.raises(OutputError, match=r"another run .*choose another"),
        alone_in(tmp_path),
    ):
        pytest.fail("both are at work")
    with alone_in(tmp_path / "beside"):
        pass


def test_a_kill_leaves_no_lock(tmp_path: Path, other: subprocess.Popen[str]) -> None:
    other.kill()
    other.wait()
    with alone_in(tmp_path), alone_in(tmp_path):
        pass


def test_one_thread_as_often_as_it_wants_and_no_other(tmp_path: Path) -> None:
    told: list[str] = []

    def elsewhere() -> None:
        try:
            with alone_in(tmp_path):
                told.append("both are at work")
        except OutputError as error:
            told.append(str(error))

    def ask() -> str:
        thread = threading.Thread(target=elsewhere)
        thread.start()
        thread.join()
        return told[-1]

    with alone_in(tmp_path):
        with alone_in(tmp_path):
            assert "another run of fsinfer is at work" in ask()
        assert "another run of fsinfer is at work" in ask()
    assert ask() == "both are at work"


def test_an_error_gives_the_lock_back(tmp_path: Path) -> None:
    with pytest.raises(KeyError), alone_in(tmp_path):
        raise KeyError
    with alone_in(tmp_path):
        pass


def test_a_folder_without_locks_is_worked_in_all_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def none(_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(folder_lock, "_lock", none)
    with alone_in(tmp_path):
        pass
