"""Marker boards to print: a PDF at true size, one board a page, with a bar to check the print by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from fsinfer.errors import InputError
from fsinfer.io.files import atomic_path
from fsinfer.scale.detection import predefined_dictionary
from fsinfer.scale.printed_boards import (
    BOARDS,
    DICTIONARY,
    SAME_LENGTH_M,
    SAME_MARKERS,
    Paper,
    board_lengths,
    numbers_of_length,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Width and height upright, millimetres. Source: format; ISO 216 and ANSI A.
PAPERS_MM: dict[str, tuple[float, float]] = {
    Paper.a4.value: (210.0, 297.0),
    Paper.a3.value: (297.0, 420.0),
    Paper.letter.value: (215.9, 279.4),
}
#: The length printed where none is asked for, metres. Source: option; the largest round one that fits.
DEFAULT_LENGTH_M: dict[str, float] = {Paper.a4.value: 0.15, Paper.a3.value: 0.25, Paper.letter.value: 0.15}
#: The shortest length that is printed, millimetres. Source: layout; nothing shorter is found in photos.
_LEAST_SIDE_MM = 10
#: White round the black square, in modules, and the least of it. Source: layout; detectors want one, and find the
#: square with half of one (A3 with 0.25 m).
_RIM_MODULES, _LEAST_RIM_MODULES = 1.0, 0.5
#: Free room above the square, room for the text below it, the bar, its line and ticks, millimetres. Source: layout.
_TOP_MM, _TEXT_MM, _BAR_MM, _LINE_MM, _TICK_MM, _LONG_TICK_MM = 8.0, 60.0, 100.0, 0.3, 2.5, 4.0
#: From the rim down to the title, the bar and the lines of text, half the width of these, and from the bar to its
#: number, millimetres. Source: layout.
_TITLE_DOWN_MM, _BAR_DOWN_MM, _LINES_DOWN_MM, _HALF_LINES_MM, _NUMBER_MM = 3, 15, 23, 88, 3
#: Letters of the title and the text, points; distance of lines over their height. Source: layout.
_TITLE_PT, _TEXT_PT, _LINE_SPACING = 13, 9, 1.35
#: Ticks of the bar. Source: layout; a centimetre each.
_TICKS = 10
#: Source: format.
_MM_PER_INCH, _MM_PER_M = 25.4, 1000
#: Fonts are put into the PDF as outlines that printers know (TrueType). Source: format.
_FONT_TYPE = 42


@dataclass(frozen=True, kw_only=True)
class Board:
    """One page.

    Attributes
    ----------
    number: of the marker in its dictionary.
    length_m: side of the black square.
    dictionary: such as ``4X4_50``.
    paper: a key of :data:`PAPERS_MM`.
    """

    number: int
    length_m: float
    dictionary: str = DICTIONARY
    paper: str = Paper.a4.value

    @property
    def speaks(self) -> bool:
        """Whether the number tells fsinfer the length, so that no scale option is needed."""
        return (
            self.dictionary == DICTIONARY and abs(board_lengths().get(self.number, 0.0) - self.length_m) < SAME_LENGTH_M
        )


def write_marker_pdf(
    path: Path,
    *,
    paper: str = Paper.a4.value,
    length_m: float | None = None,
    numbers: Sequence[int] = (),
    count: int = BOARDS,
    dictionary: str = DICTIONARY,
) -> tuple[Board, ...]:
    """Write boards at true size into a PDF of vector graphics, a page each.

    Parameters
    ----------
    length_m: side of the black square; None takes what suits the paper (0.15 m; A3: 0.25 m).
    numbers: of the markers; none takes ``count`` numbers that tell the length by themselves
        (:mod:`fsinfer.scale.printed_boards`).

    Raises
    ------
    InputError
        The board does not fit on the paper, or a number does not exist or means another length.
    ScaleError
        There is no such dictionary.
    OutputError
        ``path`` cannot be written.
    """
    from matplotlib import rc_context
    from matplotlib.backends.backend_pdf import PdfPages

    boards = plan_boards(paper=paper, length_m=length_m, numbers=numbers, count=count, dictionary=dictionary)
    if path.suffix.lower() != ".pdf":
        msg = f"{path} is no PDF; give a name that ends in .pdf"
        raise InputError(msg)
    # Without the date, so that the same boards are the same file.
    facts = {"Title": "fsinfer marker boards", "Creator": "fsinfer", "CreationDate": None}
    with (
        atomic_path(path) as temporary,
        rc_context({"pdf.fonttype": _FONT_TYPE}),
        PdfPages(temporary, metadata=facts) as pages,
    ):
        for board in boards:
            pages.savefig(draw_board(board))
    return boards


def plan_boards(
    *, paper: str, length_m: float | None, numbers: Sequence[int], count: int, dictionary: str
) -> tuple[Board, ...]:
    """Check the wishes of :func:`write_marker_pdf` and say what each page shows."""
    papers = {name.lower(): name for name in PAPERS_MM}
    if paper.lower() not in papers:
        msg = f"there is no paper {paper!r}; choose one of {', '.join(PAPERS_MM)}"
        raise InputError(msg)
    paper = papers[paper.lower()]
    dictionary = dictionary.upper().removeprefix("DICT_")
    available = predefined_dictionary(dictionary)
    length_m = DEFAULT_LENGTH_M[paper] if length_m is None else length_m
    modules = available.markerSize + 2
    width_mm, height_mm = PAPERS_MM[paper]
    widest_mm = min(
        width_mm / (1 + 2 * _LEAST_RIM_MODULES / modules),
        (height_mm - _TOP_MM - _TEXT_MM) / (1 + 2 * _LEAST_RIM_MODULES / modules),
    )
    if not _LEAST_SIDE_MM <= _MM_PER_M * length_m <= widest_mm:
        least_m, most_m = _LEAST_SIDE_MM / _MM_PER_M, np.floor(widest_mm) / _MM_PER_M
        msg = f"a black square of {length_m:g} m does not fit on {paper}; give {least_m:g} to {most_m:g} m"
        raise InputError(msg)
    last = len(available.bytesList) - 1
    meant_m = board_lengths() if dictionary in SAME_MARKERS else {}
    other = {number for number, meant in meant_m.items() if abs(meant - length_m) > SAME_LENGTH_M}
    numbers = list(numbers) or (
        numbers_of_length(length_m, count)
        if dictionary == DICTIONARY
        else [number for number in range(last + 1) if number not in other][:count]
    )
    for number in numbers:
        if not 0 <= number <= last:
            msg = f"marker {number} does not exist: {dictionary} has the numbers 0 to {last}"
            raise InputError(msg)
        if number in other:
            msg = (
                f"number {number} tells fsinfer a side of {meant_m[number]:g} m, not {length_m:g} m; "
                "take a number below 20, or leave the numbers out"
            )
            raise InputError(msg)
    return tuple(Board(number=n, length_m=length_m, dictionary=dictionary, paper=paper) for n in numbers)


def draw_board(board: Board) -> Figure:
    """The page as a matplotlib figure of the paper's size, in vectors; one data unit is a millimetre."""
    from matplotlib.figure import Figure
    from matplotlib.patches import Rectangle

    width_mm, height_mm = PAPERS_MM[board.paper]
    figure = Figure(figsize=(width_mm / _MM_PER_INCH, height_mm / _MM_PER_INCH))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_xlim(0, width_mm)
    axes.set_ylim(0, height_mm)
    axes.set_axis_off()
    left_mm, bottom_mm, rim_mm = square_place_mm(board)
    side_mm = _MM_PER_M * board.length_m
    white = marker_cells(board) > 0
    module_mm = side_mm / len(white)
    axes.add_patch(Rectangle((left_mm, bottom_mm), side_mm, side_mm, facecolor="black", linewidth=0))
    # Runs of white along the rows and then along the columns: single cells would show hairlines between them.
    for row, first, end in _runs(white):
        place = (left_mm + first * module_mm, bottom_mm + (len(white) - 1 - row) * module_mm)
        axes.add_patch(Rectangle(place, (end - first) * module_mm, module_mm, facecolor="white", linewidth=0))
    for column, first, end in _runs(white.T):
        place = (left_mm + column * module_mm, bottom_mm + (len(white) - end) * module_mm)
        axes.add_patch(Rectangle(place, module_mm, (end - first) * module_mm, facecolor="white", linewidth=0))
    _write_text(axes, board, bottom_mm - rim_mm)
    return figure


