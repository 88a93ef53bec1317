"""Let faults strike a small run in each of its stages, start it again, and compare: ``python -m tests.faults``.

Each fault has an output folder of its own: it strikes in one stage, the same command is given again, it strikes in the
next, and so on; at last nothing does. Asked for are the exit code that the documentation names, one message without a
traceback, no stage done again that was done before, and the trees and the cloud of an undisturbed run, byte for byte.
Frames, poses and depth are exact ones that are made in milliseconds; ``python -m tests.bench.kill`` has the real ones.
The full disk needs the right to mount a small file system and is left out without it, as is said then.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from tests.faults.runs import CODES, STAGES, Injection, chain, make_photos, results, run
from tests.fuzz.table import put_rows

_SMALL_DISK_MB = 48


@contextmanager
def small_disk(folder: Path) -> Iterator[bool]:
    """A file system of a few megabytes at ``folder``; False where it may not be mounted."""
    folder.mkdir(parents=True)
    command = ["mount", "-t", "tmpfs", "-o", f"size={_SMALL_DISK_MB}m", "tmpfs", str(folder)]
    try:
        mounted = subprocess.run(command, capture_output=True, check=False).returncode == 0
    except OSError:
        mounted = False
    try:
        yield mounted
    finally:
        if mounted:
            subprocess.run(["umount", "-l", str(folder)], check=False)


@dataclass(frozen=True, kw_only=True)
class Undisturbed:
    """Photographs, and the digests of what a run makes of them that nothing strikes."""

    photos: Path
    whole: dict[str, str]


def undisturbed(work: Path) -> Undisturbed:
    """The run that all others are held against; each of those is a copy of this process."""
    # Loaded once.
    import fsinfer.cli.app
    import fsinfer.report
    import fsinfer.trees.outputs.figures
    import fsinfer.workflow.pipeline  # noqa: F401
    import tests.support.killed_run  # noqa: F401

    # Libraries that take memory at their first use, and end the process where they get none.
    np.linalg.solve(np.eye(300), np.eye(300))
    with suppress(ImportError):
        import pyproj  # noqa: F401

    photos = make_photos(work / "photos")
    (work / "whole").mkdir()
    ended = run(photos, work / "whole" / "out")
    if ended.code != 0:
        raise RuntimeError(f"the undisturbed run ended with {ended.code}: {ended.told}")
    return Undisturbed(photos=photos, whole=results(work / "whole" / "out"))


def inject(
    faults: list[str],
    stages: list[str],
    work: Path,
    sound: Undisturbed,
    *,
    done_with: Callable[[list[Injection]], None] | None = None,
) -> list[Injection]:
    """All faults in all stages; those that cannot be had on this machine are said and left out.

    ``done_with`` is given the injections of each fault as soon as they are done.
    """
    injections = []
    for fault in faults:
        start = time.perf_counter()
        folder = work / fault.replace(" ", "-")
        if fault == "full disk":
            with small_disk(folder) as mounted:
                if not mounted:
                    print(f"{fault}: left out, no file system may be mounted here")
                    continue
                done = chain(fault, stages, sound.photos, folder, sound.whole)
        else:
            done = chain(fault, stages, sound.photos, folder, sound.whole)
        bad = [one for one in done if one.problems]
        print(f"{fault:18s} {len(done)} injections, {len(bad)} not as promised, {time.perf_counter() - start:.0f} s")
        for one in bad:
            print("".join(f"    {one.stage}: {problem}\n" for problem in one.problems), end="", flush=True)
        injections += done
        if done_with is not None:
            done_with(done)
    return injections


def main(arguments: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.faults", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--faults", nargs="+", choices=list(CODES), default=list(CODES))
    parser.add_argument("--stages", nargs="+", choices=list(STAGES), default=list(STAGES))
    parser.add_argument("--report", type=Path, help="Markdown file whose table of faults is written")
    args = parser.parse_args(arguments)
    if not hasattr(os, "fork"):
        parser.error("this system cannot copy a process; run it on Linux or macOS")
    work = Path(tempfile.mkdtemp(prefix="faults-"))
    try:
        injections = inject(args.faults, args.stages, work, undisturbed(work), done_with=partial(_put, args.report))
    finally:
        shutil.rmtree(work, ignore_errors=True)
    bad = [one for one in injections if one.problems]
    print(f"{len(injections)} injections, {len(bad)} not as promised")
    return 1 if bad else 0


def _put(report: Path | None, injections: list[Injection]) -> None:
    """The row of one fault."""
    if report is None:
        return
    codes = sorted({one.code for one in injections})
    ended = ", ".join("killed" if code < 0 else str(code) for code in codes)
    failed = sum(bool(one.problems) for one in injections)
    cells = (", ".join(one.stage for one in injections), str(len(injections)), ended, str(failed))
    put_rows(report, "faults", {injections[0].fault: cells})


if __name__ == "__main__":
    sys.exit(main())
