"""Runs of a small plot in processes of their own, struck by faults, started again, and judged."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import subprocess
import sys
import traceback
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fsinfer.output.layout import METRIC_TREE_FILES, TREES_CSV, TREES_JSON
from tests.faults.strikes import arm

#: The stages in their order, and how many files more are written after each has begun when a fault strikes: in the
#: middle of its outputs where it has several.
STAGES = {"frames": 3, "poses": 8, "depth": 5, "check": 0, "fuse": 1, "scale": 0, "cloud": 1, "trees": 1, "report": 1}
#: Exit code that the command line promises for each fault; below zero the signal that ends a process.
CODES = {
    "kill": -signal.SIGKILL, "power cut": -signal.SIGKILL, "clock": -signal.SIGKILL, "end": 130, "Ctrl-C": 130,
    "Ctrl-C in a stall": 130, "full disk": 2, "file limit": 2, "read-only": 2, "no memory": 2, "stall": 0,
    "second run": 0,
}  # fmt: skip
#: Where a fault that stops every write may find nothing left to write: the record of the stage and plot.json come yet.
_WORDS = {
    "full disk": "the disk is full", "file limit": "cannot write", "read-only": "cannot write",
    "no memory": "not enough free memory", "end": "Stopped.", "Ctrl-C": "Stopped.", "Ctrl-C in a stall": "Stopped.",
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Ended:
    """How a run ended: exit code (negative: the signal), and what it said."""

    code: int
    told: str


@dataclass(frozen=True, kw_only=True)
class Injection:
    """One fault at one stage; ``problems`` is empty where all is as promised."""

    fault: str
    stage: str
    code: int
    problems: tuple[str, ...]


def make_photos(folder: Path) -> Path:
    """Photographs that stand for the views of the small plot."""
    from fsinfer.io.images import write_image
    from tests.support.synthetic_plot import VIEWS

    for index in range(VIEWS):
        write_image(folder / f"view_{index:02d}.jpg", np.full((8, 8, 3), index, np.uint8))
    return folder


def run(photos: Path, out: Path, *, stage: str = "", writes: int = 0, fault: str = "") -> Ended:
    """``fsinfer run`` with exact frames, poses and depth in a copy of this process, struck by ``fault``."""
    log = out.parent.parent / "told.txt"
    sys.stdout.flush()
    sys.stderr.flush()
    child = os.fork()
    if child == 0:
        _run_here(photos, out, stage, writes, fault, log)
    _, status = os.waitpid(child, 0)
    told = log.read_text(encoding="utf-8", errors="replace")
    return Ended(code=os.waitstatus_to_exitcode(status), told=told)


def _run_here(photos: Path, out: Path, stage: str, writes: int, fault: str, log: Path) -> None:
    code = 1
    try:
        with log.open("wb") as stream:
            for number in (1, 2):
                os.dup2(stream.fileno(), number)
        # Not those of a test, which keeps what is said and takes warnings for errors.
        sys.stdout, sys.stderr = os.fdopen(1, "w", closefd=False), os.fdopen(2, "w", closefd=False)
        warnings.resetwarnings()
        from tests.support.killed_run import stand_in
        from tests.support.synthetic_plot import M_PER_UNIT

        stand_in()
        command = ["run", str(photos), str(out), "--scale", str(M_PER_UNIT), "--quiet"]
        if fault:
            arm(out, stage, writes, fault, second=lambda: _second(photos, out))
        from fsinfer.cli.app import main

        sys.argv = ["fsinfer", *command]
        main()
        code = 0
    except SystemExit as ending:
        code = ending.code if isinstance(ending.code, int) else 0 if ending.code is None else 1
        if isinstance(ending.code, str):
            os.write(2, ending.code.encode())
    except BaseException:
        os.write(2, traceback.format_exc().encode())
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def _second(photos: Path, out: Path) -> int:
    """Another run into the same folder, as somebody else's: not in this process."""
    code = "import sys; from fsinfer.cli.app import main; sys.argv = ['fsinfer', *sys.argv[1:]]; main()"
    command = [sys.executable, "-c", code, "run", str(photos), str(out), "--scale", "1", "--quiet"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if "another run of fsinfer is at work" not in done.stderr:
        os.write(2, f"the second run said: {done.stderr}".encode())
    return done.returncode


def results(out: Path) -> dict[str, str]:
    """What a run is for: the trees and the cloud, as digests."""
    names = ("trees.csv", "cloud.ply")
    return {name: hashlib.sha256((out / name).read_bytes()).hexdigest() if (out / name).is_file() else "missing"
            for name in names}  # fmt: skip


def done_stages(out: Path) -> dict[str, str]:
    """The stages that are done, with the number of the run that did them."""
    done = {}
    for stage in STAGES:
        try:
            record = json.loads((out / ".fsinfer" / f"{stage}.json").read_text(encoding="utf-8"))
        except (OSError, ValueError):
            continue
        if record.get("state") == "done":
            done[stage] = str(record["run_id"])
    return done


def chain(fault: str, stages: Sequence[str], photos: Path, folder: Path, whole: dict[str, str]) -> list[Injection]:
    """One output folder that ``fault`` strikes in each of ``stages``, started again each time, and at last undisturbed.

    ``whole`` are the results of a run that nothing has struck.
    """
    out = folder / "out"
    out.mkdir(parents=True)
    injections = []
    for stage in stages:
        before = done_stages(out)
        ended = run(photos, out, stage=stage, writes=STAGES[stage], fault=fault)
        problems = _judge(fault, stage, ended, before, done_stages(out))
        _recover(fault, out)
        injections.append(Injection(fault=fault, stage=stage, code=ended.code, problems=tuple(problems)))
        if ended.code == 0:  # a run that has come to its end is begun anew for the next stage
            problems += _compare(out, whole)
            injections[-1] = Injection(fault=fault, stage=stage, code=ended.code, problems=tuple(problems))
            for record in list(STAGES)[list(STAGES).index(stage) :]:
                (out / ".fsinfer" / f"{record}.json").unlink(missing_ok=True)
                # Tables of trees without a record would be somebody else's.
                for name in {"frames": ["frames"], "poses": ["scene"], "depth": ["depth", "confidence"],
                             "fuse": ["fused"], "trees": ["figures", TREES_CSV, TREES_JSON, *METRIC_TREE_FILES],
                            }.get(record, []):  # fmt: skip
                    subprocess.run(["rm", "-rf", str(out / name)], check=True)
    last = run(photos, out)
    problems = _compare(out, whole)
    if last.code != 0:
        problems.append(f"the last run ended with {last.code}: {last.told[-300:]}")
    if any(out.rglob("*.part*")):
        problems.append("half-written files are left")
    again = run(photos, out)
    if "Nothing to do" not in again.told:
        problems.append(f"a further run had something to do: {again.told[-300:]}")
    if problems:
        end = injections[-1]
        injections[-1] = Injection(fault=fault, stage=end.stage, code=end.code, problems=(*end.problems, *problems))
    return injections


def _judge(fault: str, stage: str, ended: Ended, before: dict[str, str], after: dict[str, str]) -> list[str]:
    problems = []
    # A stage that takes no more memory than the run has ends as if nothing had happened.
    enough = fault == "no memory" and ended.code == 0
    if ended.code != CODES[fault] and not enough:
        problems.append(f"ended with {ended.code}, not {CODES[fault]}: {ended.told[-400:]}")
    if "Traceback" in ended.told:
        problems.append(f"a traceback: {ended.told[-1500:]}")
    word = _WORDS.get(fault, "")
    if word not in ended.told and not enough:
        problems.append(f"did not say {word!r}: {ended.told[-300:]}")
    earlier = list(STAGES)[: list(STAGES).index(stage)]
    lost = [name for name in earlier if name in before and after.get(name) != before[name]]
    if lost:
        problems.append(f"done again: {', '.join(lost)}")
    return problems


def _compare(out: Path, whole: dict[str, str]) -> list[str]:
    found = results(out)
    return [f"{name} differs from an undisturbed run's" for name in whole if found[name] != whole[name]]


def _recover(fault: str, out: Path) -> None:
    """What the user does before the same command is given again."""
    (out.parent / "filler").unlink(missing_ok=True)
    if fault == "clock":
        for number, path in enumerate(sorted(out.rglob("*"))):
            # Half of the files are older than anything, the others are from the future.
            moment = 10**9 if number % 2 else 4 * 10**9
            os.utime(path, (moment, moment))
