"""Tables of stems: simulated ones, resampled scans, and those of rendered plots by class."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial

from tests.bench.cells import Lines, covered, error, group, known, number, table
from tests.bench.classes import CLASSES as STEM_CLASSES
from tests.bench.results import Result

#: How the figures of a class of stems of a rendered plot begin.
CLASS_PREFIXES = tuple(prefix for prefix, _ in STEM_CLASSES.values())


def stems(results: Sequence[Result]) -> Lines:
    """Simulated stems, a column each, beside what was asked for."""
    rows: list[tuple[str, str, Callable[[Result], str]]] = [
        ("set, seeds", "", lambda r: f"{r.kind}, {r.settings['first_seed']} to {r.settings['last_seed']}"),
        ("stems", "≥ 500", lambda r: f"{r.figures['stems']:g}"),
        ("found", "≥ 98 %", lambda r: f"{r.figures['found']:g}, {r.figures['found_percent']:.1f} %"),
        ("false", "≤ 1 %", lambda r: f"{r.figures['false']:g}, {r.figures['false_percent']:.1f} %"),
        ("with a DBH", "", lambda r: f"{r.figures['measured']:g}"),
        ("RMSE", "LiDAR ≤ 0.3, photogrammetric ≤ 0.7 cm", lambda r: known(r, "rmse_cm", ".2f", " cm")),
        ("bias", "LiDAR ≤ 0.1, photogrammetric ≤ 0.2 cm", lambda r: known(r, "bias_cm", "+.2f", " cm")),
        ("MAE", "", lambda r: known(r, "mae_cm", ".2f", " cm")),
        ("largest error", "", lambda r: known(r, "worst_cm", ".2f", " cm")),
        ("inside their 95 % interval", "93 to 97 %", lambda r: known(r, "inside_interval_percent", ".1f", " %")),
        ("half width of the interval, median", "", lambda r: known(r, "half_width_median_cm", ".2f", " cm")),
        ("seen all round: stems with a DBH, RMSE, inside", "", lambda r: group(r, "whole_")),
        ("partly hidden: stems with a DBH, RMSE, inside", "", lambda r: group(r, "hidden_")),
        ("thinner than 20 cm: stems with a DBH, RMSE, inside", "", lambda r: group(r, "thin_")),
        (
            "double walls: refused, doubtful, called sure",
            "",
            double_walls,
        ),
        ("code, date", "", lambda r: f"{r.short_commit}, {r.date[:10]}"),
    ]
    names = {"photo": "photogrammetric", "lidar": "LiDAR-like"}
    return table(
        ["", "asked for", *(f"{names[result.settings['kind']]}, `{result.name}`" for result in results)],
        [[label, asked, *(cell(result) for result in results)] for label, asked, cell in rows],
    )


def double_walls(result: Result) -> str:
    """How many have no diameter, a doubtful one and one that is called sure."""
    refused, measured, sure = (int(result.figures[f"double_wall_{name}"]) for name in ("refused", "measured", "sure"))
    return f"{refused}, {measured - sure}, {sure} of {int(result.figures['double_wall_stems'])}"


def classes(results: Sequence[Result]) -> Lines:
    """Coverage by class of stems that a walk saw, a column each: whether an interval holds where it is hard."""
    rows: list[tuple[str, str, Callable[[Result], str]]] = [
        ("set, seeds", "", lambda r: f"{r.kind}, {r.settings['first_seed']} to {r.settings['last_seed']}"),
        ("stems, found, false", "", lambda r: "{stems:g}, {found:g}, {false:g}".format(**r.figures)),
        ("all but torn walks: RMSE, bias", "", lambda r: error(r, "single_wall_")),
    ]
    names = {
        "single_wall_": "all but torn walks",
        "whole_": "seen from 300° and more",
        "hidden_": "seen from less than 250°",
        "thin_": "thinner than 15 cm",
        "leaning_": "leaning by 7° and more",
        "far_": "no nearer than 6 m",
        "double_wall_": "torn walks: two parts 2 to 5 cm apart",
    }
    for prefix, name in names.items():
        asked = "" if prefix == "double_wall_" else "93 to 97 %"
        rows.append((f"{name}: stems, RMSE, inside, half width", asked, partial(covered, prefix=prefix)))
    rows.append(("code, date", "", lambda r: f"{r.short_commit}, {r.date[:10]}"))
    kinds = {"walked-photo": "photographed", "walked-lidar": "scanned"}
    return table(
        ["", "asked for", *(f"{kinds[result.settings['kind']]}, `{result.name}`" for result in results)],
        [[label, asked, *(cell(result) for result in results)] for label, asked, cell in rows],
    )


def resampled(results: Sequence[Result]) -> Lines:
    """Pieces of real scans under a known diameter, a column a scan."""
    rows: list[tuple[str, str, Callable[[Result], str]]] = [
        ("set, seeds", "", lambda r: f"{r.kind}, {r.settings['first_seed']} to {r.settings['last_seed']}"),
        ("sections of stems", "", lambda r: f"{r.figures['sections']:g} of {r.figures['scanned_stems']:g}"),
        (
            "oval by; one way (0 %: each its own, 100 %: all the same)",
            "",
            lambda r: f"{known(r, 'oval_percent', '.1f', ' %')}; {known(r, 'oval_one_way_percent', '.0f', ' %')}",
        ),
        (
            "standard error of the reference: median, largest",
            "",
            lambda r: (
                f"{known(r, 'reference_std_median_cm', '.2f', ' cm')}, "
                f"{known(r, 'reference_std_largest_cm', '.2f', ' cm')}"
            ),
        ),
        (
            "pieces, found, with a DBH, false",
            "",
            lambda r: "{stems:g}, {found:g}, {measured:g}, {false:g}".format(**r.figures),
        ),
        ("all: RMSE, bias", "", lambda r: error(r, "")),
    ]
    names = {
        "": "all",
        "seen_360_": "all that was scanned",
        "seen_270_": "a sector of 270°",
        "seen_180_": "a sector of 180°",
        "seen_120_": "a sector of 120°",
        "two_stations_": "two stations",
        "one_station_": "one station",
        "all_points_": "all points of what is seen",
        "third_": "30 % of them",
        "tenth_": "10 % of them",
        "thin_": "thinner than 18 cm",
        "thick_": "thicker than 24 cm",
        "swelling_": "on a whorl, or between two",
    }
    for prefix, name in names.items():
        rows.append((f"{name}: stems, RMSE, inside, half width", "93 to 97 %", partial(covered, prefix=prefix)))
    rows.append(
        ("worst stem of the scan: inside", "", lambda r: known(r, "worst_stem_inside_interval_percent", ".1f", " %"))
    )
    rows.append(("code, date", "", lambda r: f"{r.short_commit}, {r.date[:10]}"))
    return table(
        ["", "asked for", *(f"`{result.settings['scan']}`, `{result.name}`" for result in results)],
        [[label, asked, *(cell(result) for result in results)] for label, asked, cell in rows],
    )


def plot_classes(results: Sequence[Result]) -> Lines:
    """Coverage by class over the stems of several rendered plots together."""
    sums = Counter[str]()
    for result in results:
        sums.update({key: value for key, value in result.figures.items() if key.startswith(CLASS_PREFIXES)})
    rows = []
    for name, (prefix, _) in STEM_CLASSES.items():
        count = sums[f"{prefix}stems"]
        if not count:
            rows.append([name, "0", *["not measured"] * 4])
            continue
        rows.append(
            [
                name,
                f"{count:g}",
                f"{number((sums[f'{prefix}error_squares_cm2'] / count) ** 0.5, '.2f')} cm",
                f"{number(sums[f'{prefix}error_sum_cm'] / count, '+.2f')} cm",
                f"{sums[f'{prefix}inside']:g}",
                f"± {number(sums[f'{prefix}half_width_sum_cm'] / count, '.2f')} cm",
            ]
        )
    head = ["class", "stems with a DBH", "RMSE", "bias", "inside their 95 % interval", "interval, mean"]
    return table(head, rows)
