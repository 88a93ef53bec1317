"""A fault of fsinfer ends with code 1, keeps its trace and says how to report it."""

from __future__ import annotations

import sys
import tempfile
import zipfile
from pathlib import Path

import pytest
import typer
import yaml

from fsinfer.cli import console
from fsinfer.cli.app import main
from fsinfer.cli.console import explain, reports_errors
from fsinfer.cli.faults import ISSUE_FORM
from fsinfer.errors import CloudError
from tests.support.places import ROOT


@reports_errors
def command(out: Path | None = None, *, error: Exception) -> None:
    raise error


def code_of(**given: object) -> int:
    with pytest.raises(typer.Exit) as stopped:
        command(**given)  # type: ignore[arg-type]
    return int(stopped.value.exit_code)


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    return tmp_path / "temporary"


def test_the_trace_is_kept_in_the_output_folder(
    tmp_path: Path, temporary: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "plot"
    out.mkdir()
    for number in range(2):
        assert code_of(out=out, error=ZeroDivisionError(f"number {number}")) == 1
    told = capsys.readouterr().err
    assert "Traceback" not in told
    assert f"Its details are in {out / 'fsinfer.log'}" in told
    assert f"fsinfer support {out} " in told
    log = (out / "fsinfer.log").read_text(encoding="utf-8")
    # Both, one after the other, down to the line that failed.
    assert log.count("Traceback (most recent call last)") == 2
    assert "ZeroDivisionError: number 1" in log
    assert "raise error" in log
    assert list(temporary.iterdir()) == []


def test_without_an_output_folder_the_trace_is_kept_among_temporary_files(
    tmp_path: Path, temporary: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for out in (None, tmp_path / "missing"):
        assert code_of(out=out, error=KeyError("x")) == 1
        assert str(temporary / "fsinfer.log") in capsys.readouterr().err
    assert not (tmp_path / "missing").exists()
    (temporary / "fsinfer.log").unlink()
    (temporary / "fsinfer.log").mkdir()  # cannot be written either
    assert code_of(error=KeyError("x")) == 1
    assert "--debug" in capsys.readouterr().err


def test_an_error_of_the_user_leaves_no_trace(
    tmp_path: Path, temporary: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert code_of(out=tmp_path, error=CloudError("a.ply is empty; export it again")) == 2
    assert capsys.readouterr().err == "Error: a.ply is empty; export it again\n"
    assert not (tmp_path / "fsinfer.log").exists()
    assert list(temporary.iterdir()) == []


def test_the_support_zip_holds_the_trace_of_a_run_that_failed_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(*_args: object, **_options: object) -> None:
        raise IndexError("list index out of range")

    monkeypatch.setattr("fsinfer.workflow.single_stages.depth_of", broken)
    out = tmp_path / "plot"
    out.mkdir()
    for arguments, expected in ((["depth", str(tmp_path), str(out)], 1), (["support", str(out)], 0)):
        monkeypatch.setattr(sys, "argv", ["fsinfer", *arguments])
        with pytest.raises(SystemExit) as stopped:
            main()
        assert int(stopped.value.code or 0) == expected, capsys.readouterr().err
    with zipfile.ZipFile(tmp_path / "plot-support.zip") as archive:
        log = archive.read("fsinfer.log").decode()
    assert "IndexError: list index out of range" in log
    assert str(tmp_path) not in log


@pytest.mark.parametrize(
    "error",
    [MemoryError(), RuntimeError("std::bad_alloc"), OSError(12, "Cannot allocate memory"),
     RuntimeError("can't start new thread"), ImportError("x.so: failed to map segment from shared object")],
)  # fmt: skip
def test_too_little_memory_is_told_whatever_says_so(error: Exception) -> None:
    message, code = explain(error)
    assert (code, "not enough free memory" in message) == (2, True)


def test_a_strange_error_while_there_is_no_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    strange = SystemError("error return without exception set")
    assert explain(strange)[1] == 1
    monkeypatch.setattr(console, "_PROBE_BYTES", 1 << 62)
    message, code = explain(strange)
    assert (code, "not enough free memory" in message) == (2, True)


def test_the_form_is_there() -> None:
    form = yaml.safe_load((ROOT / ".github" / "ISSUE_TEMPLATE" / "plot_failed.yml").read_text(encoding="utf-8"))
    assert form["name"] == ISSUE_FORM
    assert "fsinfer.log" in str(form)
