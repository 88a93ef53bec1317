"""The command line as a shell would run it, in this process."""

from __future__ import annotations

import sys
from collections.abc import Callable

import pytest

from fsinfer.cli.app import main

#: Runs it with words; returns exit code, stdout, stderr.
Call = Callable[..., tuple[int, str, str]]


def caller(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Call:
    """What runs the command line and catches what it prints."""

    def run(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["fsinfer", *(str(a) for a in arguments)])
        with pytest.raises(SystemExit) as stopped:
            main()
        captured = capfd.readouterr()
        return int(stopped.value.code or 0), captured.out, captured.err

    return run