def square_place_mm(board: Board) -> tuple[float, float, float]:
    """Left and bottom edge of the black square on the page, and the width of its white rim, millimetres."""
    width_mm, height_mm = PAPERS_MM[board.paper]
    side_mm = _MM_PER_M * board.length_m
    rim_mm = _RIM_MODULES * side_mm / len(marker_cells(board))
    left_mm = (width_mm - side_mm) / 2
    rim_mm = min(rim_mm, left_mm)
    top_mm = max(_TOP_MM, rim_mm)
    return left_mm, height_mm - top_mm - side_mm, rim_mm


def marker_cells(board: Board) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    """The cells of the marker with its black border, one value each: 0 black, 255 white."""
    dictionary = predefined_dictionary(board.dictionary)
    modules = dictionary.markerSize + 2
    return np.asarray(cv2.aruco.generateImageMarker(dictionary, board.number, modules, borderBits=1), dtype=np.uint8)


def _runs(
    cells: np.ndarray[tuple[int, ...], np.dtype[np.bool_]],
) -> list[tuple[int, int, int]]:
    """(row, first, end) of each run of True along the rows."""
    found = []
    for row, line in enumerate(cells):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], line, [False]]).astype(np.int8)))
        found += [(row, int(first), int(end)) for first, end in zip(edges[::2], edges[1::2], strict=True)]
    return found


