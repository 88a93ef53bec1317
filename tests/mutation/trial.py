"""One trial: the tests of a module against a breakage of it, in a process of its own with a time limit."""

from __future__ import annotations

import importlib
import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from tests.mutation.loader import BrokenModule

#: A process that is forked has the libraries already, which takes longer to load than most tests to run.
METHOD = "fork" if "fork" in multiprocessing.get_all_start_methods() and sys.platform != "darwin" else "spawn"
#: Seconds of the clock for one of a core.
WALL_TIMES = 30.0


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """``state`` is ``survived``, ``killed`` or ``timeout``, ``by`` which test failed first, ``seconds`` of a core."""

    state: str
    by: str
    seconds: float


def try_tests(root: Path, tests: Sequence[str], *, limit_s: float, broken: tuple[str, str] | None = None) -> Outcome:
    """Run ``tests`` of the repository ``root``, with ``broken`` = (file, source) in the place of that file.

    Stops at the first failure. Tests that take more than ``limit_s`` seconds of a core are killed, and count as tests
    that fail; seconds of a core, because a busy machine must not look like a breakage that hangs. What sleeps for ever
    is killed after :data:`WALL_TIMES` so many seconds of the clock.
    """
    context: Any = multiprocessing.get_context(METHOD)  # what is common to all kinds has no process
    here, there = context.Pipe(duplex=False)
    process = context.Process(target=_run, args=(root, list(tests), broken, limit_s, there))
    start = _core_seconds()
    process.start()
    there.close()
    process.join(WALL_TIMES * limit_s)
    if process.is_alive():
        _kill(process.pid)
        process.join()
        return Outcome(state="timeout", by="", seconds=_core_seconds() - start)
    seconds = _core_seconds() - start
    try:
        by = str(here.recv()) if here.poll() else ""
    except EOFError:
        by = ""
    if process.exitcode == 0:
        return Outcome(state="survived", by="", seconds=seconds)
    return Outcome(state="timeout" if not by and seconds >= limit_s else "killed", by=by, seconds=seconds)


def _core_seconds() -> float:
    """Seconds that the children that have ended took of a core; of the clock where the system does not tell."""
    if sys.platform == "win32":
        return time.perf_counter()
    import resource

    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def load_libraries(cache: Path, *, with_torch: bool) -> None:
    """Import what the tests need and what starts no thread by that, so that a fork has it.

    ``cache`` is a folder for the bytecode of modules and tests, which pytest would else make anew in each trial; that
    of a broken module never goes there. Together this is nine tenths of the time of a quick test.
    """
    sys.dont_write_bytecode, sys.pycache_prefix = False, str(cache)
    names = ["cv2", "numpy", "pytest", "scipy.optimize", "scipy.spatial", "scipy.ndimage", "PIL.Image"]
    names += ["hypothesis", "hypothesis.strategies", "hypothesis.extra.numpy", "_hypothesis_pytestplugin"]
    for name in [*names, *(["torch"] if with_torch else [])]:
        importlib.import_module(name)


def _kill(pid: int | None) -> None:
    if pid is None:
        return
    if sys.platform == "win32":
        os.kill(pid, signal.SIGTERM)
    else:
        os.killpg(pid, signal.SIGKILL)


def _run(root: Path, tests: list[str], broken: tuple[str, str] | None, limit_s: float, there: Connection) -> None:
    if sys.platform != "win32":
        import resource

        os.setsid()  # so that a hanging test can be killed with all that it has started
        resource.setrlimit(resource.RLIMIT_CPU, (int(limit_s) + 1, int(limit_s) + 5))
    quiet = os.open(os.devnull, os.O_WRONLY)
    os.dup2(quiet, 1)
    os.dup2(quiet, 2)
    os.chdir(root)
    if broken is not None:
        BrokenModule(root, *broken).install()
    import pytest

    listener = _Listener()
    options = ["-q", "-x", "-n", "0", "-p", "no:cacheprovider", "--hypothesis-seed=0", "--no-header", "--tb=no"]
    # Libraries that were loaded before the fork are used as they are.
    options += ["-W", "ignore::pytest.PytestAssertRewriteWarning"]
    code = int(pytest.main([*options, *tests], plugins=[listener]))
    there.send(listener.failed)
    there.close()
    os._exit(code)


class _Listener:
    """Remembers what failed first; examples are neither made smaller nor kept for later."""

    def __init__(self) -> None:
        self.failed = ""

    def pytest_configure(self) -> None:
        """After ``conftest.py`` has chosen its own profile."""
        from hypothesis import Phase, settings

        phases = (Phase.explicit, Phase.generate)
        settings.register_profile("breakages", deadline=None, database=None, phases=phases)
        settings.load_profile("breakages")

    def pytest_runtest_logreport(self, report: object) -> None:
        """A test, or its fixture."""
        self._note(report)

    def pytest_collectreport(self, report: object) -> None:
        """A module that cannot be imported."""
        self._note(report)

    def _note(self, report: object) -> None:
        if getattr(report, "failed", False) and not self.failed:
            self.failed = str(getattr(report, "nodeid", ""))
