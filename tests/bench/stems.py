"""Simulated stems against their truth: ``python -m tests.bench.stems --kind photo --plots 20 --first-seed 1000``.

The simulator is :mod:`training.simulate.stem_cloud`. Development sets: seeds below 10, 1000 to 1021 and 2000 to 2021,
on which the constants of the intervals were chosen and corrected, and 3000 to 3021, at which was looked several times.
A blind figure needs seeds that no result file names yet.
Prints detection, false trees, errors and the coverage of the 95 % intervals; ``--rows`` writes every stem for a closer
look.
"""

from __future__ import annotations

import argparse
import csv
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import linear_sum_assignment

from fsinfer.plot_border.hectare import M2_PER_HA, HectareFigure, PlotStems, basal_area_per_ha
from fsinfer.trees import Tree, analyse_plot
from fsinfer.trees.points.sums import Z95
from tests.bench.results import add_result_options, check_result_options, save_result
from training.simulate.stem_cloud import KINDS, CloudSpec, StemCloud, StemTruth, simulate
from training.simulate.walked_cloud import KINDS as WALKED
from training.simulate.walked_cloud import WalkSpec, simulate_walk

MAX_DISTANCE_M = 0.3


@dataclass(frozen=True, kw_only=True)
class Match:
    """A true stem with the tree found for it (None: omitted), or a false tree (``truth`` None).

    ``shared_sd_m`` is the part of the diameter's standard deviation that all stems of the plot share.
    """

    seed: int
    truth: StemTruth | None
    tree: Tree | None
    shared_sd_m: float = 0.0


def match(seed: int, cloud: StemCloud, trees: tuple[Tree, ...], shared_sd_m: Sequence[float] = ()) -> list[Match]:
    """One to one, by least total distance, nearer than ``MAX_DISTANCE_M``; ``shared_sd_m`` (T,) of the trees."""
    truth = np.array([[s.x_m, s.y_m] for s in cloud.stems])
    found = np.array([[t.x_m, t.y_m] for t in trees]).reshape(-1, 2)
    distance = np.linalg.norm(truth[:, None] - found[None], axis=2)
    rows, columns = linear_sum_assignment(np.where(distance < MAX_DISTANCE_M, distance, 1e3))
    links = {int(i): int(j) for i, j in zip(rows, columns, strict=True) if distance[i, j] < MAX_DISTANCE_M}
    shared = shared_sd_m or [0.0] * len(trees)
    result = [
        Match(seed=seed, truth=s, tree=trees[links[i]], shared_sd_m=shared[links[i]])
        if i in links
        else Match(seed=seed, truth=s, tree=None)
        for i, s in enumerate(cloud.stems)
    ]
    return result + [Match(seed=seed, truth=None, tree=t) for j, t in enumerate(trees) if j not in links.values()]


def run(kind: str, first_seed: int, plots: int, *, noise_m: float | None = None, echo: bool = True) -> list[Match]:
    """Simulate and measure ``plots`` plots; ``noise_m`` instead of the kind's noise, of those that are not walked."""
    matches: list[Match] = []
    for seed in range(first_seed, first_seed + plots):
        cloud = (
            simulate_walk(seed, WalkSpec(kind=kind))
            if kind in WALKED
            else simulate(seed, CloudSpec(kind=kind, noise_m=noise_m))
        )
        start = time.perf_counter()
        result = analyse_plot(cloud.points)
        seconds = time.perf_counter() - start
        new = match(seed, cloud, result.trees, [section.shared_sd_m for section in result.sections])
        matches += new
        if echo:
            omitted = [(m.truth.tree_id, round(m.truth.dbh_cm, 1), m.truth.tags) for m in new if m.truth and not m.tree]
            false = [(round(m.tree.x_m, 1), round(m.tree.y_m, 1), m.tree.dbh_cm) for m in new if m.tree and not m.truth]
            print(f"  seed {seed}: {len(cloud.points)} points, {seconds:.1f} s, omitted {omitted}, false {false}")
    return matches


