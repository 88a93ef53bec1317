"""``python -m training.evaluate`` with a result file: ``python -m tests.bench.depth SCENES --result NAME``.

Every option but ``--result…`` and ``--unit-m`` is one of ``training.evaluate``. Its JSON becomes figures: ``mean_`` of
the views' figures, ``pooled_`` over all pixels together, shares in per cent, lengths in centimetres where ``--unit-m``
says how long a scene's unit is.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import math
import sys
import time
from collections.abc import Mapping
from typing import Any

import training.evaluate
from tests.bench.results import add_result_options, check_result_options, save_result

#: Figures of ``training.evaluate`` that are shares or relative errors.
SHARES = ("median_rel", "within_1pct", "within_1pct_sure", "within_3cm_sure", "flying", "flying_sure")
LENGTHS = ("median_abs", "median_abs_sure")


def figures_of(report: Mapping[str, Any], unit_m: float | None) -> dict[str, float]:
    """The JSON of ``training.evaluate`` as figures with units; what the set has no truth for (NaN) is left out."""
    figures: dict[str, float] = {"views": len(report["views"])}
    if "confirmed" in report:
        figures["confirmed_percent"] = 100 * report["confirmed"]
    for part in ("mean", "pooled"):
        errors = report[part]
        figures |= {f"{part}_{name}_percent": 100 * errors[name] for name in SHARES if not math.isnan(errors[name])}
        if unit_m is not None:
            figures |= {f"{part}_{name}_cm": 100 * unit_m * errors[name] for name in LENGTHS}
        else:  # three centimetres are three hundredths of a metre only
            figures.pop(f"{part}_within_3cm_sure_percent", None)
    return figures


def main(argv: list[str] | None = None) -> int:
    """Evaluate, print, write."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.depth", description=__doc__)
    parser.add_argument("--unit-m", type=float, help="length of a unit of the scenes, 1 for metres")
    add_result_options(parser)
    args, more = parser.parse_known_args(argv)
    check_result_options(parser, args)
    printed = io.StringIO()
    start = time.perf_counter()
    with contextlib.redirect_stdout(printed):
        status = training.evaluate.main([*more, "--json"])
    if status:
        print(printed.getvalue(), file=sys.stderr)
        return status
    figures = figures_of(json.loads(printed.getvalue()), args.unit_m)
    figures["clock_s"] = time.perf_counter() - start
    for name, value in figures.items():
        print(f"{name:36s} {value:.5g}")
    save_result(args, figures, module="tests.bench.depth", arguments=argv)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
