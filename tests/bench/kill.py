"""Kill ``fsinfer run`` (SIGKILL) in each stage, start it again, and compare ``trees.csv`` with an undisturbed run's.

    python -m tests.bench.kill WORK [--photos 36] [--max-size 960] [--kills 1]

The demo plot is run twice: once undisturbed, once in a folder in which the run is killed ``kills`` times in every
stage, spread over the time that the stage took undisturbed, and started again each time. Ends with 1 when the tables
differ.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import time
from pathlib import Path

from fsinfer.output.layout import RECORDS_FOLDER
from tests.bench.demo import demo_photos
from tests.bench.results import add_result_options, check_result_options, save_result

STAGES = ("frames", "poses", "depth", "check", "fuse", "scale", "cloud", "trees", "report")
IN_STAGE = "in the stage"


def main(argv: list[str] | None = None) -> int:
    """Run, kill, compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("work", type=Path)
    parser.add_argument("--photos", type=int, default=36, help="the first so many of the demo's photos")
    parser.add_argument("--max-size", type=int, default=960)
    parser.add_argument("--kills", type=int, default=1, help="kills in each stage")
    add_result_options(parser)
    options = parser.parse_args(argv)
    check_result_options(parser, options)
    photos = demo_photos(options.work / "photos", options.photos)
    command = [
        sys.executable,
        "-m",
        "fsinfer.cli.app",
        "run",
        str(photos),
        "OUT",
        "--aruco-length-m",
        "0.25",
        "--quiet",
    ]
    command += ["--max-size", str(options.max_size), "--threads", "1"]
    whole, killed = options.work / "whole", options.work / "killed"
    for folder in (whole, killed):
        shutil.rmtree(folder, ignore_errors=True)
    start = time.perf_counter()
    subprocess.run([str(whole) if word == "OUT" else word for word in command], check=True)
    seconds = json.loads((whole / "plot.json").read_text(encoding="utf-8"))["seconds"]
    undisturbed_s = time.perf_counter() - start
    print(f"undisturbed: {undisturbed_s:.0f} s")
    states: list[str] = []
    in_folder = [str(killed) if word == "OUT" else word for word in command]
    for stage in STAGES:
        for kill in range(options.kills):
            after_s = seconds[stage] * (kill + 0.5) / options.kills
            states.append(kill_in(in_folder, killed, stage, after_s))
            print(f"{stage:8s} killed {after_s:6.2f} s in: {states[-1]}", flush=True)
    subprocess.run(in_folder, check=True)
    same = (whole / "trees.csv").read_bytes() == (killed / "trees.csv").read_bytes()
    trees = len((whole / "trees.csv").read_text(encoding="utf-8").splitlines()) - 1
    print(f"trees.csv of {trees} trees: {'the same, byte for byte' if same else 'DIFFERENT'}")
    again = time.perf_counter()
    told = subprocess.run(in_folder, check=True, capture_output=True, text=True).stdout.splitlines()[0]
    again_s = time.perf_counter() - again
    print(f"once more: '{told}' in {again_s:.1f} s")
    figures = {
        "stages": len(STAGES),
        "kills": len(states),
        "kills_within_a_stage": states.count(IN_STAGE),
        "trees": trees,
        "tables_differ": int(not same),
        "undisturbed_s": undisturbed_s,
        "once_more_s": again_s,
    }
    save_result(options, figures, module="tests.bench.kill", arguments=argv)
    return 0 if same and told.startswith("Nothing to do") else 1


def kill_in(command: list[str], out: Path, stage: str, after_s: float) -> str:
    """Run ``command`` until ``after_s`` into ``stage``, then kill it; say in which state the stage was left."""
    record = out / RECORDS_FOLDER / f"{stage}.json"
    before = _state(record)
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    while process.poll() is None and (_state(record) == before or _state(record)[0] == "none"):
        time.sleep(0.002)
    deadline = time.perf_counter() + after_s
    while process.poll() is None and time.perf_counter() < deadline and _state(record)[0] == "started":
        time.sleep(0.002)
    process.kill()
    process.wait()
    state = _state(record)[0]
    return IN_STAGE if state == "started" else f"the stage was {state} (it was too quick)"


def _state(record: Path) -> tuple[str, str]:
    try:
        saved = json.loads(record.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return "none", ""
    return str(saved.get("state")), str(saved.get("run_id"))


if __name__ == "__main__":
    sys.exit(main())
