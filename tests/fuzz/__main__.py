"""Give changed files to the readers of what a user can supply: ``python -m tests.fuzz READER [--minutes N]``.

A reader may succeed, or raise an error of fsinfer that names the file. Anything else is a finding: another exception, a
crash, more than ``--hang-s`` seconds of the processor, more memory than the file is worth. Cases follow from
reader, seed and number alone, so that ``--first N --cases 1`` repeats one. Without READER the readers are listed; "all"
runs them all, each for ``--minutes``. Ends with 1 where there is a finding.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from tests.fuzz.cases import Outcome, serve
from tests.fuzz.catalogue import READERS
from tests.fuzz.table import put_fuzz_rows

#: Starting a process and importing what a reader needs, seconds.
_START_S = 600.0
#: How much longer than it may compute a case may take in all: the machine may be busy.
_WAIT = 15.0


@dataclass(kw_only=True)
class Tally:
    """What came out for one reader; ``findings`` by what failed where, with the numbers of their cases."""

    name: str
    cases: int = 0
    read: int = 0
    seconds: float = 0.0
    findings: Counter[str] = field(default_factory=Counter)
    examples: dict[str, tuple[int, str]] = field(default_factory=dict)

    def add(self, outcome: Outcome) -> None:
        """Count one case."""
        self.cases += 1
        self.read += outcome.read
        if outcome.finding:
            kind = f"{outcome.finding} {_place(outcome.trace)}".strip()
            self.findings[kind] += 1
            self.examples.setdefault(kind, (outcome.case, outcome.trace))


def fuzz(name: str, *, seconds: float, cases: int, seed: int, first: int, hang_s: float) -> Tally:
    """Run cases of one reader until the time or the number is spent; a process that dies is started again behind."""
    tally = Tally(name=name)
    folder = Path(tempfile.mkdtemp(prefix="fuzz-", dir="/dev/shm" if Path("/dev/shm").is_dir() else None))
    context = multiprocessing.get_context("spawn")
    case, last = first, first + cases
    try:
        while case < last and (left := seconds - tally.seconds) > 0:
            ours, theirs = context.Pipe()
            arguments = (theirs, name, folder / "work", seed, case, left, last - case)
            process = context.Process(target=serve, args=arguments)
            process.start()
            theirs.close()
            case = _listen(ours, process, tally, case, hang_s, folder)
            process.join()
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return tally


def _listen(ours, process, tally: Tally, case: int, hang_s: float, folder: Path) -> int:  # type: ignore[no-untyped-def]
    """Take outcomes until the process has ended; the number of the next case to run."""
    begun, spent_s, before_s = False, 0.0, tally.seconds
    while True:
        if not _answers(ours, process.pid, hang_s, begun=begun):
            os.kill(process.pid, signal.SIGUSR1)
            time.sleep(0.5)
            process.kill()
            where = (folder / "hang.txt").read_text(encoding="utf-8") if (folder / "hang.txt").is_file() else ""
            tally.add(Outcome(case=case, read=False, finding=f"longer than {hang_s:g} s", trace=where))
            tally.seconds = before_s + spent_s + hang_s
            return case + 1
        try:
            told = ours.recv()
        except EOFError:
            process.join()
            if not begun:
                raise RuntimeError(f"{tally.name}: the process ended by itself ({process.exitcode})") from None
            tally.add(Outcome(case=case, read=False, finding=f"ended the process with {process.exitcode}"))
            return case + 1
        if isinstance(told, Outcome):
            tally.add(told)
            case = told.case + 1
            continue
        number, spent_s = told
        tally.seconds = before_s + spent_s
        if number is None:
            return 2**62
        case, begun = number, True


def _answers(ours, pid: int, hang_s: float, *, begun: bool) -> bool:  # type: ignore[no-untyped-def]
    """Whether the process says something before it has computed for ``hang_s``; on a busy machine that may take long.

    One that waits for something, computing nothing, is given up after ``_WAIT`` times as long.
    """
    start, busy_s = time.perf_counter(), _busy_s(pid)
    longest_s = _WAIT * hang_s if begun else _START_S
    while not ours.poll(1.0):
        if time.perf_counter() - start > longest_s or (begun and _busy_s(pid) - busy_s > hang_s):
            return False
    return True


def _busy_s(pid: int) -> float:
    """Seconds that the process has computed."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _place(trace: str) -> str:
    """The last line of the trace that lies in fsinfer or training, as file and line."""
    lines = [line.strip() for line in trace.splitlines() if "/fsinfer/" in line or "/training/" in line]
    lines = [line for line in lines if line.startswith("File ") and "/tests/" not in line]
    if not lines:
        return ""
    file, number = lines[-1].split(",")[:2]
    parts = Path(file.split('"')[1]).parts
    return f"in {'/'.join(parts[-2:])}:{number.split()[-1]}"


def main(arguments: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.fuzz", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("reader", nargs="*", help="names of readers, or all")
    parser.add_argument("--minutes", type=float, default=1.0, help="time of the processor for each reader")
    parser.add_argument("--cases", type=int, default=2**60, help="at most so many for each reader")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--hang-s", type=float, default=15.0, help="time of the processor for a case")
    parser.add_argument("--report", type=Path, help="Markdown file whose table of readers is written")
    parser.add_argument("--trace", action="store_true", help="show an example of each finding in full")
    args = parser.parse_args(arguments)
    if not args.reader:
        print("\n".join(f"{name:15s} {reader.what}" for name, reader in READERS.items()))
        return 0
    names = list(READERS) if args.reader == ["all"] else args.reader
    unknown = [name for name in names if name not in READERS]
    if unknown:
        parser.error(f"there is no reader {', '.join(unknown)}; there are {', '.join(READERS)}")
    found = 0
    for name in names:
        tally = fuzz(
            name, seconds=60 * args.minutes, cases=args.cases, seed=args.seed, first=args.first, hang_s=args.hang_s
        )
        found += sum(tally.findings.values())
        rate = tally.cases / max(tally.seconds, 1e-9)
        print(f"{name:15s} {tally.cases} cases, {tally.read} read, {len(tally.findings)} findings, {rate:.0f}/s")
        for kind, count in tally.findings.most_common():
            case, trace = tally.examples[kind]
            line = trace.strip().splitlines()[-1][:200] if trace.strip() else ""
            print(f"    {count:5d} x {kind} (case {case}): {line}", flush=True)
            if args.trace:
                print(trace[-3000:])
        if args.report:
            put_fuzz_rows(args.report, [tally])
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
