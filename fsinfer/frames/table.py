"""``frames.csv``: a line for every photo and video frame that was looked at, with its scores and why it was dropped."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any


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


_DIGITS = {"time_s": 3, "sharpness": 6, "mean_luminance": 2, "dark_share": 5, "bright_share": 5}


def frames_csv(rows: Sequence[FrameRow]) -> str:
    """The text of the file."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    names = [entry.name for entry in fields(FrameRow)]
    writer.writerow(names)
    for row in rows:
        values = asdict(row)
        writer.writerow([_cell(name, values[name]) for name in names])
    return text.getvalue()


def _cell(name: str, value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(int(value))
    return f"{value:.{_DIGITS[name]}f}" if name in _DIGITS else str(value)


def read_frames_csv(path: Path) -> tuple[FrameRow, ...]:
    """Rows of a file that :func:`frames_csv` made; OSError, ValueError or KeyError where it is missing or damaged."""
    with path.open(encoding="utf-8", newline="") as stream:
        return tuple(_parse(row) for row in csv.DictReader(stream))


def _parse(row: dict[str, str]) -> FrameRow:
    numbers = {name: float(row[name]) if row[name] else None for name in _DIGITS}
    return FrameRow(name=row["name"], source=row["source"], kept=row["kept"] == "1", reason=row["reason"], **numbers)
