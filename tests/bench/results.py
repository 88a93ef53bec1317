"""Figures of a benchmark as a file: ``docs/results/NAME.json``, from which the documents are made.

Every benchmark takes ``--result NAME --result-set blind|development``; :mod:`tests.bench.tables` puts the figures into
the documents. A set is *blind* when no rule, constant or network was chosen with it in view, else *development*.
"""

from __future__ import annotations

import argparse
import json
import math
import numbers
import os
import platform
import re
import shlex
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any, Literal

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "docs" / "results"
Kind = Literal["blind", "development"]
KINDS: tuple[Kind, ...] = ("blind", "development")
#: What decides a figure: a change in any other folder leaves the commit's name clean.
CODE = ("fsinfer", "training", "export", "models", "tests/bench", "pyproject.toml")
PACKAGES = {
    "numpy": "numpy",
    "onnxruntime": "onnxruntime",
    "opencv": "opencv-python-headless",
    "pycolmap": "pycolmap",
    "fsinfer": "fsinfer",
}
#: Whoever sets them changes the times of a run.
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
#: In the name of the library that :mod:`tests.bench.without_avx512` preloads.
WITHOUT_AVX512 = "without_avx512"
NAME = re.compile(r"[a-z0-9][a-z0-9-]*")
FIGURE = re.compile(r"[a-z][a-z0-9_]*")
#: Of the last minute, before the benchmark itself adds to it: this module is imported first.
LOAD_AT_START = os.getloadavg()[0] if hasattr(os, "getloadavg") else None


@dataclass(frozen=True, kw_only=True)
class Result:
    """What one result file holds; ``figures`` have their unit in the name."""

    name: str
    benchmark: str
    command: str
    kind: Kind
    figures: Mapping[str, float]
    settings: Mapping[str, Any] = field(default_factory=dict)
    note: str = ""
    commit: str = ""
    date: str = ""
    processor: Mapping[str, Any] = field(default_factory=dict)

    @property
    def short_commit(self) -> str:
        """Seven letters of the commit, and whether the code was changed since."""
        head, _, dirty = self.commit.partition(" ")
        return f"{head[:7]} {dirty}".strip()


def write_result(
    name: str,
    figures: Mapping[str, float | None],
    *,
    command: str,
    kind: Kind,
    settings: Mapping[str, Any] | None = None,
    note: str = "",
    folder: Path = RESULTS,
) -> Path:
    """Write ``NAME.json``.

    Parameters
    ----------
    name: lower case letters, digits and hyphens.
    figures: numbers by name, the unit in the name (``rmse_cm``); None or NaN, nothing to measure, are left out.
    command: as typed, see :func:`command_line`.
    kind: ``blind`` when nothing was chosen with the set in view.
    settings: what the command line does not tell, such as the options a plot was rendered with.
    note: what a reader has to know of the set.

    Raises
    ------
    ValueError
        A name, a kind or a figure that cannot be written.
    """
    if not NAME.fullmatch(name):
        raise ValueError(f"a result is named with a-z, 0-9 and '-', not {name!r}")
    if kind not in KINDS:
        raise ValueError(f"a set is {' or '.join(KINDS)}, not {kind!r}")
    measured: dict[str, Any] = {key: value for key, value in figures.items() if value is not None}
    for key, value in measured.items():
        if not FIGURE.fullmatch(key):
            raise ValueError(f"a figure is named with a-z, 0-9 and '_', not {key!r}")
        if not isinstance(value, numbers.Real) or math.isinf(value):
            raise ValueError(f"{key} must be a finite number, not {value!r}")
    known = {key: rounded(value) for key, value in measured.items() if not math.isnan(value)}
    record = {
        "name": name,
        "command": command,
        "set": kind,
        "note": note,
        "figures": known,
        "settings": dict(settings or {}),
        "commit": commit(),
        "date": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "processor": processor(),
        "load_average_at_start": LOAD_AT_START,
        "thread_variables": {name: os.environ[name] for name in THREAD_VARIABLES if name in os.environ},
        "versions": versions(),
    }
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.json"
    path.write_text(json.dumps(record, indent=1, ensure_ascii=False, default=str) + "\n", encoding="utf-8")
    return path


