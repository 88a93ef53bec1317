"""Pieces of a real scan, seen from fewer sides and thinned: ``python -m tests.bench.resampled SCAN.laz``.

The generator is :mod:`training.simulate.resampled_scan`: the errors are the scan's own, not those of a model. The
reference is the tape over all of a piece's points (:mod:`training.simulate.scanned_section`). Its standard error is
printed and not taken off: the interval has to hold the reference as it is. Sections of one stem share its shape and the
scan's errors, so that the few stems count, not the many pieces: beside the total stands the worst stem. ``--rows``
writes every resampled stem.
"""

from __future__ import annotations

import argparse
import csv
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np

from fsinfer import read_cloud
from fsinfer.trees import analyse_plot
from tests.bench.results import add_result_options, check_result_options, save_result
from tests.bench.stems import Groups, Match, figures_of, match, summary
from training.simulate.resampled_scan import Piece, ResampledTruth, ScanSpec, pieces_of, resample
from training.simulate.scanned_section import SectionLimits
from training.simulate.stem_cloud import StemTruth

#: Thin and thick, DBH in cm: between them the scans that were looked at have next to no sections.
THIN_CM, THICK_CM = 18.0, 24.0


def tagged(*tags: str) -> Callable[[StemTruth], bool]:
    """Whether a stem has all of the tags."""
    return lambda stem: set(tags) <= set(stem.tags)


GROUPS: Groups = {
    "all": ("", lambda stem: True),
    "seen 360": ("seen_360_", tagged("seen 360")),
    "seen 270": ("seen_270_", tagged("seen 270")),
    "seen 180": ("seen_180_", tagged("seen 180")),
    "seen 120": ("seen_120_", tagged("seen 120")),
    "one station": ("one_station_", tagged("one station")),
    "two stations": ("two_stations_", tagged("two stations")),
    "all points": ("all_points_", tagged("thinned to 100 %")),
    "30 % of the points": ("third_", tagged("thinned to 30 %")),
    "10 % of the points": ("tenth_", tagged("thinned to 10 %")),
    "thin": ("thin_", lambda stem: stem.dbh_cm < THIN_CM),
    "thick": ("thick_", lambda stem: stem.dbh_cm > THICK_CM),
    "on a swelling": ("swelling_", tagged("swelling")),
    "on no swelling": ("even_", lambda stem: "swelling" not in stem.tags),
}


def find_pieces(path: Path, spec: ScanSpec | None = None) -> list[Piece]:
    """The pieces of a scan's stems whose section is known."""
    points = np.asarray(read_cloud(path).xyz, dtype=np.float64)
    result = analyse_plot(points)
    feet = [(tree.x_m, tree.y_m, tree.z_ground_m) for tree in result.trees]
    return pieces_of(points, feet, [float(section.circle_m[2]) for section in result.sections], spec)


def run(pieces: Sequence[Piece], first_seed: int, plots: int, *, echo: bool = True) -> list[Match]:
    """Resample and measure ``plots`` plots."""
    matches: list[Match] = []
    for seed in range(first_seed, first_seed + plots):
        cloud = resample(seed, pieces)
        start = time.perf_counter()
        result = analyse_plot(cloud.points)
        seconds = time.perf_counter() - start
        new = match(seed, cloud, result.trees, [section.shared_sd_m for section in result.sections])
        matches += new
        if echo:
            omitted = [(m.truth.tags, round(m.truth.dbh_cm, 1)) for m in new if m.truth and not m.tree]
            false = sum(1 for m in new if m.truth is None)
            print(f"  seed {seed}: {len(cloud.points)} points, {seconds:.1f} s, omitted {omitted}, {false} false")
    return matches


