"""PLOTS.csv: one plot a row, with the options of ``fsinfer run`` that differ from plot to plot."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum, StrEnum
from pathlib import Path

from fsinfer.conventions.breast_height import BhRule
from fsinfer.errors import FsinferError, InputError
from fsinfer.frames.settings import Equalize
from fsinfer.io.csv_text import CsvRow, read_table
from fsinfer.plot_border.request import BorderRequest, parse_center
from fsinfer.scale.request import ScaleRequest, parse_point

_WAY_OUT = "give a CSV with the columns name and photos, a plot a row"
#: Longest name of a plot, characters: with the names of files in it a path stays below what Windows takes.
#: Source: format.
LONGEST_NAME = 80
# What no file name may hold on Windows, where results are looked at in the end, beside control characters.
_FORBIDDEN = re.compile(r'[<>:"/\\|?*\x00-\x1f\x7f]')
_RESERVED = re.compile(r"(con|prn|aux|nul|com[0-9]|lpt[0-9])(\..*)?", flags=re.IGNORECASE)
_YES, _NO = frozenset({"1", "yes", "true", "y"}), frozenset({"0", "no", "false", "n"})
#: Largest latitude and longitude, degrees. Source: format; their definition.
MOST_LATITUDE_DEG, MOST_LONGITUDE_DEG = 90.0, 180.0


class _Kind(Enum):
    number, whole, text, yes_or_no, file, points = range(6)


#: Columns that are options of ``fsinfer run``; its other options say how the computer is used, for all plots alike.
OPTIONS: dict[str, tuple[str, _Kind | type[StrEnum]]] = {
    "scale": ("--scale", _Kind.number),
    "aruco_length_m": ("--aruco-length-m", _Kind.number),
    "aruco_dictionary": ("--aruco-dictionary", _Kind.text),
    "endpoints": ("--endpoints", _Kind.points),
    "length_m": ("--length-m", _Kind.number),
    "interval_s": ("--interval-s", _Kind.number),
    "equalize": ("--equalize", Equalize),
    "views": ("--views", _Kind.whole),
    "max_size": ("--max-size", _Kind.whole),
    "bh": ("--bh", _Kind.number),
    "bh_rule": ("--bh-rule", BhRule),
    "plot_radius_m": ("--plot-radius-m", _Kind.number),
    "plot_center": ("--plot-center", _Kind.text),
    "plot_polygon": ("--plot-polygon", _Kind.file),
    "edits": ("--edits", _Kind.file),
    "far_stems": ("--far-stems", _Kind.yes_or_no),
}
REQUIRED = ("name", "photos")
PLACE = ("latitude_deg", "longitude_deg")
#: What the plot is a sample of.
STRATUM, STRATUM_HA = "stratum", "stratum_ha"


@dataclass(frozen=True, kw_only=True)
class Plot:
    """A row of the table.

    Attributes
    ----------
    name: of the plot and of its folder.
    photos: folder of photographs, or a video.
    options: of ``fsinfer run``, as written on a command line.
    files: files that options name, by the option; they stand in ``options`` only when the plot is run.
    place_deg: latitude and longitude in WGS84 from the table; None where it says nothing.
    stratum: part of the forest that it lies in, written as in the first row that names it; empty for none.
    stratum_ha: its area, hectares, from whichever row says it; None where none does.
    row: file and row of the table, for messages.
    """

    name: str
    photos: Path
    options: tuple[str, ...] = ()
    files: tuple[tuple[str, Path], ...] = ()
    place_deg: tuple[float, float] | None = None
    stratum: str = ""
    stratum_ha: float | None = None
    row: str = field(default="", compare=False)


def read_plots(path: Path) -> tuple[Plot, ...]:
    """Read PLOTS.csv; relative paths in it are seen from its own folder.

    Raises
    ------
    InputError
        It cannot be read, has a column that is none of ours, no row, a name twice, two areas of one stratum, or a cell
        that does not fit; the message names row and column.
    """
    table = read_table(path, what="the table of plots", required=REQUIRED, way_out=_WAY_OUT)
    known = (*REQUIRED, *PLACE, STRATUM, STRATUM_HA, *OPTIONS)
    unknown = [name for name in table.columns if name and name not in known]
    if unknown:
        told = ", ".join(repr(name) for name in unknown)
        msg = f"{path} has columns that fsinfer does not know: {told}; known are {', '.join(known)}"
        raise InputError(msg)
    twice = sorted({name for name in table.columns if name and table.columns.count(name) > 1})
    if twice:
        msg = f"{path} has the column {', '.join(twice)} twice; take one of them out"
        raise InputError(msg)
    if not table.rows:
        msg = f"{path} holds no plot; {_WAY_OUT}"
        raise InputError(msg)
    folder = path.absolute().parent
    plots: list[Plot] = []
    rows: dict[str, int] = {}
    strata = _strata(table.rows)
    for row in table.rows:
        plot = _plot(row, folder, strata)
        # Windows and macOS hold names for the same that differ in capitals or in how an umlaut is put together.
        key = _alike(plot.name)
        if key in rows:
            msg = f"{row.place}: the name {plot.name!r} stands in row {rows[key]} already; a plot needs one of its own"
            raise InputError(msg)
        rows[key] = row.row
        plots.append(plot)
    return tuple(plots)


def same_photos(plots: Sequence[Plot]) -> tuple[tuple[str, ...], ...]:
    """Names of plots that are measured in the same folder of photographs, or the same video, each such group."""
    groups: dict[Path, list[str]] = {}
    for plot in plots:
        groups.setdefault(plot.photos.resolve(), []).append(plot.name)
    return tuple(tuple(names) for names in groups.values() if len(names) > 1)


def _alike(name: str) -> str:
    """The same for names that differ in capitals, or in how an umlaut is put together."""
    return unicodedata.normalize("NFC", name).casefold()


def _strata(rows: Sequence[CsvRow]) -> dict[str, tuple[str, float | None]]:
    """Name and area in hectares of each stratum, by its name as :func:`_alike` has it."""
    names: dict[str, str] = {}
    areas: dict[str, tuple[float, int]] = {}
    for row in rows:
        name, area_ha = row.text(STRATUM), row.number(STRATUM_HA)
        key = _alike(name)
        names.setdefault(key, name)
        if area_ha is None:
            continue
        if not name:
            msg = f"{row.place}, column {STRATUM_HA}: it is the area of a stratum, which column {STRATUM} does not name"
            raise InputError(msg)
        if area_ha <= 0:
            msg = f"{row.place}, column {STRATUM_HA}: {area_ha:g} is no area; give the hectares of stratum {name!r}"
            raise InputError(msg)
        said_ha, said_in = areas.setdefault(key, (area_ha, row.row))
        if said_ha != area_ha:
            msg = (
                f"{row.place}, column {STRATUM_HA}: stratum {name!r} has {area_ha:g} ha here and {said_ha:g} ha in row "
                f"{said_in}; a stratum has one area, that of all of it"
            )
            raise InputError(msg)
    return {key: (name, areas[key][0] if key in areas else None) for key, name in names.items()}


def _plot(row: CsvRow, folder: Path, strata: Mapping[str, tuple[str, float | None]]) -> Plot:
    name, photos = row.text("name"), row.text("photos")
    fault = _fault_of_name(name)
    if fault:
        msg = f"{row.place}, column name: {name!r} {fault}; the plot's folder is called so"
        raise InputError(msg)
    if not photos:
        msg = f"{row.place}, column photos: the cell is empty; give the folder of photos, or the video"
        raise InputError(msg)
    options: list[str] = []
    files: list[tuple[str, Path]] = []
    for column, (flag, kind) in OPTIONS.items():
        if not row.text(column):
            continue
        if kind is _Kind.file:
            files.append((flag, _path(row, column, folder)))
        else:
            options += _written(row, column, flag, kind)
    _check_together(row)
    stratum, stratum_ha = strata[_alike(row.text(STRATUM))]
    return Plot(
        name=name,
        photos=_path(row, "photos", folder),
        options=tuple(options),
        files=tuple(files),
        place_deg=_place(row),
        stratum=stratum,
        stratum_ha=stratum_ha,
        row=row.place,
    )


def _fault_of_name(name: str) -> str:
    """Why this cannot be the name of a folder everywhere; empty where it can."""
    if not name:
        return "is empty"
    if len(name) > LONGEST_NAME:
        return f"has more than {LONGEST_NAME} characters"
    if _FORBIDDEN.search(name):
        return 'holds one of < > : " / \\ | ? * or a control character'
    if name[0] == "." or name[-1] == ".":
        return "begins or ends with a point"
    return "is a name that Windows keeps for itself" if _RESERVED.fullmatch(name) else ""


def _path(row: CsvRow, column: str, folder: Path) -> Path:
    text = row.text(column)
    if "\x00" in text:
        msg = f"{row.place}, column {column}: {text!r} is no path; correct the cell"
        raise InputError(msg)
    return folder / Path(text).expanduser()


def _written(row: CsvRow, column: str, flag: str, kind: _Kind | type[StrEnum]) -> tuple[str, ...]:
    """An option as on a command line; with "=", so that no text can become an option of its own."""
    text = row.text(column)
    if isinstance(kind, type):
        choices = [item.value for item in kind]
        if text not in choices:
            msg = f"{row.place}, column {column}: {text!r} is none of {', '.join(choices)}; correct the cell"
            raise InputError(msg)
        return (f"{flag}={text}",)
    if kind is _Kind.yes_or_no:
        if text.lower() not in _YES | _NO:
            msg = f"{row.place}, column {column}: {text!r} is neither yes nor no; correct the cell"
            raise InputError(msg)
        return (flag,) if text.lower() in _YES else ()
    if kind is _Kind.points:
        points = text.split()
        if len(points) != 2:
            msg = f"{row.place}, column {column}: {text!r} are no two points; write X1,Y1,Z1 X2,Y2,Z2 in quotes"
            raise InputError(msg)
        _told_with_place(row, lambda: [parse_point(point) for point in points])
        return (flag, *points)
    if kind is _Kind.whole:
        return (f"{flag}={row.whole(column)}",)
    return (f"{flag}={row.given(column)!r}",) if kind is _Kind.number else (f"{flag}={text}",)


def _check_together(row: CsvRow) -> None:
    """Options that contradict each other are told before hours of work on other plots."""
    points = row.text("endpoints").split()

    def check() -> None:
        ScaleRequest(
            factor=row.number("scale"),
            aruco_length_m=row.number("aruco_length_m"),
            endpoints=(parse_point(points[0]), parse_point(points[1])) if points else None,
            length_m=row.number("length_m"),
            aruco_dictionary=row.text("aruco_dictionary") or ScaleRequest.aruco_dictionary,
        )
        marker, center = parse_center(row.text("plot_center") or None)
        # The polygon's file may lie where only the workers see it.
        polygon = ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0)) if row.text("plot_polygon") else ()
        BorderRequest(radius_m=row.number("plot_radius_m"), marker=marker, center=center, polygon=polygon)

    _told_with_place(row, check)


def _told_with_place(row: CsvRow, check: Callable[[], object]) -> None:
    try:
        check()
    except FsinferError as error:
        text = str(error)
        msg = text if text.startswith(str(row.path)) else f"{row.place}: {text}"
        raise InputError(msg) from error


def _place(row: CsvRow) -> tuple[float, float] | None:
    latitude, longitude = (row.number(column) for column in PLACE)
    if latitude is None and longitude is None:
        return None
    if latitude is None or longitude is None:
        msg = f"{row.place}: latitude_deg and longitude_deg belong together; fill in both or none"
        raise InputError(msg)
    if abs(latitude) > MOST_LATITUDE_DEG or abs(longitude) > MOST_LONGITUDE_DEG:
        msg = f"{row.place}: {latitude:g}, {longitude:g} is no latitude and longitude in degrees (WGS84)"
        raise InputError(msg)
    return latitude, longitude
