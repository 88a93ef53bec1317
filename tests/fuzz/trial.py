"""A reader that fails in the ways that only a process of its own survives, to try the fuzzer on."""

from __future__ import annotations

import os
from pathlib import Path
from random import Random

from tests.fuzz.reader import Reader


def _make(folder: Path) -> None:
    (folder / "a.txt").write_text("a", encoding="utf-8")


def _change(_: bytes, rng: Random) -> bytes:
    return rng.randbytes(4)


def _read(folder: Path) -> None:
    """Count the calls where no restart forgets them: the second one ends the process, the fourth never ends."""
    counter = folder.parent.parent / "calls"
    calls = len(counter.read_bytes()) + 1 if counter.is_file() else 1
    counter.write_bytes(bytes(calls))
    if calls == 2:
        os._exit(7)
    while calls == 4:
        pass


TRIALS = {
    "ends-itself": Reader(
        name="ends-itself", what="nothing", make=_make, targets=("*.txt",), mutators=(_change,), read=_read
    )
}
