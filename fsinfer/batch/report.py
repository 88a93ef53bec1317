"""``report.html`` over all plots: figures, what failed, a map, the forest, the table with links to plots' reports."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from fsinfer._version import __version__
from fsinfer.batch.estimates import forest_estimates
from fsinfer.batch.estimates_part import estimates_part
from fsinfer.batch.outcome import State
from fsinfer.batch.rows import PlotRow
from fsinfer.batch.summary import count
from fsinfer.io.files import write_text
from fsinfer.notices.numbers import counted, noun
from fsinfer.report.page import Part, missing_part, render_page, render_part
from fsinfer.report.summary import TilesView

REPORT_FILE = "report.html"
_TEMPLATES = "fsinfer.batch"
#: Width and most height of the map, and room round it, in its own units. Source: layout.
MAP_WIDTH, MAP_MOST_HEIGHT, MAP_MARGIN = 900.0, 700.0, 60.0
#: Metres of a degree of latitude. Source: format; a metre was a ten-millionth of the quarter of a meridian.
M_OF_DEGREE = 10_000_000 / 90
#: Least extent of a map, metres: plots at one place would fill it with nothing. Source: layout.
LEAST_EXTENT_M = 20.0
#: More plots than this are shown without their names. Source: layout; names would cover each other.
MOST_NAMES = 60


@dataclass(frozen=True, kw_only=True)
class Dot:
    """A plot on the map: place in its units, state, link to its report (empty without one), what is said of it."""

    x: float
    y: float
    state: str
    link: str
    name: str
    said: str


@dataclass(frozen=True, kw_only=True)
class MapView:
    """Plots on a map, north up; ``bar`` is the length of the scale bar, ``bar_text`` what it stands for."""

    width: float
    height: float
    dots: tuple[Dot, ...]
    with_names: bool
    bar: float
    bar_text: str
    corners: str
    note: str


@dataclass(frozen=True, kw_only=True)
class PlotCell:
    """A shown text, what it is sorted by, whether it is a number, and where it leads."""

    text: str
    key: str
    is_number: bool = False
    link: str = ""


@dataclass(frozen=True, kw_only=True)
class PlotsView:
    """The table of all plots: its head, and for each plot its state and its cells."""

    head: tuple[str, ...]
    rows: tuple[tuple[str, tuple[PlotCell, ...]], ...]


@dataclass(frozen=True, kw_only=True)
class FailedView:
    """Plots that failed, and those whose results are outdated, and why; how many wait."""

    failed: tuple[tuple[str, str], ...]
    outdated: tuple[tuple[str, str], ...]
    waiting: int


def write_report(out: Path, rows: Sequence[PlotRow], *, title: str) -> Path:
    """Write ``OUT/report.html``: one file without any reference to the network, atomically."""
    parts = [
        render_part(_tiles(rows)),
        render_part(_failed(rows), templates=_TEMPLATES),
        render_part(_map(rows), templates=_TEMPLATES),
        render_part(estimates_part(forest_estimates(rows)), templates=_TEMPLATES),
        render_part(_table(rows), templates=_TEMPLATES),
    ]
    path = out / REPORT_FILE
    write_text(path, render_page(title, f"Plots measured from photographs with fsinfer {__version__}", parts))
    return path


def _tiles(rows: Sequence[PlotRow]) -> Part:
    counts = count(rows)
    tiles = [(f"{counts.done} of {counts.plots}", "plots done")]
    if counts.outdated:
        tiles.append((str(counts.outdated), f"{noun(counts.outdated, 'plot', 'plots')} with outdated results"))
    if counts.failed:
        tiles.append((str(counts.failed), f"{noun(counts.failed, 'plot', 'plots')} failed"))
    if counts.waiting:
        tiles.append((str(counts.waiting), f"{noun(counts.waiting, 'plot', 'plots')} not yet measured"))
    tiles += [
        (str(counts.trees), f"{noun(counts.trees, 'stem', 'stems')} found"),
        (str(counts.trees_with_dbh), "with a DBH"),
    ]
    warned = sum(1 for row in rows if row.warnings)
    if warned:
        tiles.append((str(warned), f"{noun(warned, 'plot', 'plots')} with warnings"))
    return Part(anchor="tiles", view=TilesView(tiles=tuple(tiles)))


def _failed(rows: Sequence[PlotRow]) -> Part:
    failed, outdated = (
        tuple((row.plot, row.message) for row in rows if row.state is state) for state in (State.failed, State.outdated)
    )
    waiting = sum(row.state is State.waiting for row in rows)
    view = FailedView(failed=failed, outdated=outdated, waiting=waiting)
    return Part(anchor="failed", title="Failed plots", view=view)


def _map(rows: Sequence[PlotRow]) -> Part:
    placed = [
        (row, row.latitude_deg, row.longitude_deg)
        for row in rows
        if row.latitude_deg is not None and row.longitude_deg is not None
    ]
    if not placed:
        why = (
            "No plot has a place on earth: neither do the photos carry GNSS positions, nor has the table of plots the "
            "columns latitude_deg and longitude_deg."
        )
        return missing_part("map", "Map", why)
    latitudes = [latitude for _, latitude, _ in placed]
    longitudes = _unwrapped([longitude for _, _, longitude in placed])
    middle = (min(latitudes) + max(latitudes)) / 2
    # Equirectangular about the middle: right to a few per cent over a country, which is what a plan of plots needs.
    east_m = [M_OF_DEGREE * math.cos(math.radians(middle)) * longitude for longitude in longitudes]
    north_m = [M_OF_DEGREE * latitude for latitude in latitudes]
    wide, high = (max(max(values) - min(values), LEAST_EXTENT_M) for values in (east_m, north_m))
    unit = min((MAP_WIDTH - 2 * MAP_MARGIN) / wide, (MAP_MOST_HEIGHT - 2 * MAP_MARGIN) / high)
    height = high * unit + 2 * MAP_MARGIN
    middle_east, middle_north = (min(east_m) + max(east_m)) / 2, (min(north_m) + max(north_m)) / 2
    dots = tuple(
        Dot(
            x=round(MAP_WIDTH / 2 + (east - middle_east) * unit, 1),
            y=round(height / 2 - (north - middle_north) * unit, 1),
            state=row.state.value,
            link=_link(row),
            name=row.plot,
            said=_said(row),
        )
        for (row, _, _), east, north in zip(placed, east_m, north_m, strict=True)
    )
    bar_m = _round_length(MAP_WIDTH / 4 / unit)
    without = len(rows) - len(placed)
    by_photos = sum(row.place_source == "photos" for row, _, _ in placed)
    have_none = noun(without, "has no place and is", "have no place and are")
    notes = [f"{without} of {len(rows)} plots {have_none} not on the map."] if without else []
    if by_photos:
        stand = noun(by_photos, "stands where its", "stand where their")
        notes.append(f"{by_photos} {stand} photos say, which phones know to some metres.")
    view = MapView(
        width=MAP_WIDTH,
        height=round(height, 1),
        dots=dots,
        with_names=len(dots) <= MOST_NAMES,
        bar=round(bar_m * unit, 1),
        bar_text=f"{bar_m / 1000:g} km" if bar_m >= 1000 else f"{bar_m:g} m",
        corners=f"{_from_to(latitudes, 'N', 'S')}, {_from_to(longitudes, 'E', 'W')} (WGS84)",
        note=" ".join(notes),
    )
    return Part(anchor="map", title="Map", view=view, template="plots_map")


def _from_to(degrees: Sequence[float], positive: str, negative: str) -> str:
    """The least and the greatest angle, each with its side; those beyond 180 degrees are of the other side."""
    return " to ".join(
        f"{abs(angle):.5f}° {positive if angle >= 0 else negative}"
        for angle in ((value + 180.0) % 360.0 - 180.0 for value in (min(degrees), max(degrees)))
    )


def _unwrapped(longitudes: Sequence[float]) -> list[float]:
    """Longitudes that lie on both sides of the meridian of 180 degrees, as one stretch."""
    if max(longitudes) - min(longitudes) <= 180.0:
        return list(longitudes)
    return [longitude + 360.0 if longitude < 0 else longitude for longitude in longitudes]


def _round_length(length: float) -> float:
    """The largest of 1, 2, 5, 10, 20, ... that is not above ``length``."""
    power = 10.0 ** math.floor(math.log10(length))
    return next(factor * power for factor in (5.0, 2.0, 1.0) if factor * power <= length or factor == 1.0)


def _link(row: PlotRow) -> str:
    return quote(row.report)


def _said(row: PlotRow) -> str:
    if row.state in (State.failed, State.waiting):
        return f"{row.plot}: {row.state.value}" + (f", {row.message}" if row.message else "")
    figures = [counted(row.trees, "tree", "trees")] if row.trees is not None else []
    if row.basal_area_m2_per_ha is not None:
        figures.append(f"{row.basal_area_m2_per_ha:.1f} m²/ha")
    return ": ".join([row.plot, ", ".join([*figures, *([row.message] if row.message else [])])])


def _table(rows: Sequence[PlotRow]) -> Part:
    head = (
        "Plot", "State", "Trees", "With DBH", "On the area", "Stems/ha", "Basal area (m²/ha)",
        "Quadratic mean DBH (cm)", "Area (m²)", "Photos used", "Warnings", "Minutes", "Remark",
    )  # fmt: skip
    return Part(
        anchor="plots",
        title="Plots",
        view=PlotsView(head=head, rows=tuple((row.state.value, _cells(row)) for row in rows)),
        template="plots_table",
    )


def _cells(row: PlotRow) -> tuple[PlotCell, ...]:
    used = "" if row.photos is None else f"{row.registered} of {row.photos}"
    remark = "; ".join(filter(None, (row.message, row.per_hectare_of, row.warning_text)))
    return (
        PlotCell(text=row.plot, key=row.plot, link=_link(row)),
        PlotCell(text=row.state.value, key=row.state.value),
        _number(row.trees, ".0f"),
        _number(row.trees_with_dbh, ".0f"),
        _number(row.trees_on_area, ".0f"),
        _interval(row.stems_per_ha, row.stems_per_ha_lo95, row.stems_per_ha_hi95, ".0f"),
        _interval(row.basal_area_m2_per_ha, row.basal_area_lo95_m2_per_ha, row.basal_area_hi95_m2_per_ha, ".1f"),
        _number(row.quadratic_mean_dbh_cm, ".1f"),
        _number(row.area_m2, ".0f"),
        PlotCell(text=used, key="" if row.registered is None else str(row.registered), is_number=True),
        _number(row.warnings, ".0f"),
        _number(None if row.seconds is None else row.seconds / 60.0, ".1f"),
        PlotCell(text=remark, key=remark),
    )


def _number(value: float | None, form: str) -> PlotCell:
    return PlotCell(
        text="" if value is None else f"{value:{form}}", key="" if value is None else f"{value:.6g}", is_number=True
    )


def _interval(value: float | None, low: float | None, high: float | None, form: str) -> PlotCell:
    cell = _number(value, form)
    if value is None or low is None or high is None:
        return cell
    return PlotCell(text=f"{cell.text} [{low:{form}} – {high:{form}}]", key=cell.key, is_number=True)
