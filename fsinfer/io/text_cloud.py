"""Point clouds as plain text: rows of numbers, as scanners, spreadsheets and viewers of many countries write them."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import CloudError

#: Columns of a file without a header that hold a colour after x y z; nine have a normal after that. Source: format; the
#: exports of CloudCompare and MeshLab.
_COLUMNS_WITH_COLOUR = (6, 9)

#: What surveyors call x, y and z; in a table that has these names instead. Source: format.
_SURVEYED = {
    "easting": "x",
    "northing": "y",
    "elevation": "z",
    "height": "z",
    "altitude": "z",
    "e": "x",
    "n": "y",
    "h": "z",
}
#: A first column without a name that counts the rows, from 0 or 1, in a file of so many points. Source: judgement.
_LEAST_COUNTED = 10

#: Units behind the names of a header.
_UNITS = re.compile(r"\([^)]*\)|\[[^\]]*\]")
_SEPARATORS = re.compile(r"[\s,;]+")
_QUOTED = re.compile(r'"([^"\n]*)"')
# Begin a line that is no row.
_COMMENTS = ("#", "//")
# Something other than commas stands between columns.
_OTHER_SEPARATOR = re.compile(r"[^\s,][ \t]*;|[^\s,][ \t]+[^\s,]")
# A comma that is no decimal point: beside something that is no digit, or the second one of a number.
_NOT_DECIMAL = re.compile(r"(?<!\d),|,(?!\d)|,[^\s;,]*,")
# Stands for a comma inside of quotes, which separates nothing; of no language.
_KEPT_COMMA = "\ue000"


def read_text_cloud(path: Path) -> dict[str, NDArray[Any]]:
    """Read rows of x y z [red green blue] as (N,) float64 columns by name, with or without a header.

    A header may call them easting, northing and elevation, have units in brackets, and stand in the comment before the
    first row. Without one a first column that numbers the points is left out. Blanks, tabs, semicolons or commas stand
    between columns. Where it is one of the first three, a comma in a number is its decimal point. Numbers may be
    quoted. UTF-8, with or without a byte order mark.

    Raises
    ------
    CloudError
        The file is no table of three columns or more, or its commas may be either.
    """
    try:
        text = path.read_text(encoding="utf-8-sig", errors="replace")
        lines = [line for line in text.splitlines() if line.strip()]
        rows = [line for line in lines if not line.lstrip().startswith(_COMMENTS)]
        before = lines[: lines.index(rows[0])] if rows else []
        names: list[str] = []
        first = _words(rows[0]) if rows else []
        # A header has letters in its first column; a .pts file begins with the bare count of points.
        if rows and first[0].isidentifier() and first[0].lower() not in ("nan", "inf"):
            names = _by_axes([word.lower() for word in first])
            rows.pop(0)
        elif len(rows) > 1 and len(first) == 1:
            rows.pop(0)
        rows = _with_points_and_blanks(path, rows)
        values = np.loadtxt(rows, dtype=np.float64, ndmin=2) if rows else np.empty((0, 3))
    except (OSError, ValueError) as error:
        msg = f"{path} is not a table of x y z ({error}); export the cloud as PLY, LAS or LAZ"
        raise CloudError(msg) from error
    if values.shape[1] < 3:
        msg = f"{path} has {values.shape[1]} columns, but needs x y z; export the cloud as PLY, LAS or LAZ"
        raise CloudError(msg)
    names = names or _header_in_comment(before, values.shape[1])
    if not names and _is_counted(values):
        values = values[:, 1:]
    if not names:
        names = ["x", "y", "z", *(("red", "green", "blue") if values.shape[1] in _COLUMNS_WITH_COLOUR else ())]
        names += [f"column_{i + 1}" for i in range(len(names), values.shape[1])]
    if len(names) != values.shape[1] or len(set(names)) != len(names):
        msg = f"{path}: its header names {len(names)} columns, its rows have {values.shape[1]}; export it again"
        raise CloudError(msg)
    return {name: values[:, i] for i, name in enumerate(names)}


def _words(line: str) -> list[str]:
    """What stands in a line, without units."""
    return _SEPARATORS.split(_UNITS.sub("", line.replace('"', "")).strip(" \t,;"))


def _header_in_comment(before: list[str], columns: int) -> list[str]:
    """The names of so many columns, where the comment ``before`` the first row has x, y and z elsewhere than first."""
    if not before:
        return []
    names = _by_axes([word.lower() for word in _words(before[-1].lstrip(" \t#/"))])
    named = len(names) == columns and all(names.count(axis) == 1 for axis in "xyz")
    return names if named and names[:3] != ["x", "y", "z"] else []


def _by_axes(names: list[str]) -> list[str]:
    """The names of a header, with x, y and z for what a surveyor calls otherwise; each once."""
    axes = [_SURVEYED.get(name, name) for name in names]
    known = bool({"x", "y"} & set(names))
    clear = {"x", "y", "z"} <= set(axes) and all(axes.count(axis) == 1 for axis in "xyz")
    return axes if clear and not known else names


def _is_counted(values: NDArray[np.float64]) -> bool:
    """Whether the first of four columns and more (N, C) numbers the points."""
    counted = len(values) >= _LEAST_COUNTED and values.shape[1] >= 4 and values[0, 0] in (0.0, 1.0)
    return bool(counted and (np.diff(values[:, 0]) == 1.0).all())


def _with_points_and_blanks(path: Path, rows: list[str]) -> list[str]:
    """The rows with decimal points, and blanks between columns."""
    text = "\n".join(row.partition("#")[0].strip(" \t,;") for row in rows)
    if '"' in text:
        text = _QUOTED.sub(lambda found: found[1].strip().replace(",", _KEPT_COMMA), text)
    # Rows of commas alone, by far the most common, need not be searched.
    other = "," in text and any(one in text.replace(", ", ",") for one in " \t;")
    decimal = other and _OTHER_SEPARATOR.search(text) is not None
    kept = _KEPT_COMMA in text
    if decimal or kept:
        numbers = text.replace(_KEPT_COMMA, ",") if decimal else text.replace(",", " ").replace(_KEPT_COMMA, ",")
        # A point in one number and a comma in another, or more commas than one: thousands, or columns after all.
        few = len(numbers.split("\n", 1)[0].replace(";", " ").split()) < 3
        if few or "." in numbers or _NOT_DECIMAL.search(numbers):
            msg = (
                f"{path}: a comma may stand between columns or be a decimal point, as in {rows[0].strip()!r}; export "
                "the cloud with decimal points, or as PLY, LAS or LAZ"
            )
            raise CloudError(msg)
        text = numbers.replace(",", ".")
    return text.replace(",", " ").replace(";", " ").splitlines()
