"""The table of all trees; a column's head sorts, a tree's number shows its card."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from fsinfer.report.contents import Contents, number, tree_number
from fsinfer.report.page import Part, missing_part
from fsinfer.report.plot_border import is_in
from fsinfer.report.stems.row import STATUS_WORDS, interval_of, interval_text, remark_of, status_of

_ANCHOR, _TITLE = "trees", "Tree table"


@dataclass(frozen=True, kw_only=True)
class Cell:
    """A shown text and what it is sorted by; an empty key sorts last. ``is_number`` sets it to the right."""

    text: str
    key: str
    is_number: bool = False


@dataclass(frozen=True, kw_only=True)
class Row:
    """A tree: its number, None where it is not known, its status, and its cells, of which the first is the number."""

    tree_id: int | None
    status: str
    cells: tuple[Cell, ...]


@dataclass(frozen=True, kw_only=True)
class TableView:
    """The table; without rows, why there are none. ``has_dbh``: a tree has one, and the table the column."""

    head: tuple[str, ...]
    rows: tuple[Row, ...]
    diagnosis: str = ""
    has_dbh: bool = False


@dataclass(frozen=True, kw_only=True)
class _Column:
    head: str
    name: str
    form: str


def table_part(contents: Contents) -> Part:
    """The trees of the plot, a row each."""
    trees = contents.trees
    if trees is None:
        return missing_part(_ANCHOR, _TITLE, f"{contents.why_missing('trees.csv')}.")
    if not trees:
        why = str(contents.plot.get("diagnosis") or "The table of trees is empty.")
        return Part(anchor=_ANCHOR, title=_TITLE, view=TableView(head=(), rows=(), diagnosis=why))
    columns = _columns("m" if contents.metric else "units")
    # A column without a single value only takes room.
    columns = [c for c in columns if c.name == "status" or any(_cell(c, tree).key for tree in trees)]
    rows = tuple(
        Row(
            tree_id=tree_number(tree),
            status=status_of(tree),
            cells=(*(_cell(column, tree) for column in columns), Cell(text=remark_of(tree), key=remark_of(tree))),
        )
        for tree in trees
    )
    has_dbh = any(column.name == "dbh_cm" for column in columns)
    view = TableView(head=(*(column.head for column in columns), "Remark"), rows=rows, has_dbh=has_dbh)
    return Part(anchor=_ANCHOR, title=_TITLE, view=view)


def _columns(unit: str) -> list[_Column]:
    """In the order of the page; those without a format are no numbers of ``trees.csv``."""
    named = (
        ("Tree", "tree_id", "{:.0f}"),
        ("DBH (cm)", "dbh_cm", "{:.1f}"),
        ("95 % interval (cm)", "interval", ""),
        ("Status", "status", ""),
        ("Seen all round (%)", "arc_coverage", "{:.0%}"),
        ("DBH by tape (cm)", "dbh_perimeter_cm", "{:.1f}"),
        ("Unevenness (cm)", "residual_cm", "{:.2f}"),
        ("Points", "points", "{:.0f}"),
        ("Lean (°)", "lean_deg", "{:.1f}"),
        ("Height (m)", "height_m", "{:.1f}"),
        (f"x ({unit})", "x_m", "{:.2f}"),
        (f"y ({unit})", "y_m", "{:.2f}"),
        ("In the plot", "in_plot", "{:.0f}"),
        ("To its border (m)", "border_m", "{:+.2f}"),
    )
    return [_Column(head=head, name=name, form=form) for head, name, form in named]


def _cell(column: _Column, tree: Mapping[str, str]) -> Cell:
    if column.name == "status":
        status = tree.get("status", "")
        return Cell(text=STATUS_WORDS.get(status, status), key=status)
    if column.name == "interval":
        interval_cm = interval_of(tree)
        if interval_cm is None:
            return Cell(text="", key="")
        # Sorted by its width: the surest tree first.
        return Cell(text=interval_text(interval_cm), key=repr(interval_cm[1] - interval_cm[0]), is_number=True)
    value = number(tree.get(column.name))
    if value is None:
        return Cell(text="", key="")
    if column.name == "in_plot":
        return Cell(text="yes" if is_in(tree) else "no", key=repr(value))
    return Cell(text=column.form.format(value), key=repr(value), is_number=column.name != "tree_id")
