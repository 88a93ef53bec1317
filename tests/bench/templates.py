"""The tables that :mod:`tests.bench.tables` makes from result files: each template takes results and gives lines.

A template is named in a document (``<!-- figures: headline NAME NAME -->``) and says what a kind of benchmark has to
show, good or bad. The headline takes blind sets only.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import partial

from tests.bench.classes import CLASSES as STEM_CLASSES
from tests.bench.results import RESULTS, Result, read_result

#: How the figures of a class of stems of a rendered plot begin.
CLASS_PREFIXES = tuple(prefix for prefix, _ in STEM_CLASSES.values())

#: The cases of ``tests.bench.effects`` in words, in the order of the table.
EFFECT_WORDS = {
    "none": "none",
    "rolling": "rolling shutter, 25 ms",
    "blur": "motion blur, 8 ms",
    "breathing": "focal length ± 0.15 %",
    "principal": "principal point ± 2 px",
    "distortion": "distortion",
    "exposure": "exposure ± 30 %, clouds",
    "tone": "local tone mapping, noise, sharpening, glare",
    "wind": "leaves and undergrowth move 1.5 cm",
    "bark": "a bark of its own for each tree",
    "phone": "all together (`--phone`)",
    "video": "all together, 1 m/s (`--phone-video`)",
}

Lines = list[str]
Template = Callable[[Sequence[Result]], Lines]


def number(value: float, spec: str) -> str:
    """A number with a real minus sign."""
    return format(value, spec).replace("-", "\N{MINUS SIGN}")


def counted(value: float, one: str, many: str) -> str:
    """``no false trees``, ``1 false tree``, ``2 false trees``."""
    return f"no {many}" if value == 0 else f"{value:g} {one if value == 1 else many}"


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> Lines:
    """A Markdown table."""
    return [f"| {' | '.join(line)} |" for line in (head, ["---"] * len(head), *rows)]


def trees_text(f: Mapping[str, float]) -> str:
    """The trees of a plot in one sentence."""
    parts = [f"{f['matched']:g} of {f['trees']:g} trees with a DBH", counted(f["false"], "false tree", "false trees")]
    if "rmse_cm" in f:
        parts += [
            f"RMSE {number(f['rmse_cm'], '.2f')} cm",
            f"bias {number(f['bias_cm'], '+.2f')} cm",
            f"AE {number(f['ae_percent'], '.1f')} %",
            f"{f['inside_interval']:g} of {f['with_interval']:g} inside their 95 % interval",
        ]
    return ", ".join(parts)


def plot_headline(result: Result) -> tuple[str, str]:
    """A rendered plot: what it is, what came out."""
    f, drawn = result.figures, result.settings.get("plot", {})
    slope_deg = float(drawn.get("slope_deg") or 0)
    slope = f" on a slope of {slope_deg:g}°" if slope_deg else " on flat ground" if "slope_deg" in drawn else ""
    phone = {"phone": ", a phone's effects in a breeze", "phone_video": ", a phone's video walked at 1 m/s"}
    effects = next((words for name, words in phone.items() if drawn.get(name) == "True"), "")
    undergrown = ", undergrown" if float(drawn.get("undergrowth") or 0) > 0.5 else ""
    what = f"a rendered plot{slope}{undergrown}{effects}: {f['trees']:g} trees, {f['photos']:g} photographs"
    return what, f"{f['photos_registered']:g} of {f['photos']:g} photographs registered, {trees_text(f)}"


def video_headline(result: Result) -> tuple[str, str]:
    """A rendered video."""
    f = result.figures
    what = f"a rendered phone video, held upright, mostly blurred: {f['trees']:g} trees, {f['boards']:g} boards seen"
    return what, (
        f"{f['frames_registered']:g} of {f['photos']:g} frames registered, "
        f"scale error {number(f['scale_error_percent'], '+.2f')} %, {trees_text(f)}"
    )


def stems_headline(result: Result) -> tuple[str, str]:
    """Simulated stems."""
    f = result.figures
    kind = {"photo": "photogrammetric", "lidar": "LiDAR-like"}[result.settings["kind"]]
    what = f"{f['stems']:g} simulated stems in {kind} clouds, {f['hidden_stems']:g} of them partly hidden"
    return what, (
        f"{f['found']:g} of {f['stems']:g} found, {counted(f['false'], 'false stem', 'false stems')}, "
        f"{f['measured']:g} with a DBH, RMSE {number(f['rmse_cm'], '.2f')} cm, bias {number(f['bias_cm'], '+.2f')} cm, "
        f"{f['inside_interval_percent']:.1f} % inside their 95 % interval"
    )


def depth_headline(result: Result) -> tuple[str, str]:
    """Depth maps of rendered walks, in metres."""
    f = result.figures
    what = f"depth maps of {f['views']:g} rendered photographs, pixels nearer than 6 m"
    return what, (
        f"median error {number(f['pooled_median_abs_cm'], '.2f')} cm; of the surer 70 % of the pixels "
        f"{number(f['pooled_median_abs_sure_cm'], '.2f')} cm, {f['pooled_within_3cm_sure_percent']:.1f} % within 3 cm"
    )


HEADLINES: dict[str, Callable[[Result], tuple[str, str]]] = {
    "tests.bench.plot": plot_headline,
    "tests.bench.video": video_headline,
    "tests.bench.stems": stems_headline,
    "tests.bench.depth": depth_headline,
}


def headline(results: Sequence[Result]) -> Lines:
    """One row a result; raises ValueError for a set that is not blind."""
    rows = []
    for result in results:
        if result.kind != "blind":
            raise ValueError(f"{result.name} is a {result.kind} set: the headline takes blind sets only")
        what, found = HEADLINES[result.benchmark](result)
        rows.append([what, found, f"[{result.name}](docs/results/{result.name}.json)"])
    return table(["blind set", "result", "file, with its command"], rows)


def plots(results: Sequence[Result]) -> Lines:
    """Rendered plots and the demo, a column each, beside what was asked for."""
    rows: list[tuple[str, str, Callable[[Result], str]]] = [
        ("set", "", lambda r: r.kind),
        (
            "photographs registered",
            "",
            lambda r: f"{r.figures['photos_registered']:g} of {r.figures['photos']:g}",
        ),
        ("camera positions, RMS", "", lambda r: known(r, "cameras_rms_mm", ".1f", " mm")),
        ("error of the scale from the markers", "", lambda r: known(r, "scale_error_percent", "+.2f", " %")),
        ("depth maps to triangulated points, median", "", lambda r: known(r, "depth_vs_sfm_percent", ".3f", " %")),
        (
            "trees with a DBH, r",
            "≥ 98 %",
            lambda r: (
                f"{r.figures['matched']:g} of {r.figures['trees']:g}, "
                f"{number(r.figures['completeness_percent'], '.0f')} %; {r.figures['omitted']:g} omitted"
            ),
        ),
        ("false trees inside the plot", "0", lambda r: f"{r.figures['false']:g}"),
        ("RMSE", "≤ 0.5 cm", lambda r: known(r, "rmse_cm", ".2f", " cm")),
        ("bias", "≤ 0.15 cm", lambda r: known(r, "bias_cm", "+.2f", " cm")),
        ("MAE", "", lambda r: known(r, "mae_cm", ".2f", " cm")),
        ("largest error", "", lambda r: known(r, "worst_cm", ".2f", " cm")),
        ("AE = 1 − rRMSE", "≥ 98 %", lambda r: known(r, "ae_percent", ".1f", " %")),
        (
            "inside their 95 % interval",
            "",
            lambda r: f"{r.figures['inside_interval']:g} of {r.figures['with_interval']:g}",
        ),
        ("points alone: RMSE, largest error", "", lambda r: source(r, "points")),
        ("edges alone: RMSE, largest error", "", lambda r: source(r, "edges")),
        ("code, date", "", lambda r: f"{r.short_commit}, {r.date[:10]}"),
    ]
    return table(
        ["", "asked for", *(f"`{result.name}`" for result in results)],
        [[label, asked, *(cell(result) for result in results)] for label, asked, cell in rows],
    )


def known(result: Result, key: str, spec: str, unit: str) -> str:
    """A figure with its unit, a dash where the result has none."""
    return f"{number(result.figures[key], spec)}{unit}" if key in result.figures else "–"


def source(result: Result, name: str) -> str:
    """RMSE and largest error of the points or the edges alone."""
    rmse, worst = (known(result, f"{name}_alone_{key}_cm", ".2f", " cm") for key in ("rmse", "worst"))
    return f"{rmse}, {worst}" if rmse != "–" else "–"


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
            "double walls refused",
            "",
            lambda r: f"{r.figures['double_wall_refused']:g} of {r.figures['double_wall_stems']:g}",
        ),
        ("code, date", "", lambda r: f"{r.short_commit}, {r.date[:10]}"),
    ]
    names = {"photo": "photogrammetric", "lidar": "LiDAR-like"}
    return table(
        ["", "asked for", *(f"{names[result.settings['kind']]}, `{result.name}`" for result in results)],
        [[label, asked, *(cell(result) for result in results)] for label, asked, cell in rows],
    )


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


def effects(results: Sequence[Result]) -> Lines:
    """Each effect of a phone alone and doubled: photographs at their place, diameters, and COLMAP's default beside."""

    def placed(f: Mapping[str, float], case: str, way: str) -> str:
        right, of, rms_mm = (f.get(f"{case}_{key}") for key in (f"{way}_right", "photos", f"{way}_rms_mm"))
        if right is None or of is None or rms_mm is None:
            return "not measured"
        return f"{right:g} of {of:g}, {number(rms_mm, '.1f')} mm"

    def diameters(f: Mapping[str, float], case: str) -> str:
        rmse, bias, matched, of = (f.get(f"{case}_ours_{key}") for key in ("rmse_cm", "bias_cm", "matched", "trees"))
        if rmse is None or bias is None or matched is None or of is None:
            return "not measured"
        return f"{matched:g} of {of:g}, {number(rmse, '.2f')}, {number(bias, '+.2f')} cm"

    rows = []
    for f in (result.figures for result in results):
        for case, words in EFFECT_WORDS.items():
            for name, said in ((case, words), (f"{case}2", f"{words}, doubled")):
                if f"{name}_photos" in f:
                    places = [placed(f, name, way) for way in ("cheap", "ours", "colmap")]
                    rows.append([said, *places[:2], diameters(f, name), places[2]])
    head = ["effect", "without a second look", "as shipped", "DBH: stems, RMSE, bias", "COLMAP, default settings"]
    return table(head, rows)


