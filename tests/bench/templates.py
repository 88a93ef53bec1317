"""The tables that :mod:`tests.bench.tables` makes from result files: each template takes results and gives lines.

A template is named in a document (``<!-- figures: headline NAME NAME -->``) and says what a kind of benchmark has to
show, good or bad. The headline takes blind sets only.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from statistics import median

from tests.bench.cells import Lines, counted, known, number, source, table
from tests.bench.results import RESULTS, Result, read_result
from tests.bench.stem_tables import classes, plot_classes, resampled, stems

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

#: Photographs from which on a walk is a long one, and figures that are summed over plots.
_LONG_WALK = 200
_SUMMED = ("photos", "photos_registered", "trees", "matched", "false", "inside_interval", "with_interval")

Template = Callable[[Sequence[Result]], Lines]


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
    return _blind_rows(results, "docs/results")


def each(results: Sequence[Result]) -> Lines:
    """As :func:`headline`, in a document that lies beside the results."""
    return _blind_rows(results, "results")


def _blind_rows(results: Sequence[Result], folder: str) -> Lines:
    rows = []
    for result in _blind(results):
        what, found = HEADLINES[result.benchmark](result)
        rows.append([what, found, f"[{result.name}]({folder}/{result.name}.json)"])
    return table(["blind set", "result", "file, with its command"], rows)


def _blind(results: Sequence[Result]) -> Sequence[Result]:
    for result in results:
        if result.kind != "blind":
            raise ValueError(f"{result.name} is a {result.kind} set: the headline takes blind sets only")
    return results


def together(results: Sequence[Result]) -> Lines:
    """Blind rendered plots, a row each kind: those that went wrong count as all others do."""
    kinds: dict[tuple[str, bool], list[Mapping[str, float]]] = {}
    for result in _blind(results):
        drawn = result.settings.get("plot", {})
        phone = drawn.get("phone") == "True" or drawn.get("phone_video") == "True"
        what = "with a phone's effects in a breeze" if phone else "without a phone's effects"
        kinds.setdefault((what, result.figures["photos"] >= _LONG_WALK), []).append(result.figures)
    rows = []
    for (what, _), figures in kinds.items():
        photos = sorted({f["photos"] for f in figures})
        length = " to ".join(f"{number_of:g}" for number_of in dict.fromkeys((photos[0], photos[-1])))
        errors = sorted(f["rmse_cm"] for f in figures)
        total = {key: sum(f[key] for f in figures) for key in _SUMMED}
        rows.append(
            [
                f"{what}, {length} photographs",
                f"{len(figures)}",
                f"{total['photos_registered']:g} of {total['photos']:g}",
                f"{total['matched']:g} of {total['trees']:g}",
                f"{total['false']:g}",
                f"{number(float(median(errors)), '.2f')} cm, {number(errors[-1], '.2f')} cm",
                f"{total['inside_interval']:g} of {total['with_interval']:g}",
            ]
        )
    head = ["blind rendered plots", "plots", "photographs placed", "trees with a DBH", "false trees"]
    return table([*head, "RMSE of the median plot, of the worst", "inside their 95 % interval"], rows)


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
    "float32": "depth network in float32, as on processors without AVX2",
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
    "each": each,
    "together": together,
    "plots": plots,
    "stems": stems,
    "classes": classes,
    "resampled": resampled,
    "plot-classes": plot_classes,
    "effects": effects,
    "same": ways,
    "index": index,
}
