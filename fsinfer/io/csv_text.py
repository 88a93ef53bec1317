"""Tables as CSV: one reader for what people and spreadsheets write, one writer that spreadsheets cannot misread.

Read are UTF-8 with or without a byte order mark, commas, or semicolons with decimal commas as spreadsheets of many
countries write them. Written are UTF-8, commas, points and bare line feeds (RFC 4180 but for those).
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from fsinfer.errors import InputError
from fsinfer.io.files import atomic_path

Cell = str | int | float | bool | None

#: A text that begins so is run as a formula by spreadsheets. Source: OWASP, "CSV Injection".
FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r", "\n")
# Put before such a text; reading takes it away again.
_GUARD = "'"
_DECIMAL_COMMA = re.compile(r"[+-]?(?:\d+,\d*|,\d+)(?:[eE][+-]?\d+)?")
#: The line by which Excel names what parts the cells. Source: format; Excel.
_SEPARATOR_LINE = re.compile(r"\"?sep=[,;\t]\"?", re.IGNORECASE)


@dataclass(frozen=True, kw_only=True)
class CsvRow:
    """A row of a table by its columns.

    Attributes
    ----------
    path: of the file.
    row: as a spreadsheet counts: the header of a file is row 1, and empty rows count.
    cells: text by the name of the column (lower case), exactly as it stands there.
    decimal_commas: whether numbers are written so.
    """

    path: Path
    row: int
    cells: Mapping[str, str]
    decimal_commas: bool = False

    @property
    def place(self) -> str:
        """File and row, for messages."""
        return f"{self.path}, row {self.row}"

    def text(self, column: str) -> str:
        """The text of a cell without blanks around it; empty where the cell or the column is missing."""
        return self.cells.get(column, "").strip()

    def value(self, column: str) -> float | None:
        """The number in a cell, which may be infinite: None where it is empty, NaN where it holds something else."""
        text = self.text(column)
        if not text:
            return None
        try:
            return float(_with_point(text) if self.decimal_commas else text)
        except ValueError:
            return math.nan

    def number(self, column: str) -> float | None:
        """The finite number in a cell, None where it is empty.

        Raises :class:`~fsinfer.errors.InputError` naming row and column where it holds something else.
        """
        value = self.value(column)
        if value is not None and not math.isfinite(value):
            msg = f"{self.place}, column {column}: {self.text(column)!r} is not a number; correct the cell"
            raise InputError(msg)
        return value

    def given(self, column: str) -> float:
        """The finite number in a cell; :class:`~fsinfer.errors.InputError` where it is empty, too."""
        value = self.number(column)
        if value is None:
            msg = f"{self.place}, column {column}: the cell is empty; give a number"
            raise InputError(msg)
        return value

    def whole(self, column: str) -> int:
        """The whole number in a cell; :class:`~fsinfer.errors.InputError` where there is none."""
        value = self.given(column)
        if value != int(value):
            msg = f"{self.place}, column {column}: {self.text(column)!r} is no whole number; correct the cell"
            raise InputError(msg)
        return int(value)


@dataclass(frozen=True, kw_only=True)
class CsvTable:
    """The rows of a file that hold anything, and the names of its columns (lower case) in their order."""

    path: Path
    columns: tuple[str, ...]
    rows: tuple[CsvRow, ...]


def read_table(path: Path | str, *, what: str, required: Sequence[str], way_out: str) -> CsvTable:
    """Read a CSV with a header; columns in any order and case, further ones allowed.

    Parameters
    ----------
    what: the table in words, for messages: "the edits".
    required: columns that must be there.
    way_out: what to do about a file that does not fit, for messages.

    Raises
    ------
    InputError
        The file cannot be read, is no UTF-8 text, has no such column or one twice, or a row with something beyond the
        last one.
    """
    path = Path(path)
    try:
        columns, rows, semicolons = _parse(path)
    except FileNotFoundError as error:
        msg = f"cannot read {what} {path}: there is no such file; {way_out}"
        raise InputError(msg) from error
    except OSError as error:
        msg = f"cannot read {what} {path}: {error.strerror or error}; {way_out}"
        raise InputError(msg) from error
    except UnicodeDecodeError as error:
        msg = f"cannot read {what} {path}: it is no text in UTF-8 (byte {error.start}); save it as 'CSV UTF-8'"
        raise InputError(msg) from error
    except csv.Error as error:
        msg = f"cannot read {what} {path}: it is no CSV ({error}); {way_out}"
        raise InputError(msg) from error
    names = tuple(name.lower() for name in columns)
    missing = [name for name in required if name not in names]
    if missing:
        msg = f"{path} has no column {', '.join(missing)}; {way_out}"
        raise InputError(msg)
    twice = [name for name in required if names.count(name) > 1]
    if twice:
        msg = f"{path} has more than one column {', '.join(twice)}; keep the one that is meant"
        raise InputError(msg)
    # A spreadsheet leaves columns without a name and without content beside a table.
    own = max((place for place, name in enumerate(names, start=1) if name), default=0)
    names = names[:own]
    for number, cells in rows:
        if any(cell.strip() for place, cell in enumerate(cells) if place >= own or not names[place]):
            commas = "" if semicolons else "; with decimal commas (12,62) part the cells by semicolons"
            msg = f"{path}, row {number}: it has {len(cells)} cells, and the file {len(names)} columns{commas}"
            raise InputError(msg)
    return CsvTable(
        path=path,
        columns=names,
        rows=tuple(
            CsvRow(path=path, row=number, cells=dict(zip(names, cells, strict=False)), decimal_commas=semicolons)
            for number, cells in rows
        ),
    )


def read_rows(path: Path | str) -> list[dict[str, str]]:
    """Rows of a CSV as text by the names of its columns as they stand there; nothing is asked of them.

    Missing cells are empty, those without a column are left out; a decimal comma becomes a point.

    Raises
    ------
    OSError, ValueError, csv.Error
        The file is missing (FileNotFoundError), no UTF-8 text (UnicodeDecodeError), or no CSV.
    """
    columns, rows, semicolons = _parse(Path(path))
    return [dict(zip(columns, map(_with_point, cells) if semicolons else cells, strict=False)) for _, cells in rows]


def write_table(path: Path | str, columns: Sequence[str], rows: Iterable[Sequence[Cell]]) -> None:
    """Write a CSV, atomically; see :func:`table_text`."""
    text = table_text(columns, rows)
    with atomic_path(Path(path)) as temporary:
        temporary.write_bytes(text.encode("utf-8"))


def table_text(columns: Sequence[str], rows: Iterable[Sequence[Cell]]) -> str:
    """A CSV with a header line. None becomes an empty cell, a bool 0 or 1, numbers and text stand as ``str`` has them.

    A text that a spreadsheet would run as a formula gets an apostrophe in front, which the readers here take away.
    """
    stream = io.StringIO(newline="")
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(columns)
    for row in rows:
        writer.writerow([_written(cell) for cell in row])
    return stream.getvalue()


def _written(cell: Cell) -> str:
    if cell is None:
        return ""
    if isinstance(cell, bool):
        return str(int(cell))
    text = str(cell)
    return _GUARD + text if _needs_guard(text) else text


def _needs_guard(text: str) -> bool:
    # A guard that the text has of itself is guarded too, so that reading gives back exactly what was written.
    return text.lstrip(_GUARD).startswith(FORMULA_STARTS) and not _is_number(text)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _parse(path: Path) -> tuple[list[str], list[tuple[int, list[str]]], bool]:
    """Names of the columns, number and cells of each row that holds any (no fewer than names), whether commas are free.

    Cells are parted by what the first line has most of; Excel's line ``sep=;`` before it is no part of the table.
    """
    text = path.read_text(encoding="utf-8-sig")
    lines = [line for line in text.splitlines() if line.strip()]
    named = bool(lines) and _SEPARATOR_LINE.fullmatch(lines[0].strip("\r\n")) is not None
    first = next(iter(lines[1:] if named else lines), "")
    delimiter = max((",", ";", "\t"), key=first.count)
    # Lines are not split beforehand: a quoted cell may hold line ends.
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, skipinitialspace=f"{delimiter} " in first)
    columns: list[str] | None = None
    rows: list[tuple[int, list[str]]] = []
    for number, record in enumerate(reader, start=1):
        if not any(cell.strip() for cell in record):
            continue
        if named:
            named = False
            continue
        if columns is None:
            columns = [name.strip() for name in record]
            continue
        cells = record + [""] * (len(columns) - len(record))
        rows.append((number, [_without_guard(cell) for cell in cells]))
    # In numbers of other tables a comma is the decimal one.
    return columns or [], rows, delimiter != ","


def _without_guard(cell: str) -> str:
    return cell[1:] if cell.startswith(_GUARD) and _needs_guard(cell[1:]) else cell


def _with_point(cell: str) -> str:
    return cell.replace(",", ".") if _DECIMAL_COMMA.fullmatch(cell.strip()) else cell