def _write_text(axes: Axes, board: Board, top_mm: float) -> None:
    width_mm = PAPERS_MM[board.paper][0]
    side_mm = _MM_PER_M * board.length_m
    middle = width_mm / 2
    axes.text(
        middle,
        top_mm - _TITLE_DOWN_MM,
        f"fsinfer board {board.number}: side of the black square {side_mm:g} mm",
        ha="center",
        va="top",
        fontsize=_TITLE_PT,
        fontweight="bold",
    )
    _draw_bar(axes, middle - _BAR_MM / 2, top_mm - _BAR_DOWN_MM)
    option = f"--aruco-length-m {board.length_m:g}"
    if board.dictionary != DICTIONARY:
        option += f" --aruco-dictionary {board.dictionary}"
    told = (
        "fsinfer knows this length by the board's number: no option is needed."
        if board.speaks
        else f"Tell fsinfer the length: {option}"
    )
    other = (
        "" if not board.speaks else " If it is not, print again, or give the side you measure with --aruco-length-m."
    )
    lines = (
        f'1. Print at 100 % ("actual size", not "fit to page"). The bar must be {_BAR_MM:g} mm long, the black square',
        f"    {side_mm:g} mm wide and high.{other}",
        "2. Glue it flat on something stiff. Keep the white rim free; matt paper, no shiny film.",
        "3. Put up three or more, each number once, spread over the plot, upright at chest height, facing your",
        "    path, not in broken shade. Pass each at 2 to 3 m: sharp in at least five photos from different places.",
        f"4. {told}",
    )
    left_mm, lines_mm = middle - _HALF_LINES_MM, top_mm - _LINES_DOWN_MM
    style: dict[str, Any] = {"fontsize": _TEXT_PT, "linespacing": _LINE_SPACING}
    axes.text(left_mm, lines_mm, "\n".join(lines), ha="left", va="top", **style)


def _draw_bar(axes: Axes, left_mm: float, y_mm: float) -> None:
    """A bar of 100 mm with a tick every 10 mm; its ends are the outer edges of the end ticks."""
    from matplotlib.patches import Rectangle

    axes.add_patch(Rectangle((left_mm, y_mm), _BAR_MM, _LINE_MM, facecolor="black", linewidth=0))
    for tick in range(_TICKS + 1):
        x_mm = left_mm + tick * (_BAR_MM - _LINE_MM) / _TICKS
        height = _LONG_TICK_MM if tick in (0, _TICKS // 2, _TICKS) else _TICK_MM
        axes.add_patch(Rectangle((x_mm, y_mm), _LINE_MM, height, facecolor="black", linewidth=0))
    axes.text(left_mm + _BAR_MM + _NUMBER_MM, y_mm, f"{_BAR_MM:g} mm", ha="left", va="bottom", fontsize=_TEXT_PT)
