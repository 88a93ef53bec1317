"""Tables of plots with folders of photographs for ``tests/support/stand_in_run.py``."""

from __future__ import annotations

import csv
import json
import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

#: What stands in for ``fsinfer run``.
STAND_IN = (sys.executable, str(Path(__file__).with_name("stand_in_run.py")))


def write_table(folder: Path, rows: Sequence[Mapping[str, object]]) -> Path:
    """``plots.csv`` in ``folder``; a row without photos gets a folder of its own, called as the plot."""
    rows = [{"photos": f"photos/{row['name']}", **row} for row in rows]
    columns = list(dict.fromkeys(key for row in rows for key in row))
    path = folder / "plots.csv"
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, columns)
        writer.writeheader()
        writer.writerows(rows)
    for row in rows:
        photos = folder / str(row["photos"])
        photos.mkdir(parents=True, exist_ok=True)
        if not (photos / "one.jpg").is_file():
            (photos / "one.jpg").write_bytes(b"no photograph")
    return path


def behave(folder: Path, name: str, **how: Any) -> None:
    """Say how the run of a plot is to fail."""
    (folder / "photos" / name / "behave.json").write_text(json.dumps(how), encoding="utf-8")


def read_csv(path: Path) -> list[dict[str, str]]:
    """A table exactly as it is written."""
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def is_alive(pid: int) -> bool:
    """Whether a process runs: one that is only not yet buried does not."""
    try:
        return b") Z " not in Path(f"/proc/{pid}/stat").read_bytes()
    except OSError:
        return False


def wait_for(what: Callable[[], bool], *, seconds: float = 60.0) -> None:
    """Until something is so; a test that waits longer fails."""
    end = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.05)


def started(out: Path) -> int:
    """How often the run of a plot was started."""
    path = out / "started.txt"
    return len(path.read_text(encoding="utf-8").splitlines()) if path.is_file() else 0


def kill(pid: int) -> None:
    """As a power cut would."""
    import signal

    os.kill(pid, signal.SIGKILL)
