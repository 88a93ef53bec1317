"""One case after the other, each from its number alone, in the process that this module is run in."""

from __future__ import annotations

import logging
import shutil
import time
import traceback
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from random import Random

from tests.fuzz.reader import Reader

#: A message is read in a terminal: one that quotes half of a damaged file says nothing. Characters.
MOST_LETTERS = 1600
#: Address space beyond what the process has before a case, times ``most_mb``: what asks for more gets a MemoryError.
ADDRESS_SPACE = 3
#: Memory that a byte of the files may be worth.
_BYTES_PER_BYTE = 40
_CLEAR_REFS, _STATUS = Path("/proc/self/clear_refs"), Path("/proc/self/status")


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Of one case: ``finding`` is empty where the reader succeeded or told its own error.

    ``read`` says that it succeeded; ``trace`` ends with the line that failed.
    """

    case: int
    read: bool
    finding: str = ""
    trace: str = ""


class Cases:
    """Valid files of one reader in ``folder``, changed anew for each case."""

    def __init__(self, reader: Reader, folder: Path, seed: int) -> None:
        self.reader, self.seed = reader, seed
        self.folder = folder / "given"
        shutil.rmtree(folder, ignore_errors=True)
        self.folder.mkdir(parents=True)
        reader.make(self.folder)
        found = (path for pattern in reader.targets for path in sorted(self.folder.glob(pattern)))
        self.targets = [(path, path.read_bytes()) for path in found]
        if not self.targets:
            raise ValueError(f"{reader.name} makes none of {reader.targets}")
        # A reader that refuses what nobody changed would be a fuzzer of one line.
        reader.read(self.folder)
        self._changed: Path | None = None
        self.bytes = sum(len(content) for _, content in self.targets)

    def change(self, case: int) -> Path:
        """Write the changed file of this case, all others as they were."""
        rng = Random(f"{self.reader.name} {self.seed} {case}")
        chosen, content = rng.choice(self.targets)
        small = self.bytes < 100_000
        for path, original in self.targets:
            # Small ones always: a reader that keeps records may have written over them.
            if small or path == self._changed:
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(original)
        chosen.write_bytes(rng.choice(self.reader.mutators)(content, rng))
        self._changed = chosen
        if self.reader.mend is not None:
            self.reader.mend(self.folder)
        return chosen

    def run(self, case: int) -> Outcome:
        """Change, read, and judge."""
        from fsinfer.errors import FsinferError

        chosen = self.change(case)
        before_mb = _peak_mb(reset=True)
        read = False
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                self.reader.read(self.folder)
            read = True
        except FsinferError as error:
            message = str(error)
            if self.folder.name not in message and chosen.name not in message:
                return Outcome(case=case, read=False, finding="the message names no file", trace=_trace(error))
            if len(message) > MOST_LETTERS:
                return Outcome(case=case, read=False, finding="the message is too long", trace=_trace(error))
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # a panic of a library in Rust is no Exception
            kind = type(error).__name__
            return Outcome(case=case, read=False, finding=kind, trace=_trace(error))
        taken_mb = _peak_mb(reset=False) - before_mb
        if taken_mb > self.reader.most_mb + _BYTES_PER_BYTE * self.bytes / 2**20:
            return Outcome(case=case, read=read, finding="too much memory", trace=f"{taken_mb:.0f} MiB")
        return Outcome(case=case, read=read)


def run_cases(reader: Reader, folder: Path, *, seed: int, first: int, count: int) -> Iterator[Outcome]:
    """Cases ``first`` to ``first + count - 1``."""
    cases = Cases(reader, folder, seed)
    for case in range(first, first + count):
        yield cases.run(case)


def serve(connection, name: str, folder: Path, seed: int, first: int, seconds: float, count: int) -> None:  # type: ignore[no-untyped-def]
    """In a process of its own: cases of the reader ``name``, each told before it begins and when it has ended."""
    import faulthandler
    import signal

    from tests.fuzz.catalogue import READERS
    from tests.fuzz.trial import TRIALS

    logging.disable(logging.CRITICAL)
    faulthandler.register(signal.SIGUSR1, file=(folder.parent / "hang.txt").open("w"), all_threads=False)
    reader = {**READERS, **TRIALS}[name]
    cases = Cases(reader, folder, seed)
    _limit_memory(reader.most_mb * ADDRESS_SPACE + 512)
    # Time of the processor: a busy machine must not shorten the work.
    start = time.process_time()
    case = first
    while case < first + count and time.process_time() - start < seconds:
        connection.send((case, time.process_time() - start))
        connection.send(cases.run(case))
        case += 1
    connection.send((None, time.process_time() - start))


def _trace(error: BaseException) -> str:
    return "".join(traceback.format_exception(error))


def _limit_memory(more_mb: float) -> None:
    try:
        import resource
    except ImportError:  # Windows
        return
    have = int(_field("VmSize:") or 0) * 1024
    if have:
        resource.setrlimit(resource.RLIMIT_AS, (have + int(more_mb * 2**20),) * 2)


def _peak_mb(*, reset: bool) -> float:
    """Peak of the resident memory since it was reset last, MiB; 0 where the system does not tell."""
    try:
        if reset:
            _CLEAR_REFS.write_text("5", encoding="ascii")
    except OSError:
        return 0.0
    return float(_field("VmHWM:") or 0) / 1024


def _field(name: str) -> str | None:
    try:
        lines = _STATUS.read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:
        return None
    return next((line.split()[1] for line in lines if line.startswith(name)), None)
