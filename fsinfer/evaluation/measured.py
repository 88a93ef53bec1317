"""Tables of trees to compare: measured ones, and those of a ``trees.csv``."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from fsinfer.errors import InputError
from fsinfer.io.csv_text import read_table

#: A measured diameter is below this, cm. Source: format; no tree is thicker, millimetres are.
_MOST_DBH_CM = 1000.0
#: A table without a thicker tree than this is not in centimetres. Source: judgement; a stem of 2 m has 2 in metres.
_LEAST_DBH_CM = 2.0
#: Columns that a ``trees.csv`` has and no caliper. Source: format; ``trees.csv``.
_OF_FSINFER = ("status", "dbh_lo95_cm")
#: How ``in_plot`` says no: a nought, or a word in small letters. Source: format; ``trees.csv``, which other programs
#: write anew with decimals, and the sheet of ``trees.xlsx`` saved as CSV, in the language of the spreadsheet.
_NOUGHT = re.compile(r"0+([.,]0*)?")
_NO = frozenset(
    [
        "false",
        "no",
        "falsch",
        "nein",
        "faux",
        "falso",
        "onwaar",
        "fałsz",
        "nepravda",
        "falsk",
        "falskt",
        "usann",
        "epätosi",
        "hamis",
        "ложь",
    ]
)


@dataclass(frozen=True, kw_only=True)
class MeasuredTree:
    """A tree from a CSV: identifier as written, position in metres (NaN when not given), DBH in cm or None.

    ``status`` is that of a ``trees.csv``, empty where the table has none; ``dbh_lo95_cm`` and ``dbh_hi95_cm`` are its
    interval; ``in_plot`` is whether it stands within the plot's border, None where that has none.
    """

    tree_id: str
    x_m: float
    y_m: float
    dbh_cm: float | None
    status: str = ""
    dbh_lo95_cm: float | None = None
    dbh_hi95_cm: float | None = None
    in_plot: bool | None = None


def read_measured(path: Path, *, need_dbh: bool = True, need_position: bool = True) -> list[MeasuredTree]:
    """Read a CSV with ``tree_id, x_m, y_m, dbh_cm`` (other columns are ignored; comma, semicolon or tab).

    Empty DBH cells become None; with ``need_dbh=False`` all may be empty, as in a ``trees.csv``. With
    ``need_position=False`` empty or missing positions become NaN, for matching by id. Raises
    :class:`~fsinfer.errors.InputError` naming row and column.
    """
    table = read_table(
        path,
        what="the trees",
        required=("tree_id", "x_m", "y_m", "dbh_cm") if need_position else ("tree_id", "dbh_cm"),
        way_out="give a CSV file whose first line is tree_id,x_m,y_m,dbh_cm",
    )
    trees: list[MeasuredTree] = []
    seen: dict[str, int] = {}
    for row in table.rows:
        tree_id = row.text("tree_id")
        if not tree_id:
            msg = f"{row.place}: the tree_id is empty; give every tree its own"
            raise InputError(msg)
        if tree_id in seen:
            msg = f"{row.place}: tree_id {tree_id} was used in row {seen[tree_id]} already; make it unique"
            raise InputError(msg)
        seen[tree_id] = row.row
        if row.text("reason") == "no scale":
            msg = f"{path} was made without a scale: its positions are no metres; give fsinfer run a scale first"
            raise InputError(msg)
        dbh = row.number("dbh_cm")
        if dbh is not None and not 0.0 < dbh < _MOST_DBH_CM:
            msg = f"{row.place}: dbh_cm is {dbh:g}; it must lie between 0 and 1000 cm (0 is not 'unmeasured')"
            raise InputError(msg)
        x, y = (row.given(name) if need_position else row.number(name) for name in ("x_m", "y_m"))
        trees.append(
            MeasuredTree(
                tree_id=tree_id,
                x_m=float("nan") if x is None else x,
                y_m=float("nan") if y is None else y,
                dbh_cm=dbh,
                status=row.text("status"),
                # Of a measured table other columns are nobody's business.
                dbh_lo95_cm=None if need_dbh else row.number("dbh_lo95_cm"),
                dbh_hi95_cm=None if need_dbh else row.number("dbh_hi95_cm"),
                in_plot=None if need_dbh or not (inside := row.text("in_plot")) else not _says_no(inside),
            )
        )
    if not need_dbh:
        return trees
    if not trees:
        msg = f"{path} holds no measured trees, only a header; give at least one tree"
        raise InputError(msg)
    known = [tree.dbh_cm for tree in trees if tree.dbh_cm is not None]
    if not known:
        msg = f"{path}: the column dbh_cm is empty; give the diameter of at least one tree"
        raise InputError(msg)
    if max(known) < _LEAST_DBH_CM:
        msg = f"{path}: no dbh_cm is above {max(known):g} cm; give centimetres, not metres"
        raise InputError(msg)
    return trees


def _says_no(inside: str) -> bool:
    return _NOUGHT.fullmatch(inside) is not None or inside.lower() in _NO


def seem_swapped(measured: Path, extracted: Path) -> bool:
    """Whether the table given as the measured one is a ``trees.csv``, and the other, given as extracted, is none.

    Raises :class:`~fsinfer.errors.InputError` as :func:`read_measured` does where a table cannot be read.
    """
    first, second = (
        set(read_table(path, what="the trees", required=("tree_id",), way_out="give a CSV file").columns)
        for path in (measured, extracted)
    )
    return first.issuperset(_OF_FSINFER) and not second.issuperset(_OF_FSINFER)