#: Groups of stems by name, with what a file calls them.
Groups = dict[str, tuple[str, Callable[[StemTruth], bool]]]
GROUPS: Groups = {
    "all": ("", lambda stem: True),
    "whole": ("whole_", lambda stem: stem.seen_deg > 359),
    "half hidden": ("hidden_", lambda stem: stem.seen_deg < 359),
    "below 20 cm": ("thin_", lambda stem: stem.dbh_cm < 20),
    "over 40 cm": ("thick_", lambda stem: stem.dbh_cm > 40),
    "double wall": ("double_wall_", lambda stem: "double wall" in stem.tags),
    "all but double walls": ("single_wall_", lambda stem: "double wall" not in stem.tags),
}
#: The classes of the second generator: what makes a stem hard. One that is torn counts there only.
CLASSES: Groups = {
    "all": ("", lambda stem: True),
    "seen all round": ("whole_", lambda stem: "all round" in stem.tags and "double wall" not in stem.tags),
    "half hidden": ("hidden_", lambda stem: "half hidden" in stem.tags and "double wall" not in stem.tags),
    "thin": ("thin_", lambda stem: "thin" in stem.tags and "double wall" not in stem.tags),
    "leaning": ("leaning_", lambda stem: "leaning" in stem.tags and "double wall" not in stem.tags),
    "far": ("far_", lambda stem: "far" in stem.tags and "double wall" not in stem.tags),
    "double wall": ("double_wall_", lambda stem: "double wall" in stem.tags),
    "all but double walls": ("single_wall_", lambda stem: "double wall" not in stem.tags),
}


def groups_of(kind: str) -> Groups:
    """What is told apart in the clouds of a generator."""
    return CLASSES if kind in WALKED else GROUPS


def figures_of(matches: list[Match], groups: Groups = GROUPS) -> dict[str, float]:
    """Detection, false trees, and for each group errors and coverage of the intervals; none where none is measured."""
    stems = [m for m in matches if m.truth is not None]
    found = [(m.truth, m.tree) for m in stems if m.truth is not None and m.tree is not None]
    false = len(matches) - len(stems)
    figures: dict[str, float] = {
        "stems": len(stems),
        "found": len(found),
        "found_percent": 100 * len(found) / len(stems),
        "false": false,
        "false_percent": 100 * false / max(len(found) + false, 1),
    }
    figures |= basal_area_figures(matches)
    for prefix, chosen in groups.values():
        group = [(stem, tree) for stem, tree in found if chosen(stem)]
        figures |= {
            f"{prefix}stems": sum(1 for m in stems if m.truth is not None and chosen(m.truth)),
            f"{prefix}found": len(group),
        }
        measured = [
            (tree.dbh_cm - stem.dbh_cm, tree.dbh_lo95_cm, stem.dbh_cm, tree.dbh_hi95_cm)
            for stem, tree in group
            if tree.dbh_cm is not None and tree.dbh_lo95_cm is not None and tree.dbh_hi95_cm is not None
        ]
        sure = sum(1 for _, tree in group if tree.status == "ok")
        figures |= {
            f"{prefix}measured": len(measured),
            f"{prefix}refused": len(group) - len(measured),
            f"{prefix}sure": sure,
        }
        if not measured:
            continue
        error, low, truth, high = np.array(measured).T
        inside = (low <= truth) & (truth <= high)
        figures |= {
            f"{prefix}rmse_cm": float(np.sqrt((error**2).mean())),
            f"{prefix}bias_cm": float(error.mean()),
            f"{prefix}mae_cm": float(np.abs(error).mean()),
            f"{prefix}worst_cm": float(np.abs(error).max()),
            f"{prefix}inside_interval": int(inside.sum()),
            f"{prefix}inside_interval_percent": 100 * float(inside.mean()),
            f"{prefix}half_width_median_cm": float(np.median(0.5 * (high - low))),
        }
    return figures


def basal_area_figures(matches: list[Match]) -> dict[str, float]:
    """Plots whose basal area lies in its interval: of the stems that were measured, so that only diameters err."""
    plots: dict[int, list[tuple[float, float, float, float]]] = {}
    for m in matches:
        if m.truth is not None and m.tree is not None and m.tree.dbh_cm is not None:
            std_m = m.tree.half95_cm / (100.0 * Z95)
            row = (m.truth.dbh_cm / 100.0, m.tree.dbh_cm / 100.0, std_m, m.shared_sd_m)
            plots.setdefault(m.seed, []).append(row)
    inside, half_widths = 0, []
    for rows in plots.values():
        true_m, dbh_m, std_m, shared_m = np.array(rows).T
        figure = _basal_area(PlotStems(
            inside=np.ones(len(rows), dtype=bool), chance=np.ones(len(rows)), dbh_m=dbh_m, std_m=std_m,
            shared_m=shared_m,
        ))  # fmt: skip
        inside += figure.lo95 <= float((np.pi / 4.0 * true_m**2).sum()) <= figure.hi95
        half_widths.append(100.0 * (figure.hi95 - figure.lo95) / (2.0 * figure.value))
    if not plots:
        return {}
    return {
        "basal_area_plots": len(plots),
        "basal_area_inside_interval": inside,
        "basal_area_inside_interval_percent": 100 * inside / len(plots),
        "basal_area_half_width_median_percent": float(np.median(half_widths)),
    }


