"""SIGKILL in every stage of a run, each followed by a new start: the trees are those of an undisturbed run.

``python -m tests.bench.kill`` does the same to the demo plot with real poses and depth.
"""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fsinfer.io.images import write_image
from tests.support.places import ROOT
from tests.support.synthetic_plot import STEMS, VIEWS

# Stage, and how many files more are written after it has begun: in the middle of its outputs where it has several,
# and once right after an output was finished while the record says that the stage is not.
KILLS = [
    ("frames", 3), ("poses", 8), ("depth", 5), ("check", 0), ("fuse", 0), ("fuse", 1), ("scale", 0), ("cloud", 1),
    ("trees", 0), ("trees", 1), ("report", 1),
]  # fmt: skip


def start(source: Path, out: Path, stage: str = "never", writes: int = 0) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "tests.support.killed_run", str(source), str(out), stage, str(writes)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGKILL")
def test_killed_in_every_stage_the_trees_are_the_same(tmp_path: Path) -> None:
    photos, whole, out = tmp_path / "photos", tmp_path / "whole", tmp_path / "out"
    for index in range(VIEWS):
        write_image(photos / f"view_{index:02d}.jpg", np.full((8, 8, 3), index, np.uint8))
    undisturbed = start(photos, whole)
    assert undisturbed.returncode == 0, undisturbed.stderr
    for stage, writes in KILLS:
        killed = start(photos, out, stage, writes)
        assert killed.returncode == -signal.SIGKILL, (stage, writes, killed.stdout, killed.stderr)
        assert '"state": "started"' in (out / ".fsinfer" / f"{stage}.json").read_text(encoding="utf-8"), stage
    last = start(photos, out)
    assert last.stdout.split() == ["report"]
    table = (out / "trees.csv").read_bytes()
    assert table == (whole / "trees.csv").read_bytes()
    assert len(table.splitlines()) == 1 + len(STEMS)
    # No half-written file is left beside the whole ones.
    assert not list(out.rglob("*.part*"))
    assert start(photos, out).stdout.split() == []