def reference_figures(pieces: Sequence[Piece], matches: Iterable[Match]) -> dict[str, float]:
    """What the references are, and the coverage of the stem of the scan that is worst.

    ``oval_percent`` is by how much the sections are longer one way than a circle, ``oval_one_way_percent`` whether the
    stems are so each in its own direction (small) or all in one (100), as where a scan's stations do not fit together.
    """
    stds = np.array([100.0 * piece.section.std_m for piece in pieces])
    ovals: dict[int, list[complex]] = {}
    for piece in pieces:
        ovals.setdefault(piece.stem, []).append(piece.section.oval)
    ways = np.array([np.mean(values) for values in ovals.values()])
    inside: dict[int, list[bool]] = {}
    for m in matches:
        if isinstance(m.truth, ResampledTruth) and m.tree is not None and m.tree.dbh_cm is not None:
            error = m.tree.dbh_cm - m.truth.dbh_cm
            inside.setdefault(m.truth.stem, []).append(abs(error) <= m.tree.half95_cm)
    shares = {stem: 100.0 * float(np.mean(hits)) for stem, hits in inside.items()}
    for stem, share in sorted(shares.items()):
        print(f"  stem {stem} of the scan: {len(inside[stem])} measured, in the interval {share:.1f} %")
    return {
        "scanned_stems": len({piece.stem for piece in pieces}),
        "sections": len(pieces),
        "oval_percent": 100.0 * float(np.median([abs(piece.section.oval) for piece in pieces])),
        "oval_one_way_percent": 100.0 * float(np.abs(np.mean(ways / np.abs(ways)))),
        "reference_std_median_cm": float(np.median(stds)),
        "reference_std_largest_cm": float(stds.max()),
        "worst_stem_inside_interval_percent": min(shares.values(), default=float("nan")),
    }


def write_rows(path: Path, matches: Iterable[Match]) -> None:
    """Every resampled stem, for a spreadsheet."""
    with path.open("w", newline="", encoding="utf-8") as handle:
        writer = csv.writer(handle)
        head = ["seed", "tree", "stem", "height_m", "tape_cm", "std_cm", "tags", "found_cm", "half_cm"]
        writer.writerow([*head, "arc", "residual_cm", "points", "status", "reason"])
        for m in matches:
            if not isinstance(m.truth, ResampledTruth):
                continue
            s, t = m.truth, m.tree
            row = [m.seed, s.tree_id, s.stem, s.height_m, s.dbh_cm, s.std_cm, "|".join(s.tags)]
            if t is not None:
                row += [t.dbh_cm, t.half95_cm if t.dbh_cm else "", t.arc_coverage, t.residual_cm, t.points]
                row += [t.status, t.reason]
            writer.writerow(row)


def main(argv: list[str] | None = None) -> int:
    """Run and print."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.resampled", description=__doc__)
    parser.add_argument("scan", type=Path, help="LAS, LAZ or PLY, dense and from all sides")
    parser.add_argument("--plots", type=int, default=45, help="of 16 stems each")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--rows", type=Path, help="CSV of all stems")
    parser.add_argument("--half-m", type=float, default=ScanSpec().half_m, help="half of the piece of a reference")
    parser.add_argument("--largest-std-cm", type=float, default=100.0 * SectionLimits().std_m, help="of a reference")
    add_result_options(parser)
    args = parser.parse_args(argv)
    check_result_options(parser, args)
    spec = ScanSpec(half_m=args.half_m, limits=SectionLimits(std_m=0.01 * args.largest_std_cm))
    pieces = find_pieces(args.scan, spec)
    if not pieces:
        parser.error(f"{args.scan.name}: no stem is scanned densely enough nearly all round, with one wall")
    matches = run(pieces, args.first_seed, args.plots)
    figures = figures_of(matches, GROUPS)
    figures |= reference_figures(pieces, matches)
    print(
        "{sections} sections of {scanned_stems} stems; standard error of the reference {reference_std_median_cm:.2f} cm"
        " (median), at most {reference_std_largest_cm:.2f}; oval by {oval_percent:.1f} %, in one direction "
        "{oval_one_way_percent:.0f} %".format(**figures)
    )
    print(summary(figures, GROUPS))
    settings = {
        "scan": args.scan.name,
        "half_m": args.half_m,
        "largest_std_cm": args.largest_std_cm,
        "plots": args.plots,
        "first_seed": args.first_seed,
        "last_seed": args.first_seed + args.plots - 1,
    }
    save_result(args, figures, module="tests.bench.resampled", arguments=argv, settings=settings)
    if args.rows:
        write_rows(args.rows, matches)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
