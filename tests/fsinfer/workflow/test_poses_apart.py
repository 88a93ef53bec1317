"""Poses in a process of their own: the same as in this one, and no crash, kill or key press takes the run with it."""

from __future__ import annotations

import json
import logging
import os
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fsinfer.child_process import python_command
from fsinfer.errors import PosesError
from fsinfer.io.images import write_image
from fsinfer.output.json_values import as_json
from fsinfer.poses.estimate import estimate_poses
from fsinfer.poses.pairs import PairSettings
from fsinfer.poses.settings import PoseSettings
from fsinfer.workflow import poses_apart
from fsinfer.workflow.memory_peak import MemoryPeak
from fsinfer.workflow.poses_apart import estimate_poses_apart
from tests.support.command_line import Call
from tests.support.places import ROOT
from tests.support.rendered_room import photographs

SETTINGS = PoseSettings(max_features=1000, pairs=PairSettings(overlap=3), default_focal_factor=0.875, threads=1)
#: Far more than any of this takes, for machines that are busy with something else. Seconds.
PATIENCE_S = 300.0
#: What is promised is one second, and what is struck so hangs for ten minutes: a machine that is busy gets more.
AT_ONCE_S = 30.0

needs_signals = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")
Strike = Callable[[str, str], None]


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("Fotos ä 林")
    for index, image in enumerate(photographs()[:4]):
        write_image(folder / f"Bäume {index}.jpg", image)
    return folder


