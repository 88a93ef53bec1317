"""Stem curves of a rendered plot against their truth: ``python -m tests.bench.stem_curve PLOT OUT [PLOT OUT ...]``.

PLOT is what ``training.synthesize --kind plot`` writes (with ``truth_curve.csv``), OUT what ``fsinfer run`` made of its
photographs. Trees are those that :mod:`tests.bench.plot` pairs. Printed are the errors of the diameters by height, and
how many true ones lie within 1.96 of their standard deviations.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fsinfer.trees.points.sums import Z95
from tests.bench.plot import placed_trees
from tests.bench.results import add_result_options, check_result_options, save_result

#: Heights in metres, from and below, and what a figure of theirs is called.
BANDS = {"foot": (0.0, 0.75), "lower": (0.75, 2.25), "middle": (2.25, 4.25), "upper": (4.25, 7.0)}
_TOLD = ("rmse_cm", "bias_cm", "inside_percent", "half_width_median_cm")
_TRUTH_CURVE, _CURVE = "truth_curve.csv", "stem_curve.csv"


def read_curves(path: Path) -> dict[str, dict[float, tuple[float, float]]]:
    """Diameter and its standard deviation (0 where the table has none) in cm by height in metres, by tree."""
    found: dict[str, dict[float, tuple[float, float]]] = {}
    with path.open(newline="", encoding="utf-8") as handle:
        for row in csv.DictReader(handle):
            curve = found.setdefault(row["tree_id"], {})
            if row["diameter_cm"]:
                curve[round(float(row["height_m"]), 2)] = float(row["diameter_cm"]), float(row.get("std_cm") or 0.0)
    return found


def differences(plot: Path, out: Path) -> NDArray[np.float64]:
    """Rows (N, 4) of height in metres, true diameter, error and standard deviation in cm, of the paired trees."""
    truth, found = read_curves(plot / _TRUTH_CURVE), read_curves(out / _CURVE)
    rows = []
    for pair in placed_trees(plot, out).evaluation.pairs:
        true, measured = truth.get(pair.measured_id, {}), found.get(pair.extracted_id, {})
        rows += [
            (height, true[height][0], cm - true[height][0], std)
            for height, (cm, std) in measured.items()
            if height in true
        ]
    return np.array(rows, dtype=np.float64).reshape(-1, 4)


def figures_of(rows: NDArray[np.float64]) -> dict[str, float]:
    """Number, RMSE, bias, and share within their own 1.96 standard deviations, of all heights and by band."""
    figures: dict[str, float] = {}
    for name, (low, high) in {"all": (0.0, np.inf), **BANDS}.items():
        band = rows[(rows[:, 0] >= low) & (rows[:, 0] < high)]
        figures[f"{name}_diameters"] = len(band)
        if len(band):
            error, std = band[:, 2], band[:, 3]
            figures |= {
                f"{name}_rmse_cm": float(np.sqrt((error**2).mean())),
                f"{name}_bias_cm": float(error.mean()),
                f"{name}_inside_percent": 100.0 * float((np.abs(error) <= Z95 * std).mean()),
                f"{name}_half_width_median_cm": float(Z95 * np.median(std)),
            }
    return figures


def main(argv: list[str] | None = None) -> int:
    """Compare and print."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.stem_curve", description=__doc__)
    parser.add_argument("folders", type=Path, nargs="+", metavar="PLOT OUT")
    add_result_options(parser)
    args = parser.parse_args(argv)
    check_result_options(parser, args)
    if len(args.folders) % 2:
        parser.error("give an OUT for each PLOT")
    pairs = list(zip(args.folders[::2], args.folders[1::2], strict=True))
    figures = figures_of(np.concatenate([differences(plot, out) for plot, out in pairs]))
    for name in ("all", *BANDS):
        count = int(figures[f"{name}_diameters"])
        if count:
            rmse, bias, inside, half = (figures[f"{name}_{what}"] for what in _TOLD)
            print(
                f"{name:>6}: n {count}, RMSE {rmse:.2f} cm, bias {bias:+.2f}, inside {inside:.0f} %, half {half:.2f} cm"
            )
    settings = {"plots": [plot.name for plot, _ in pairs]}
    save_result(args, figures, module="tests.bench.stem_curve", arguments=argv, settings=settings)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
