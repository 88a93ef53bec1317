"""Real photographs without a truth: ``python -m tests.bench.photos PHOTOS OUT``.

The whole command ``fsinfer run``. What can be said without a truth: how many photographs were registered, and how far
the depth maps lie from well triangulated points of structure from motion (``depth_vs_sfm_median_rel`` of plot.json).
The result file has what the run said in words, too.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from fsinfer.workflow.pipeline import run
from fsinfer.workflow.settings import RunSettings
from tests.bench.plot import run_figures
from tests.bench.results import add_result_options, check_result_options, save_result


def main(argv: list[str] | None = None) -> int:
    """Run, print, write."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.photos", description=__doc__)
    parser.add_argument("photos", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--judge", action="store_true", help="read what OUT holds, and run nothing")
    add_result_options(parser)
    args = parser.parse_args(argv)
    check_result_options(parser, args)
    if not args.judge:
        run(args.photos, args.out, settings=RunSettings())
    plot = json.loads((args.out / "plot.json").read_text(encoding="utf-8"))
    figures = run_figures(plot)
    said = [*plot["warnings"], *([plot["diagnosis"]] if plot.get("diagnosis") else [])]
    print("\n".join(said))
    for name, value in figures.items():
        print(f"{name:24s} {value}")
    save_result(args, figures, module="tests.bench.photos", arguments=argv, settings={"said": said})
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