@pytest.fixture
def strike(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Strike:
    """Let the process be struck at a step."""

    def arm(step: str, how: str) -> None:
        monkeypatch.setattr(poses_apart, "_MODULE", "tests.support.struck_poses")
        for name, value in struck(step, how, tmp_path).items():
            monkeypatch.setenv(name, value)

    return arm


def struck(step: str, how: str, folder: Path) -> dict[str, str]:
    return {"STRUCK_STEP": step, "STRUCK_HOW": how, "STRUCK_MARK": str(folder / "mark")}


def files_of(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_scene_result_progress_and_warnings_are_those_of_the_same_process(
    photos: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    given = tmp_path / "given"
    given.mkdir()
    for path in photos.iterdir():
        (given / path.name).write_bytes(path.read_bytes())
    (given / "cut.jpg").write_bytes(b"\xff\xd8\xff\xe0 this is no photograph")
    found, steps, said = [], [], []
    for name, estimate in (("here", estimate_poses), ("apart", estimate_poses_apart)):
        told: list[tuple[int, int, str]] = []
        caplog.clear()
        with caplog.at_level(logging.WARNING, logger="fsinfer"):
            found.append(
                estimate(given, tmp_path / name, settings=SETTINGS, progress=lambda *step, to=told: to.append(step))
            )
        steps.append(told)
        said.append([(record.name, record.levelno, record.getMessage()) for record in caplog.records])
    assert found[1] == replace(found[0], scene=tmp_path / "apart")
    assert (found[1].registered, len(found[1].warnings)) == (4, 1)
    assert files_of(tmp_path / "apart") == files_of(tmp_path / "here")
    assert len(steps[0]) > 8
    assert steps[1] == steps[0]
    assert said[1] == said[0]
    assert "cut.jpg" in said[0][0][2]


def test_what_the_user_did_wrong_is_said_in_the_same_words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("queue.py", "json.py"):  # files where the user is are no modules of Python's
        (tmp_path / name).write_text("raise SystemExit('taken from the folder of the user')", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(0)
    for index in range(3):
        write_image(tmp_path / "noise" / f"n{index}.png", rng.integers(0, 255, (60, 80, 3), dtype=np.uint8))
    told = []
    for estimate in (estimate_poses, estimate_poses_apart):
        with pytest.raises(PosesError, match=r"walk\.mp4.*overlap") as caught:
            estimate(tmp_path / "noise", tmp_path / "out", settings=SETTINGS, origin=tmp_path / "walk.mp4")
        told.append(str(caught.value))
    assert told[0] == told[1]


@needs_signals
def test_a_crash_ends_no_run_and_the_same_command_goes_on(
    call: Call, strike: Strike, photos: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    words = {}
    for step, how in (("matching photos", "SIGSEGV"), ("placing photos", "SIGKILL")):
        strike(step, how)
        code, _, err = call("poses", photos, out, "--jobs", 1, "-q")
        assert code == 2, err
        (words[how],) = [line for line in err.splitlines() if line]
    crashed = "Error: finding poses crashed while matching photos (0 of 6) (SIGSEGV); what is done is kept: run the "
    assert words["SIGSEGV"].startswith(crashed)
    assert words["SIGSEGV"].endswith(f"delete {out / 'work'} first")
    told = "ended while placing photos (0 of 4) (SIGKILL), most likely since this computer has not enough free memory"
    assert told in words["SIGKILL"]
    strike("reading photos", "no features")
    here_mb = MemoryPeak().read_mb()
    code, text, err = call("poses", photos, out, "--jobs", 1, "-q")
    assert (code, "4 of 4 photos placed" in text) == (0, True), err
    # The memory of both counts, and for this stage alone.
    peak_mb = json.loads((out / ".fsinfer" / "poses.json").read_text(encoding="utf-8"))["peak_rss_mb"]
    assert here_mb is not None
    assert peak_mb > here_mb + 50
    assert (MemoryPeak().read_mb() or 0.0) < peak_mb - 50


def test_a_crash_tells_what_was_said_before(tmp_path: Path) -> None:
    noise = deque(
        ["F20261122 mapper.cc:12] Check failed: a > b", "*** Check failure stack trace: ***", "    @  0x7f core", ""]
    )
    error = str(poses_apart._crash(-6, "at its start", noise, tmp_path))
    assert "crashed at its start (SIGABRT, last words: F20261122 mapper.cc:12] Check failed: a > b);" in error
    noise = deque(["terminate called after throwing an instance of 'std::bad_alloc'", "  what():  std::bad_alloc"])
    error = str(poses_apart._crash(-6, "at its start", noise, tmp_path))
    assert "ended at its start (SIGABRT), most likely since this computer has not enough free memory" in error
    assert "(exit code 0xC0000005);" in str(poses_apart._crash(0xC0000005, "", deque(), tmp_path))
    assert "(signal 99);" in str(poses_apart._crash(-99, "", deque(), tmp_path))


def test_a_fault_of_ours_stays_one_with_its_trace(call: Call, strike: Strike, photos: Path, tmp_path: Path) -> None:
    strike("reading photos", "our fault")
    code, _, err = call("poses", photos, tmp_path / "out", "-q")
    assert code == 1
    assert "Internal error (KeyError: ('ours', 3))" in err
    log = (tmp_path / "out" / "fsinfer.log").read_text(encoding="utf-8")
    assert 'in strike\n    raise KeyError("ours", 3)' in log
    strike("reading photos", "full disk")
    code, _, err = call("poses", photos, tmp_path / "out", "-q")
    assert (code, "No space left on device: there.jpg; free some space" in err) == (2, True), err


def test_what_the_callback_raises_ends_the_process(
    strike: Strike, photos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Stop(Exception):
        pass

    def stop(*_: object) -> None:
        raise Stop

    started: list[subprocess.Popen[bytes]] = []

    class Noted(subprocess.Popen[bytes]):
        def __init__(self, *args: object, **options: object) -> None:
            super().__init__(*args, **options)  # type: ignore[call-overload]
            started.append(self)

    monkeypatch.setattr(subprocess, "Popen", Noted)
    strike("reading photos", "wait")
    with pytest.raises(Stop):
        estimate_poses_apart(photos, tmp_path / "out", settings=SETTINGS, progress=stop)
    (process,) = started
    assert process.returncode is not None


@needs_signals
@pytest.mark.parametrize(("step", "number"), [("matching photos", "SIGINT"), ("reading photos", "SIGKILL")])
def test_ctrl_c_is_answered_at_once_and_nothing_stays_behind(
    photos: Path, tmp_path: Path, step: str, number: str
) -> None:
    code = (
        "import sys; from fsinfer.workflow import poses_apart; poses_apart._MODULE = 'tests.support.struck_poses'\n"
        "from fsinfer.cli.app import main; main()"
    )
    command = [sys.executable, "-c", code, "poses", str(photos), str(tmp_path / "out"), "--jobs", "1", "--quiet"]
    environment = os.environ | struck(step, "hang", tmp_path) | {"PYTHONPATH": str(ROOT)}
    run = subprocess.Popen(command, cwd=ROOT, env=environment, stderr=subprocess.PIPE, start_new_session=True)
    with run:
        try:
            child = wait_for_mark(tmp_path / "mark")
            asked = time.monotonic()
            # A terminal gives Ctrl-C to all processes of its group.
            (os.kill if number == "SIGKILL" else os.killpg)(run.pid, getattr(signal, number))
            code_ = run.wait(PATIENCE_S)
            took_s = time.monotonic() - asked
            said = b"" if run.stderr is None else run.stderr.read()
        finally:
            run.kill()
    if number == "SIGKILL":
        assert code_ == -signal.SIGKILL
    else:
        assert (code_, said.decode()) == (
            130, "Stopped. What is finished is kept: run the same command again to go on.\n",
        )  # fmt: skip
        assert took_s < AT_ONCE_S
    if number != "SIGKILL" or sys.platform == "linux":
        deadline = time.monotonic() + AT_ONCE_S
        while is_there(child) and time.monotonic() < deadline:
            time.sleep(0.02)
        assert not is_there(child)


def wait_for_mark(mark: Path) -> int:
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        if mark.is_file() and (text := mark.read_text(encoding="ascii")):
            return int(text)
        time.sleep(0.02)
    pytest.fail("the process did not come so far")


def is_there(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    # Whoever inherits it may not have asked for its end yet.
    status = Path(f"/proc/{pid}/stat")
    return not (status.is_file() and status.read_text(encoding="ascii", errors="replace").rpartition(")")[2][1] == "Z")


def test_without_anybody_who_listens_the_process_ends(
    strike: Strike, photos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    strike("reading photos", "wait")
    task = {
        "images": str(photos),
        "out": str(tmp_path / "out"),
        "settings": as_json(SETTINGS),
        "origin": None,
        "resume": False,
        "parent": os.getpid(),
        "log_level": logging.WARNING,
    }
    command = python_command(poses_apart._MODULE)
    assert command is not None
    with poses_apart._started(command, json.loads(json.dumps(task))) as (process, messages, _):
        assert "progress" in next(messages)
        if sys.platform != "win32":
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):  # which are for whoever started it
                process.send_signal(number)
        assert process.stdin is not None
        process.stdin.close()
        assert process.wait(PATIENCE_S) == 1


@pytest.mark.parametrize("program", ["", "/opt/qgis/bin/qgis"])
def test_a_program_that_is_no_interpreter_is_not_started_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, program: str
) -> None:
    monkeypatch.setattr(sys, "executable", program)
    monkeypatch.setattr(subprocess, "Popen", None)
    write_image(tmp_path / "one" / "a.png", np.zeros((60, 80, 3), np.uint8))
    with pytest.raises(PosesError, match="one photo"):
        estimate_poses_apart(tmp_path / "one", tmp_path / "out", settings=SETTINGS)