def error(result: Result, prefix: str) -> str:
    """RMSE and bias of one group."""
    return f"{known(result, f'{prefix}rmse_cm', '.2f', ' cm')}, {known(result, f'{prefix}bias_cm', '+.2f', ' cm')}"


def covered(result: Result, prefix: str) -> str:
    """Stems with a DBH, RMSE, coverage and the median half width of one group."""
    return f"{group(result, prefix)}, ± {known(result, f'{prefix}half_width_median_cm', '.2f', ' cm')}"


def group(result: Result, prefix: str) -> str:
    """Stems with a DBH, RMSE and coverage of one group."""
    rmse = known(result, f"{prefix}rmse_cm", ".2f", " cm")
    inside = known(result, f"{prefix}inside_interval_percent", ".1f", " %")
    return f"{result.figures[f'{prefix}measured']:g}, {rmse}, {inside}"


def index(results: Sequence[Result]) -> Lines:
    """Every result file there is, or those named."""
    found = list(results) or [read_result(path.stem) for path in sorted(RESULTS.glob("*.json"))]
    rows = [
        [
            f"[{r.name}](results/{r.name}.json)",
            r.kind,
            r.short_commit,
            r.date[:10],
            f"`{r.command}`{'; ' if r.note else ''}{r.note}",
        ]
        for r in found
    ]
    return table(["file", "set", "code", "date", "command"], rows)


