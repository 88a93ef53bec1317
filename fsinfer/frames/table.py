"""``frames.csv``: a line for every photo and video frame that was looked at, with its scores and why it was dropped."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from fsinfer.io.csv_text import CsvRow, read_table, table_text


@dataclass(frozen=True, kw_only=True)
class FrameRow:
    """One line of ``frames.csv``; scores as in :class:`fsinfer.frames.quality.FrameScore`, empty if unreadable.

    Attributes
    ----------
    name: of the frame in ``images``, without suffix.
    source: file that it comes from.
    time_s: in the video, None for photos.
    kept: whether it was chosen.
    reason: why not, empty where chosen.
    """

    name: str
    source: str
    time_s: float | None
    sharpness: float | None
    mean_luminance: float | None
    dark_share: float | None
    bright_share: float | None
    kept: bool
    reason: str


#: Decimals of the columns. Source: format.
_DIGITS = {"time_s": 3, "sharpness": 6, "mean_luminance": 2, "dark_share": 5, "bright_share": 5}


def frames_csv(rows: Sequence[FrameRow]) -> str:
    """The text of the file."""
    names = [entry.name for entry in fields(FrameRow)]
    return table_text(names, ([_cell(name, value) for name, value in asdict(row).items()] for row in rows))


def _cell(name: str, value: Any) -> str | bool | None:
    return f"{value:.{_DIGITS[name]}f}" if name in _DIGITS and value is not None else value


def read_frames_csv(path: Path) -> tuple[FrameRow, ...]:
    """Rows of a file that :func:`frames_csv` made; :class:`~fsinfer.errors.InputError` where it cannot be read."""
    table = read_table(
        path,
        what="the table of frames",
        required=[entry.name for entry in fields(FrameRow)],
        way_out="run 'fsinfer frames' again",
    )
    return tuple(_parse(row) for row in table.rows)


def _parse(row: CsvRow) -> FrameRow:
    return FrameRow(
        name=row.cells["name"],
        source=row.cells["source"],
        kept=row.text("kept") == "1",
        reason=row.cells["reason"],
        **{name: row.number(name) for name in _DIGITS},
    )
