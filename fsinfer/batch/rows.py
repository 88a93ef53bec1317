"""A plot in the summary: its row, from its outcome and from what its folder holds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from fsinfer.batch.outcome import Outcome, State
from fsinfer.batch.plots_table import Plot
from fsinfer.errors import InputError
from fsinfer.io.csv_text import Cell, read_table
from fsinfer.output.layout import REPORT_FILE, TREES_CSV
from fsinfer.output.plot_json import read_plot
from fsinfer.trees.outputs.table import COLUMNS, read_trees, table_row

#: Where the plots' folders lie in the output folder.
PLOTS_FOLDER = "plots"
#: Columns of the table of all trees.
TREE_COLUMNS = ("plot", *COLUMNS)
#: Where a plot's place on earth is from.
FROM_TABLE, FROM_PHOTOS = "table of plots", "photos"


@dataclass(frozen=True, kw_only=True)
class PlotRow:
    """A row of the summary; None where a figure is not known.

    Attributes
    ----------
    plot: its name. state: done, outdated (its results are not those of the options that it has now), failed or
        waiting. message: why it is not done, or that its photographs are not there.
    stratum, stratum_ha: part of the forest that it lies in, and the area of all of it; from the table of plots.
    trees, trees_with_dbh: numbers of stems, without those outside of the walk. trees_on_area: those that the figures a
        hectare count, in the plot's border (outside of the walk or not) or on the seen ground. per_hectare_of: what the
        figures a hectare refer to; has_border: whether that is the plot within its border.
    stems_per_ha, basal_area_m2_per_ha: with 95 % intervals where the plot has a border; both are 0 on a plot without
        stems, of whose basal area there is no interval.
    quadratic_mean_dbh_cm, mean_dbh_cm: of the stems that these figures count.
    area_m2: of the plot, or of the seen ground.
    photos, registered: numbers of photographs. units: m, or model units without a scale. scale_source: of the metre.
    warnings: how many, without mere remarks; warning_text: they themselves.
    latitude_deg, longitude_deg: WGS84. place_source: who says so.
    attempts, seconds: of all attempts. host: the computer that measured it. report: path below the output folder.
    """

    plot: str
    state: State
    message: str = ""
    stratum: str = ""
    stratum_ha: float | None = None
    trees: int | None = None
    trees_with_dbh: int | None = None
    trees_on_area: int | None = None
    per_hectare_of: str = ""
    has_border: bool | None = None
    stems_per_ha: float | None = None
    stems_per_ha_lo95: float | None = None
    stems_per_ha_hi95: float | None = None
    basal_area_m2_per_ha: float | None = None
    basal_area_lo95_m2_per_ha: float | None = None
    basal_area_hi95_m2_per_ha: float | None = None
    quadratic_mean_dbh_cm: float | None = None
    mean_dbh_cm: float | None = None
    area_m2: float | None = None
    photos: int | None = None
    registered: int | None = None
    units: str = ""
    scale_source: str = ""
    warnings: int | None = None
    warning_text: str = ""
    latitude_deg: float | None = None
    longitude_deg: float | None = None
    place_source: str = ""
    attempts: int = 0
    seconds: float | None = None
    host: str = ""
    report: str = ""


#: Columns of the summary.
PLOT_COLUMNS: tuple[str, ...] = tuple(field.name for field in fields(PlotRow))
#: Digits behind the point by the end of a name. Source: layout; more than the measurement has.
_DIGITS = (
    ("_deg", 6), ("_m2_per_ha", 2), ("_lo95", 1), ("_hi95", 1), ("_per_ha", 1), ("_cm", 2), ("_m2", 1), ("_ha", 4),
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class PlotTrees:
    """The trees of a plot with its name in front: as text, as in its own table, and as values for a workbook."""

    text: tuple[tuple[str, ...], ...] = ()
    values: tuple[tuple[Cell, ...], ...] = ()


def cells(row: PlotRow) -> tuple[Cell, ...]:
    """The values of ``PLOT_COLUMNS``, rounded."""
    return tuple(_rounded(name, getattr(row, name)) for name in PLOT_COLUMNS)


def plot_row(plot: Plot, out: Path, outcome: Outcome | None) -> tuple[PlotRow, PlotTrees]:
    """The row of a plot whose folder is ``out``, and its trees; nothing of a plot without results is counted."""
    place = plot.place_deg or (None if outcome is None else outcome.place_deg)
    known: dict[str, Any] = {"plot": plot.name, "state": State.waiting}
    known |= {"stratum": plot.stratum, "stratum_ha": plot.stratum_ha}
    if place is not None:
        source = FROM_TABLE if plot.place_deg is not None else FROM_PHOTOS
        known |= {"latitude_deg": place[0], "longitude_deg": place[1], "place_source": source}
    if outcome is None:
        return PlotRow(**known), PlotTrees()
    known |= {"state": outcome.state, "attempts": outcome.attempts, "seconds": outcome.seconds, "host": outcome.host}
    known |= {"message": outcome.message}
    if outcome.state not in (State.done, State.outdated):
        return PlotRow(**known), PlotTrees()
    try:
        found = read_plot(out)
        trees = _trees(plot.name, out / TREES_CSV)
    except InputError as error:
        # What a run has written can only be damaged by others; the plot is told, and the rest goes on.
        return PlotRow(**known | {"state": State.failed, "message": str(error)}), PlotTrees()
    known |= {"report": f"{PLOTS_FOLDER}/{plot.name}/{REPORT_FILE}"}
    return PlotRow(**known | _figures(found)), trees


def _figures(plot: Mapping[str, Any]) -> dict[str, Any]:
    """What ``plot.json`` tells, whatever shape it has."""
    border, stand = _mapping(plot.get("plot_border")), _mapping(plot.get("stand"))
    texts = _warnings(plot)
    figures: dict[str, Any] = {
        "trees": _whole(plot.get("trees")),
        "trees_with_dbh": _whole(plot.get("trees_with_dbh")),
        "trees_on_area": _whole(border.get("stems") if border else stand.get("stems_on_area")),
        "per_hectare_of": _text(plot.get("per_hectare_of")),
        "has_border": bool(border),
        "photos": _whole(plot.get("photos")),
        "registered": _whole(plot.get("registered")),
        "units": _text(plot.get("units")),
        "scale_source": _text(plot.get("scale_source")),
        "warnings": len(texts),
        "warning_text": "; ".join(texts),
        "quadratic_mean_dbh_cm": _number((border or stand).get("quadratic_mean_dbh_cm")),
        "mean_dbh_cm": _number((border or stand).get("mean_dbh_cm")),
        "area_m2": _number(border.get("area_m2") if border else plot.get("plot_area_m2")),
    }
    if not border:
        return figures | {
            "stems_per_ha": _number(stand.get("stems_per_ha")),
            "basal_area_m2_per_ha": _number(stand.get("basal_area_m2_per_ha")),
        }
    stems, basal = _mapping(border.get("stems_per_ha")), _mapping(border.get("basal_area_m2_per_ha"))
    basal_area = _number(basal.get("value"))
    if basal_area is None and border.get("stems") == 0 and stems:
        basal_area = 0.0  # an empty plot is one of the sample; its figure has no interval
    return figures | {
        "stems_per_ha": _number(stems.get("value")),
        "stems_per_ha_lo95": _number(stems.get("lo95")),
        "stems_per_ha_hi95": _number(stems.get("hi95")),
        "basal_area_m2_per_ha": basal_area,
        "basal_area_lo95_m2_per_ha": _number(basal.get("lo95")),
        "basal_area_hi95_m2_per_ha": _number(basal.get("hi95")),
    }


def _trees(name: str, path: Path) -> PlotTrees:
    table = read_table(path, what="the table of trees", required=("tree_id",), way_out="run the plot again")
    return PlotTrees(
        # As text, so that digits are those of the plot's own table.
        text=tuple((name, *(row.text(column) for column in COLUMNS)) for row in table.rows),
        values=tuple((name, *table_row(tree)) for tree in read_trees(path)),
    )


def _warnings(plot: Mapping[str, Any]) -> list[str]:
    """What asks for something: remarks do not, and a plot that has no others has nothing to look out for."""
    coded, warnings = plot.get("warning_codes"), plot.get("warnings")
    if isinstance(coded, list):
        said = (one for one in coded if isinstance(one, dict) and one.get("remark") is not True)
        return [str(one["text"]) for one in said if one.get("text")]
    return [str(text) for text in warnings] if isinstance(warnings, list) else []


def _rounded(name: str, value: Any) -> Cell:
    if isinstance(value, State):
        return value.value
    if isinstance(value, float):
        return round(value, next((digits for ending, digits in _DIGITS if name.endswith(ending)), 2))
    return value  # type: ignore[no-any-return]


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, dict) else {}


def _text(value: Any) -> str:
    return value if isinstance(value, str) else ""


def _number(value: Any) -> float | None:
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return float(value) if is_number and value - value == 0 else None


def _whole(value: Any) -> int | None:
    number = _number(value)
    return None if number is None else int(number)