def _basal_area(stems: PlotStems) -> HectareFigure:
    figure = basal_area_per_ha(stems, area_m2=M2_PER_HA, share=1.0)
    if figure is None:
        msg = "a plot of measured stems has a basal area"
        raise AssertionError(msg)
    return figure


def summary(figures: dict[str, float], groups: Groups = GROUPS) -> str:
    """The figures, one line a group."""
    lines = [
        f"stems {figures['stems']}, detected {figures['found_percent']:.2f} %, "
        f"false {figures['false']} ({figures['false_percent']:.2f} %)"
    ]
    if "basal_area_plots" in figures:
        lines.append(
            f"basal area of measured stems: in the interval on {figures['basal_area_inside_interval']} of "
            f"{figures['basal_area_plots']} plots, half width {figures['basal_area_half_width_median_percent']:.1f} % "
            "(median)"
        )
    for name, (prefix, _) in groups.items():
        own = {key.removeprefix(prefix): value for key, value in figures.items() if key.startswith(prefix)}
        if not own["measured"]:
            lines.append(f"{name:>20}: n {own['found']}, none measured")
            continue
        lines.append(
            f"{name:>20}: n {own['found']}, measured {own['measured']}, RMSE {own['rmse_cm']:.3f} cm, "
            f"bias {own['bias_cm']:+.3f}, MAE {own['mae_cm']:.3f}, worst {own['worst_cm']:.2f}, "
            f"in the interval {own['inside_interval_percent']:.1f} %, "
            f"half width {own['half_width_median_cm']:.2f} (median)"
        )
    return "\n".join(lines)


def write_rows(path: Path, matches: list[Match]) -> None:
    """Every stem and every false tree, for a spreadsheet."""
    with path.open("w", newline="", encoding="utf-8") as handle:
        writer = csv.writer(handle)
        writer.writerow(
            [
                "seed",
                "x_m",
                "y_m",
                "dbh_cm",
                "seen_deg",
                "tags",
                "found_cm",
                "lo",
                "hi",
                "arc",
                "residual_cm",
                "points",
                "status",
                "reason",
            ]
        )
        for m in matches:
            s, t = m.truth, m.tree
            where = next((one.x_m, one.y_m) for one in (s, t) if one is not None)
            row = [m.seed, *where, *((s.dbh_cm, s.seen_deg, "|".join(s.tags)) if s else ("", "", "false"))]
            if t is not None:
                row += [t.dbh_cm, t.dbh_lo95_cm, t.dbh_hi95_cm, t.arc_coverage, t.residual_cm, t.points]
                row += [t.status, t.reason]
            writer.writerow(row)


def main(argv: list[str] | None = None) -> int:
    """Run and print."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.stems", description=__doc__)
    parser.add_argument("--kind", choices=(*KINDS, *WALKED), default="lidar")
    parser.add_argument("--plots", type=int, default=22, help="of about 25 stems each")
    parser.add_argument("--first-seed", type=int, default=1000)
    parser.add_argument("--noise-m", type=float, help="instead of the kind's, of those that are not walked")
    parser.add_argument("--rows", type=Path, help="CSV of all stems")
    add_result_options(parser)
    args = parser.parse_args(argv)
    check_result_options(parser, args)
    if args.noise_m is not None and args.kind in WALKED:
        parser.error("--noise-m is for clouds that are not walked")
    matches = run(args.kind, args.first_seed, args.plots, noise_m=args.noise_m)
    noise = "" if args.noise_m is None else f", noise {100.0 * args.noise_m:g} cm"
    print(f"{args.kind}{noise}, seeds {args.first_seed} to {args.first_seed + args.plots - 1}")
    groups = groups_of(args.kind)
    figures = figures_of(matches, groups)
    print(summary(figures, groups))
    settings = {
        "kind": args.kind,
        "plots": args.plots,
        "first_seed": args.first_seed,
        "last_seed": args.first_seed + args.plots - 1,
    } | ({} if args.noise_m is None else {"noise_m": args.noise_m})
    save_result(args, figures, module="tests.bench.stems", arguments=argv, settings=settings)
    if args.rows:
        write_rows(args.rows, matches)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
