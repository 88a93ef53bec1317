"""Stands in for ``fsinfer run``: what it leaves, in a moment; and it fails as its photographs' folder asks it to.

``python stand_in_run.py PHOTOS OUT [options]``. ``PHOTOS/behave.json`` may hold: ``seconds`` to sleep,
``exit`` with ``say``, ``signal`` to die by, ``gb`` to hold, ``child`` (starts another process), ``once`` (only the
first attempt behaves so), ``cloud`` (how large the cloud is), ``border`` (its figures, null for none), ``end`` (seconds
that it takes to end when it is told to; then it writes once more).
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import zlib
from pathlib import Path
from typing import Any

# Nothing of fsinfer: fifty of them are to start in a moment.
COLUMNS = (
    "tree_id,x_m,y_m,z_ground_m,dbh_cm,dbh_lo95_cm,dbh_hi95_cm,dbh_perimeter_cm,dbh_min_cm,dbh_max_cm,bh_m,"
    "arc_coverage,points,residual_cm,lean_deg,height_m,status,reason"
)


def main(photos: Path, out: Path, options: list[str]) -> None:
    if not photos.exists():
        print(f"Error: {photos} does not exist; give a folder of photos or a video file", file=sys.stderr)
        sys.exit(2)
    out.mkdir(parents=True, exist_ok=True)
    with (out / "started.txt").open("a", encoding="utf-8") as stream:
        stream.write(json.dumps(options) + "\n")
    attempts = len((out / "started.txt").read_text(encoding="utf-8").splitlines())
    behaviour = photos / "behave.json"
    behave: dict[str, Any] = json.loads(behaviour.read_text(encoding="utf-8")) if behaviour.is_file() else {}
    if not (behave.get("once") and attempts > 1):
        misbehave(behave, out)
    name = out.name
    trees = 1 + zlib.crc32(name.encode()) % 4
    rows = [COLUMNS, *(tree(number, name) for number in range(1, trees + 1))]
    (out / "trees.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    (out / "cloud.ply").write_bytes(name.encode() * behave.get("cloud", 10))
    (out / "figures").mkdir(exist_ok=True)
    (out / "figures" / "tree_001.png").write_bytes(b"")
    (out / "report.html").write_text(f"<html>{trees}", encoding="utf-8")
    (out / "plot.json").write_text(json.dumps(plot(name, trees, photos, behave)), encoding="utf-8")


def misbehave(behave: dict[str, Any], out: Path) -> None:
    if behave.get("child"):
        child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
        (out / "child.txt").write_text(str(child.pid), encoding="utf-8")
    if "end" in behave:

        def end_slowly(*_: object) -> None:
            time.sleep(behave["end"])
            out.mkdir(parents=True, exist_ok=True)
            (out / "ended.txt").write_text("", encoding="utf-8")
            sys.exit(130)

        signal.signal(signal.SIGTERM, end_slowly)
    (out / "pid.txt").write_text(str(os.getpid()), encoding="utf-8")
    held = bytearray(int(1e9 * behave.get("gb", 0)))
    held[::4096] = b"1" * len(held[::4096])
    time.sleep(behave.get("seconds", 0))
    if "say" in behave:
        print(behave["say"], file=sys.stderr)
    if "signal" in behave:
        os.kill(os.getpid(), behave["signal"])
    if "exit" in behave:
        sys.exit(behave["exit"])


def tree(number: int, name: str) -> str:
    dbh_cm = 20.0 + zlib.crc32(f"{name} {number}".encode()) % 300 / 10
    interval = f"{dbh_cm:.2f},{dbh_cm - 1:.2f},{dbh_cm + 1:.2f}"
    return f"{number},{number * 1.5:.3f},-1.250,0.000,{interval},,,,1.30,1.00,100,0.20,0.0,,ok,"


def plot(name: str, trees: int, photos: Path, behave: dict[str, Any]) -> dict[str, Any]:
    """The keys of ``plot.json`` that a summary reads; plots with an even number of trees have a border."""
    figure = {"value": 100.0 * trees, "lo95": 90.0 * trees, "hi95": 120.0 * trees}
    basal = {"value": 8.0 * trees, "lo95": 7.5 * trees, "hi95": 9.0 * trees}
    border = {
        "area_m2": 500.0, "quadratic_mean_dbh_cm": 31.25, "mean_dbh_cm": 30.5, "stems_per_ha": figure,
        "basal_area_m2_per_ha": basal,
    }  # fmt: skip
    given = behave.get("border", {} if trees % 2 == 0 else None)
    return {
        "source": photos.name, "photos": 12, "registered": 11, "units": "m", "scale_source": "aruco", "trees": trees,
        "trees_with_dbh": trees, "stand": {"stems_per_ha": 77.0, "basal_area_m2_per_ha": 6.5},
        "plot_area_m2": 321.0, "plot_border": None if given is None else border | given,
        "per_hectare_of": "seen ground only" if given is None else "the plot within its border",
        "warnings": ["one board was not found", "<b>bold</b> & =1+1"] if trees == 3 else [],
    }  # fmt: skip


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:])
