"""The installed command ``fsinfer demo`` as a user starts it: ``python -m tests.bench.demo OUT``.

OUT must be new. The command runs in an environment without the variables that set numbers of threads or Python's
paths. Printed: what it prints itself, the seconds by the clock, and ``trees.csv`` against ``truth.csv``, both of OUT.
A result file (``--result``) is refused where the installed package is not the code of this working tree.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import subprocess
import sys
import time
from importlib import resources
from pathlib import Path

from fsinfer.depth.settings import DepthSettings
from fsinfer.evaluation.measured import read_measured
from fsinfer.evaluation.metrics import evaluate
from fsinfer.trees.outputs.table import read_trees
from tests.bench.plot import run_figures, source_errors, tree_figures
from tests.bench.results import ROOT, add_result_options, check_result_options, save_result

#: Beginnings of the names of variables that a user's shell does not have.
NOT_A_USERS = ("OMP_", "OPENBLAS_", "MKL_", "NUMEXPR_", "PYTHON", "MPLBACKEND")


def user_environment() -> dict[str, str]:
    """The environment without what only developers set."""
    return {name: value for name, value in os.environ.items() if not name.startswith(NOT_A_USERS)}


def demo_photos(folder: Path, count: int) -> Path:
    """Put the first ``count`` photographs of the demo plot into a folder; the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    given = sorted((resources.files("fsinfer") / "demo_data" / "photos").iterdir(), key=lambda path: path.name)
    for photo in given[:count]:
        (folder / photo.name).write_bytes(photo.read_bytes())
    return folder


def digest_of(package: Path) -> str:
    """SHA-256 over the names and contents of the Python files of a package."""
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        digest.update(path.relative_to(package).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def installed_package(command: Path) -> Path:
    """The folder of the package that the command imports; its Python lies beside it."""
    python = command.with_name("python")
    found = subprocess.run(
        [str(python), "-c", "import fsinfer; print(fsinfer.__path__[0])"],
        cwd=command.parent,
        env=user_environment(),
        check=True,
        capture_output=True,
        text=True,
    )
    return Path(found.stdout.strip())


def main(argv: list[str] | None = None) -> int:
    """Run, compare, print."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.demo", description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--fsinfer", type=Path, help="the installed command; without it the one beside this Python")
    parser.add_argument("--model", default=DepthSettings.model, help="as of fsinfer demo")
    parser.add_argument("--judge", action="store_true", help="compare what OUT holds, and run nothing")
    add_result_options(parser)
    args = parser.parse_args(argv)
    check_result_options(parser, args)
    figures: dict[str, float | None] = {} if args.judge else {"clock_s": run_command(args, parser)}
    summary = json.loads((args.out / "plot.json").read_text(encoding="utf-8"))
    trees = read_trees(args.out / "trees.csv")
    # As the command itself compares: the plot's frame begins somewhere, and trees beyond the plot are nobody's.
    result = evaluate(read_measured(args.out / "truth.csv"), trees, align="auto", area_margin_m=1.0)
    by_id = {str(tree.tree_id): tree for tree in trees}
    inside = []
    for pair in result.pairs:
        tree = by_id[pair.extracted_id]
        if tree.dbh_lo95_cm is not None and tree.dbh_hi95_cm is not None:
            inside.append(tree.dbh_lo95_cm <= pair.measured_cm <= tree.dbh_hi95_cm)
    sources = source_errors(args.out / "dbh_sources.csv", {p.extracted_id: p.measured_cm for p in result.pairs})
    figures |= {**run_figures(summary), **tree_figures(result, inside), **sources}
    for name, value in figures.items():
        print(f"{name:24s} {value}")
    save_result(args, figures, module="tests.bench.demo", arguments=argv)
    return 0


def run_command(args: argparse.Namespace, parser: argparse.ArgumentParser) -> float:
    """Run ``fsinfer demo``; seconds by the clock."""
    beside = shutil.which("fsinfer", path=str(Path(sys.executable).parent))
    command = args.fsinfer or (Path(beside) if beside else None)
    if command is None or not command.is_file():
        parser.error("there is no fsinfer command beside this Python; install the package or give --fsinfer")
    if args.out.exists():
        parser.error(f"{args.out} is there already: what it holds would not be computed again")
    if args.result and digest_of(installed_package(command)) != digest_of(ROOT / "fsinfer"):
        parser.error(f"{command} is not the code of this working tree; install it again")
    start = time.perf_counter()
    subprocess.run(
        [str(command), "demo", str(args.out.resolve()), "--model", args.model], env=user_environment(), check=True
    )
    return time.perf_counter() - start


if __name__ == "__main__":
    raise SystemExit(main())
