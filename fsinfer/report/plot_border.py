"""The plot within its border, as ``plot.json`` tells it: facts in words, and its outline for the map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from fsinfer.output.json_values import of_json
from fsinfer.plot_border.hectare import COUNTING, HectareFigure
from fsinfer.plot_border.plot import PlotFigures
from fsinfer.report.contents import Contents, measured_cm, number

#: Parts of an interval that are smaller than this share of the largest are not named. Source: layout.
_LEAST_PART = 0.05
#: More than means of a table differ by the rounding of its values, cm. Source: format.
_ROUNDED_CM = 0.011
CHANGED_TABLE = (
    "trees.csv was changed after the measurement: what stands here is of the table as it is now, and other files of "
    "this folder are not. Put corrections into edits.csv and measure again (fsinfer trees or fsinfer run), so that all "
    "agree"
)
WITHOUT_BORDER = "of the ground that was seen, not of the plot within its border: trees.csv was changed"
SEEN_GROUND_ONLY = "of the ground that was seen only: the plot has no border (--plot-radius-m, --plot-polygon)"


def border_of(contents: Contents) -> PlotFigures | None:
    """The plot's figures; None without a border, or where ``trees.csv`` was changed since they were made."""
    try:
        # Runs did not always tell where the stems stand.
        figures = of_json(PlotFigures, {"on_unseen": 0} | contents.plot["plot_border"])
    except (TypeError, ValueError, KeyError):
        return None
    rows = rows_in(contents)
    squares = [d * d for d in measured_cm(rows)]
    same = len(rows) == figures.stems and same_mean(squares, figures.quadratic_mean_dbh_cm, power=2)
    return figures if same else None


def rows_in(contents: Contents) -> list[dict[str, str]]:
    """The rows of ``trees.csv`` that are in the plot."""
    return [tree for tree in contents.trees or () if is_in(tree)]


def lost_border(contents: Contents) -> bool:
    """Whether the plot has a border whose figures say nothing any more: ``trees.csv`` was changed since."""
    return bool(contents.plot.get("plot_border")) and contents.trees is not None and border_of(contents) is None


def same_mean(values: Sequence[float], told: float | None, *, power: int = 1) -> bool:
    """Whether the mean of values, or the square root of that of squares, is the one that was ``told``, cm.

    ``trees.csv`` has two digits behind the point. True where nothing was told.
    """
    if told is None or not values:
        return told is None
    mean: float = (sum(values) / len(values)) ** (1 / power)
    return abs(mean - told) < _ROUNDED_CM


def is_in(tree: Mapping[str, str]) -> bool | None:
    """Whether a row of ``trees.csv`` is in the plot; None where that is not known."""
    value = number(tree.get("in_plot"))
    return None if value is None else value != 0


def where(tree: Mapping[str, str]) -> str:
    """Where a row of ``trees.csv`` stands, in words; empty without a border."""
    inside, distance = is_in(tree), number(tree.get("border_m"))
    if inside is None:
        return ""
    near = ", to be measured" if number(tree.get("at_border")) else ""
    far = "" if distance is None else f", {abs(distance):.2f} m from the border"
    return f"{'in' if inside else 'out'}{far}{near}"


def border_facts(figures: PlotFigures) -> list[tuple[str, str]]:
    """Names and values for the table of the plot."""
    rows = [
        ("Border of the plot", _shape(figures)),
        ("Plot area, horizontal", f"{figures.area_m2:,.0f} m² (the ground slopes by {figures.slope_deg:.0f}°)"),
        ("Seen of it", f"{100 * figures.seen_share:.0f} % ({figures.seen_method})"),
        (
            "Stems in the plot",
            f"{figures.stems}: {figures.measured - figures.doubtful} sure, {figures.doubtful} doubtful, "
            f"{figures.unmeasured} without a DBH; {figures.outside} more stand outside",
        ),
    ]
    if figures.quadratic_mean_dbh_cm is not None:
        rows.append(("Quadratic mean DBH in the plot", f"{figures.quadratic_mean_dbh_cm:.1f} cm"))
    if figures.on_unseen:
        rows.append(
            (
                "On the part that was not seen",
                f"{figures.on_unseen} of these stems: they do not stand for others; the figures a hectare take the "
                "part not seen to be like the seen one, but no less than all the stems that were found",
            )
        )
    if figures.border_cases:
        trees = ", ".join(map(str, figures.border_cases))
        rows.append(("At the border", f"tree {trees}: measure in the forest whether they are in"))
    if figures.stems_per_ha is None:
        return [*rows, ("Per hectare", "not given: too little of the plot was seen")]
    rows += _figure_rows("Stems per hectare", "{:,.0f}", "", figures.stems_per_ha, figures.doubtful_stems_per_ha)
    if figures.basal_area_m2_per_ha is not None:
        doubtful = figures.doubtful_basal_area_m2_per_ha
        rows += _figure_rows("Basal area per hectare", "{:.1f}", " m²/ha", figures.basal_area_m2_per_ha, doubtful)
    elif figures.no_basal_area:
        rows.append(("Basal area per hectare", "0.0 m²/ha: no stem in the plot, and none that would tell an interval"))
    return rows


def _shape(figures: PlotFigures) -> str:
    if figures.radius_m is None:
        return f"polygon of {len(figures.corners)} corners"
    places = {"walk": "the middle of the walk", "coordinate": "the place that was given"}
    return f"circle of {figures.radius_m:g} m round {places.get(figures.origin, figures.origin)}"


def _figure_rows(
    name: str, form: str, unit: str, figure: HectareFigure, doubtful: float | None
) -> list[tuple[str, str]]:
    def say(value: float) -> str:
        return form.format(value)

    parts = {cause: half for cause, half in figure.parts.items() if cause != COUNTING}
    largest = max(parts.values(), default=0.0)
    named = sorted(((half, cause) for cause, half in parts.items() if half > _LEAST_PART * largest), reverse=True)
    causes = ", ".join(f"{cause} ± {say(half)}" for half, cause in named)
    value = f"{say(figure.value)}{unit}, 95 % interval {say(figure.lo95)} to {say(figure.hi95)}"
    if causes:
        value += f" ({causes})"
    if doubtful:
        value += f"; {say(doubtful)} of it from doubtful stems"
    sample = f"{say(figure.stand_lo95)} to {say(figure.stand_hi95)}{unit} (counting ± {say(figure.parts[COUNTING])})"
    return [(name, value), (f"{name}, as one sample of the stand", sample)]
