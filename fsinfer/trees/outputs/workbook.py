"""``trees.xlsx``: all tables of the trees as one workbook."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fsinfer.errors import OutputError
from fsinfer.io.files import atomic_path
from fsinfer.trees.outputs.table import COLUMNS, table_row
from fsinfer.trees.stem_curve import COLUMNS as CURVE_COLUMNS
from fsinfer.trees.stem_curve import curve_row

if TYPE_CHECKING:
    from fsinfer.trees.measure import PlotResult
    from fsinfer.trees.stem_curve import CurvePoint

Cell = str | int | float | bool | None

#: The date in the file: the same trees give the same bytes, whenever they are written. Source: layout; any would do.
_CREATED = datetime(2000, 1, 1)
# By default a text that begins with "=" or "http:" would become a formula or a link.
_OPTIONS = {"strings_to_formulas": False, "strings_to_urls": False, "strings_to_numbers": False}
#: Digits that are shown by the ending of a name; the cells themselves hold more. Source: layout; what a calliper tells.
_SHOWN = (
    ("_cm", "0.0"),
    ("_deg", "0.0"),
    ("_per_ha", "0"),
    ("_m2", "0.0"),
    ("_m", "0.00"),
    ("_coverage", "0.00"),
)
#: Least and greatest width of a column, characters: wider ones push the next off the screen. Source: layout.
_WIDTH_CHARACTERS = (8, 60)


@dataclass(frozen=True, kw_only=True)
class Sheet:
    """A table of a workbook: rows as long as ``columns``; numbers are shown by the units of their columns' names."""

    name: str
    columns: Sequence[str]
    rows: Iterable[Sequence[Cell]]


def write_workbook(path: Path, sheets: Sequence[Sheet], *, title: str) -> None:
    """Write tables of any length as the sheets of one XLSX workbook, atomically; see :func:`write_tables` for cells.

    Raises
    ------
    OutputError
        It cannot be written, or the system's folder for temporary files has no room for its rows.
    """
    import xlsxwriter
    from xlsxwriter.exceptions import FileCreateError

    body = io.BytesIO()
    try:
        # Rows go to the disk as they come, so that a hundred thousand trees take no memory.
        with xlsxwriter.Workbook(body, _OPTIONS | {"constant_memory": True}) as book:
            book.set_properties({"title": title, "comments": "written by fsinfer", "created": _CREATED})
            for sheet in sheets:
                _write_sheet(book, sheet.name, sheet.columns, sheet.rows, _format_of_column)
    except (OSError, FileCreateError) as error:
        # The workbook itself is in memory yet: only its rows, as temporary files, were written.
        msg = (
            f"cannot write temporary files of {path.name}: {error}; free some space where the system keeps them, or "
            "set TMPDIR (on Windows TEMP) to another folder, and run the same command again"
        )
        raise OutputError(msg) from error
    with atomic_path(path) as temporary:
        temporary.write_bytes(body.getvalue())


def write_tables(
    path: Path,
    result: PlotResult,
    curves: dict[int, tuple[CurvePoint, ...]],
    *,
    plot: Sequence[tuple[str, Cell]] = (),
) -> None:
    """Write the trees, the stand table and the stem curves as sheets of one XLSX workbook, atomically.

    ``plot`` are names and figures of a plot with a border, a sheet of their own where there are any.

    Values are those of the CSV files, numbers as numbers; what was not measured is an empty cell. Texts stay texts,
    whatever they begin with.
    """
    import xlsxwriter

    body = io.BytesIO()
    with xlsxwriter.Workbook(body, _OPTIONS | {"in_memory": True}) as book:
        book.set_properties({"title": "Trees of a plot", "comments": "written by fsinfer", "created": _CREATED})
        _write_sheet(book, "trees", COLUMNS, map(table_row, result.all_trees), _format_of_column)
        stand = asdict(result.stand)
        stand["off_area"] = ", ".join(map(str, stand["off_area"]))
        # Only their heads tell the two apart: both have stems a hectare.
        of_stand, of_plot = ("of the seen ground", "of the plot within its border") if plot else ("value", "")
        _write_sheet(book, "stand", ("figure", of_stand), stand.items(), lambda _, row: _number_format(str(row[0])))
        if plot:
            _write_sheet(book, "plot", ("figure", of_plot), plot, lambda _, row: _number_format(str(row[0])))
        points = (curve_row(point) for curve in curves.values() for point in curve)
        _write_sheet(book, "stem curve", CURVE_COLUMNS, points, _format_of_column)
    with atomic_path(path) as temporary:
        temporary.write_bytes(body.getvalue())


def _write_sheet(
    book: Any,
    name: str,
    header: Sequence[str],
    rows: Iterable[Sequence[Cell]],
    number_format: Callable[[str, Sequence[Cell]], str],
) -> None:
    """Write one sheet; ``number_format`` gives that of a cell from its column's name and its row."""
    sheet = book.add_worksheet(name)
    sheet.write_row(0, 0, header, book.add_format({"bold": True}))
    # The names stay in view while the table is scrolled.
    sheet.freeze_panes(1, 0)
    formats: dict[str, Any] = {}
    widths = [len(column) for column in header]
    for number, row in enumerate(rows, start=1):
        for index, (column, value) in enumerate(zip(header, row, strict=True)):
            shown = number_format(column, row)
            if isinstance(value, str):
                if value:
                    sheet.write_string(number, index, value)
            elif isinstance(value, bool):
                sheet.write_boolean(number, index, value)
            elif value is not None and math.isfinite(value):
                if shown not in formats:
                    formats[shown] = book.add_format({"num_format": shown})
                sheet.write_number(number, index, value, formats[shown])
            widths[index] = max(widths[index], _width(value, shown))
    for index, width in enumerate(widths):
        # A character more than the longest: bold letters are wider.
        sheet.set_column(index, index, min(max(width + 1, _WIDTH_CHARACTERS[0]), _WIDTH_CHARACTERS[1]))


def _format_of_column(column: str, _: Sequence[Cell]) -> str:
    return _number_format(column)


def _number_format(name: str) -> str:
    """Number format of what has this name: by the unit that it ends with, "General" for counts and shares."""
    if name.endswith("_per_ha") and "_m2_" in name:
        return "0.0"
    return next((shown for ending, shown in _SHOWN if name.endswith(ending)), "General")


def _width(value: Cell, shown: str) -> int:
    """Characters that a cell takes when shown."""
    if isinstance(value, float) and math.isfinite(value) and shown != "General":
        return len(f"{value:.{len(shown.partition('.')[2])}f}")
    return 0 if value is None else len(str(value))