#: Ways of tests.bench.same in words.
WAYS_WORDS = {
    "again": "once more",
    "one_core": "on one core",
    "hogs": "two busy programs beside it",
    "avx2_libraries": "OpenBLAS, OpenCV and NumPy with their code for AVX2",
    "float32": "depth network in float32, as without 8-bit dot products",
}


def ways(results: Sequence[Result]) -> Lines:
    """The same photographs measured in other circumstances: what the worst stem differs by."""
    rows = []
    for f in (result.figures for result in results):
        for way, words in WAYS_WORDS.items():
            if f"{way}_stems" not in f:
                continue
            row = {key: f[f"{way}_{key}"] for key in ("dbh_cm", "half_width_cm", "place_mm", "unmatched", "changed")}
            worst = [number(row["dbh_cm"], ".2f"), number(row["half_width_cm"], ".2f"), number(row["place_mm"], ".0f")]
            others = f"{row['unmatched']:g}, {row['changed']:g}"
            identical = "yes" if f[f"{way}_identical"] else "no"
            rows.append([words, identical, *worst, others])
    head = ["against the first run", "`trees.csv` identical", "DBH, cm", "half interval, cm", "place, mm"]
    return table([*head, "stems in one run only, of another status"], rows)


TEMPLATES: dict[str, Template] = {
    "headline": headline,
    "plots": plots,
    "stems": stems,
    "classes": classes,
    "resampled": resampled,
    "plot-classes": plot_classes,
    "effects": effects,
    "same": ways,
    "index": index,
}
