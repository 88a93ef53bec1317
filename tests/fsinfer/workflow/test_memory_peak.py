"""Memory between stages: what the allocator keeps goes back to the system."""

from __future__ import annotations

import ctypes
import platform
import subprocess
import sys
from pathlib import Path

import pytest

from fsinfer.processes import hand_back

#: In a process of its own: what others have freed before would be taken first. Prints MiB before, with blocks that are
#: freed below one still in use, and as the next stage begins.
STAGES = """
import os, pathlib, sys
import numpy as np
from fsinfer.workflow.ledger import Ledger, Stage

def resident_mb():
    pages = int(pathlib.Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20

before = resident_mb()
blocks = [np.ones(2000) for _ in range(12_000)]  # small enough for the heap
last = blocks[-1]
del blocks
freed = resident_mb()
stage = Stage(name="next", version=1, result=float)
record = Ledger(pathlib.Path(sys.argv[1])).run(stage, lambda _: resident_mb(), inputs={})
print(before, freed, record.result)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only GNU's C library hands back what it keeps")
def test_a_stage_begins_without_what_the_one_before_has_freed(tmp_path: Path) -> None:
    """Blocks freed below one that is still in use stay with the process until they are asked for."""
    done = subprocess.run([sys.executable, "-c", STAGES, str(tmp_path)], check=True, capture_output=True, text=True)
    before, freed, begun = map(float, done.stdout.split())
    assert freed - before > 100.0
    assert begun - before < 50.0


def test_where_there_is_nothing_to_ask_nothing_happens(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[object] = []
    monkeypatch.setattr(ctypes, "CDLL", asked.append)
    monkeypatch.setattr(sys, "platform", "win32")
    hand_back()
    assert asked == []
