"""``fsinfer scale`` as its user meets it: the address, the end, Ctrl-C, and input that is none."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import pytest

from fsinfer.errors import ScaleError
from fsinfer.scale.clicks.file import read_clicks
from fsinfer.scale.clicks.server import ClickServer
from fsinfer.scene import read_scene
from tests.fsinfer.scale.test_click_server import true_clicks
from tests.support.command_line import Call
from tests.support.places import ROOT
from tests.support.synthetic_plot import M_PER_UNIT, write_scene_folder


def started(out: Path, *options: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "fsinfer", "scale", str(out), *options]
    environment = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
    environment |= {"PYTHONUNBUFFERED": "1", "PYTHONPATH": str(ROOT), "COLUMNS": "200"}
    # A shell's background job ignores Ctrl-C, and a program begun in it would, too.
    inherited = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        return subprocess.Popen(
            command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
    finally:
        signal.signal(signal.SIGINT, inherited)


def address(program: subprocess.Popen[str]) -> str:
    assert program.stdout is not None
    line = program.stdout.readline()
    found = re.search(r"http://127\.0\.0\.1:\d+/[\w-]{32}/", line)
    assert found, (line, program.stderr.read() if program.stderr else "")
    return found[0]


def post(url: str, clicks: object) -> dict[str, object]:
    with urlopen(Request(url, json.dumps({"clicks": clicks}).encode(), method="POST"), timeout=30) as answer:
        content: dict[str, object] = json.load(answer)
        return content


@pytest.fixture
def out(tmp_path: Path) -> Path:
    write_scene_folder(tmp_path / "scene")
    return tmp_path


# Without a screen no browser is opened, whether it was asked for or not.
@pytest.mark.parametrize("options", [["--no-browser"], [] if sys.platform.startswith("linux") else ["--no-browser"]])
def test_clicks_end_it_well(out: Path, options: list[str]) -> None:
    with started(out, "--click", "--length-m", "1.0", *options) as program:
        url = address(program)
        with urlopen(url, timeout=30) as page:
            assert b"Click the two ends of the 1.0 m length" in page.read()
        with pytest.raises(HTTPError, match="403"):
            urlopen(url[:-2] + "/", timeout=30)
        post(url + "use", true_clicks(read_scene(out / "scene"), 0, 3))
        # What was read with the address is in the stream's buffer, which communicate() passes by.
        assert program.stdout is not None
        assert program.stderr is not None
        said, errors = program.stdout.read(), program.stderr.read()
    assert program.returncode == 0, errors
    assert "Open this address in a browser" in said
    assert f"Scale: {M_PER_UNIT:g} m per model unit, ± " in said
    assert "by 2 photos; the ends miss the clicks by up to 0.0 and 0.0 pixels" in said
    # There was no run to go on with.
    assert "scale_clicks.json; fsinfer run with the same photos" in said
    assert read_clicks(out).used is not None


@pytest.mark.skipif(sys.platform == "win32", reason="Windows sends no such signal to another program")
def test_ctrl_c_loses_nothing(out: Path) -> None:
    used = true_clicks(read_scene(out / "scene"), 0, 3)
    with started(out, "--click", "--length-m", "1", "--no-browser") as program:
        post(address(program) + "use", used)
        program.communicate(timeout=60)
    with started(out, "--click", "--length-m", "2", "--no-browser") as program:
        post(address(program) + "draft", {"view_05": [[1.5, 2.5], None]})
        program.send_signal(signal.SIGINT)
        _, errors = program.communicate(timeout=60)
    assert program.returncode == 130
    assert errors.strip().splitlines()[-1].startswith("Stopped. What is finished is kept")
    saved = read_clicks(out)
    assert saved.draft == {"view_05": ((1.5, 2.5), None)}
    assert saved.used is not None
    assert saved.used.length_m == 1.0


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ([], "--click and --length-m are missing"),
        (["--click"], "--length-m is missing; for example: fsinfer scale"),
        (["--click", "--length-m", "0"], "--length-m is 0.0; give a number above 0"),
        (["--click", "--length-m", "-1"], "give a number above 0"),
        (["--click", "--length-m", "nan"], "give a number above 0"),
        (["--length-m", "1"], "--click is missing"),
    ],
)
def test_bad_options_are_one_message(out: Path, call: Call, options: list[str], words: str) -> None:
    code, told, error = call("scale", out, *options)
    assert (code, told) == (2, "")
    (line,) = error.strip().splitlines()
    assert words in line
    assert sorted(path.name for path in out.iterdir()) == ["scene"]


def test_a_folder_without_a_scene_is_one_message(tmp_path: Path, call: Call) -> None:
    for folder in (tmp_path / "none", tmp_path):
        code, _, error = call("scale", folder, "--click", "--length-m", "1")
        assert code == 2
        (line,) = error.strip().splitlines()
        assert line.startswith("Error: ")
        assert "is not a folder" in line


@pytest.mark.parametrize(
    ("options", "opens", "opened"), [([], True, True), ([], False, True), (["--no-browser"], True, False)]
)
def test_the_page_is_opened_in_the_browser(
    call: Call, out: Path, monkeypatch: pytest.MonkeyPatch, options: list[str], opens: bool, opened: bool
) -> None:
    asked: list[str] = []
    monkeypatch.setenv("DISPLAY", ":0")

    def browser(url: str) -> bool:
        asked.append(url)
        return opens

    def show_only(folder: Path, length_m: float, *, show: Callable[[str], None], progress: object) -> None:
        assert (folder, length_m) == (out, 1.5)
        show("http://127.0.0.1:1/token/")
        raise ScaleError

    monkeypatch.setattr("webbrowser.open", browser)
    monkeypatch.setattr("fsinfer.workflow.clicked_scale.click_scale", show_only)
    code, said, _ = call("scale", out, "--click", "--length-m", "1.5", *options)
    assert code == 2
    assert asked == (["http://127.0.0.1:1/token/"] if opened else [])
    assert "Click the two ends here: http://127.0.0.1:1/token/" in said
    # Where no browser shows it, it is said what to do.
    assert ("Open this address in a browser" in said) is not (opened and opens)


def test_a_folder_that_cannot_be_written_is_told_before_the_clicks(
    out: Path, call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Whoever runs the tests as root may write everywhere.
    monkeypatch.setattr(os, "access", lambda path, mode: mode != os.W_OK or Path(path) != out)
    monkeypatch.setattr(ClickServer, "wait", lambda _: pytest.fail("the page is not to be shown"))
    code, said, errors = call("scale", out, "--click", "--length-m", "1", "--no-browser")
    assert (code, said) == (2, "")
    assert f"cannot write into {out}: no permission" in errors
