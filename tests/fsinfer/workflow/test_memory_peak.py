"""Memory between stages: what the allocator keeps goes back to the system."""

from __future__ import annotations

import platform
import sys
from pathlib import Path

import numpy as np
import pytest

from fsinfer.workflow.ledger import Ledger, Stage
from fsinfer.workflow.memory_peak import hand_back


def resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * 4096 / 2**20


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only GNU's C library hands back what it keeps")
def test_a_stage_begins_without_what_the_one_before_has_freed(tmp_path: Path) -> None:
    """Blocks freed below one that is still in use stay with the process until they are asked for."""
    before = resident_mb()
    # Small enough for the heap; the last one holds its end.
    blocks = [np.ones(2000) for _ in range(12_000)]
    last = blocks[-1]
    del blocks
    assert resident_mb() - before > 100.0
    stage = Stage(name="next", version=1, result=float)
    record = Ledger(tmp_path).run(stage, lambda _: resident_mb(), inputs={})
    assert record.result - before < 50.0
    assert last.sum() == 2000.0


def test_where_there_is_nothing_to_ask_nothing_happens(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "win32")
    hand_back()