def read_result(name: str, folder: Path = RESULTS) -> Result:
    """Read ``NAME.json``; raises FileNotFoundError where there is none."""
    record = json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
    words = shlex.split(record["command"])
    return Result(
        name=record["name"],
        benchmark=words[words.index("-m") + 1],
        command=record["command"],
        kind=record["set"],
        figures=record["figures"],
        settings=record["settings"],
        note=record["note"],
        commit=record["commit"],
        date=record["date"],
        processor=record["processor"],
    )


def rounded(value: Any) -> float:
    """A whole number as it is, any other to seven digits: more is noise, and files stay comparable."""
    return int(value) if isinstance(value, numbers.Integral) else float(f"{float(value):.7g}")


def add_result_options(parser: argparse.ArgumentParser) -> None:
    """``--result``, ``--result-set`` and ``--note``."""
    group = parser.add_argument_group("result file")
    group.add_argument("--result", metavar="NAME", help="write docs/results/NAME.json")
    group.add_argument("--result-set", choices=KINDS, help="whether anything was chosen with this set in view")
    group.add_argument("--note", default="", help="what a reader has to know of the set")


def check_result_options(parser: argparse.ArgumentParser, args: argparse.Namespace) -> None:
    """Refuse a result without the kind of its set, before hours are spent."""
    if args.result and not args.result_set:
        parser.error("--result needs --result-set blind or --result-set development")
    if args.result and not NAME.fullmatch(args.result):
        parser.error(f"--result {args.result}: use a-z, 0-9 and '-'")


def save_result(
    args: argparse.Namespace,
    figures: Mapping[str, float | None],
    *,
    module: str,
    arguments: Sequence[str] | None,
    settings: Mapping[str, Any] | None = None,
) -> None:
    """Write the file that :func:`add_result_options` asked for, if any; says where."""
    if not args.result:
        return
    command = command_line(module, sys.argv[1:] if arguments is None else arguments)
    path = write_result(args.result, figures, command=command, kind=args.result_set, settings=settings, note=args.note)
    print(f"figures in {path}")


def command_line(module: str, arguments: Sequence[str]) -> str:
    """``python -m MODULE ARGUMENTS`` without the result's own options and without the folders of this machine."""
    words: list[str] = []
    skip = False
    for word in arguments:
        if skip:
            skip = False
        elif word in ("--result", "--result-set", "--note"):
            skip = True
        elif not word.startswith(("--result=", "--result-set=", "--note=")):
            words.append(Path(word).name if word.startswith("/") else word)
    return shlex.join(["python", "-m", module, *words])


def commit() -> str:
    """The commit of the code, with ``dirty`` behind it where the code that decides figures was changed since."""
    head = git("rev-parse", "HEAD")
    if head is None:
        return "unknown"
    return f"{head} dirty" if git("status", "--porcelain", "--", *CODE) else head


def git(*arguments: str) -> str | None:
    """What git says, None where it cannot."""
    try:
        done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout.strip()


def processor() -> dict[str, Any]:
    """Model, cores that this process may use, and the instructions that decide speed."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    info = {key.strip(): value.strip() for key, _, value in (line.partition(":") for line in lines)}
    flags = set(info.get("flags", "").split())
    name = info.get("model name", platform.processor() or platform.machine())
    if WITHOUT_AVX512 in os.environ.get("LD_PRELOAD", ""):
        flags = {flag for flag in flags if not flag.startswith(("avx512", "avx_vnni", "amx"))}
        name += ", its AVX-512 hidden"
    wide = "avx512" if "avx512f" in flags else "avx2" if "avx2" in flags else platform.machine()
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return {
        "model": name,
        "cores": cores,
        "instructions": wide,
        "vnni": bool({"avx512_vnni", "avx_vnni"} & flags),
    }


def versions() -> dict[str, str]:
    """Python and the packages that compute."""
    found = {"python": platform.python_version()}
    for key, package in PACKAGES.items():
        try:
            found[key] = metadata.version(package)
        except metadata.PackageNotFoundError:
            found[key] = "not installed"
    return found
