"""Printed boards have their true size, are found, and tell their length."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.errors import InputError, ScaleError
from fsinfer.scale.board_sheet import PAPERS_MM, Board, draw_board, square_place_mm, write_marker_pdf
from fsinfer.scale.detection import detect_markers, make_detector
from fsinfer.scale.doubts import doubt_about_all
from fsinfer.scale.printed_boards import DICTIONARY, RANGES, board_lengths, numbers_of_length
from tests.support.boards import board as seen_board
from tests.support.boards import scale_of_boards

DPI = 150


def raster(board: Board) -> NDArray[np.uint8]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    figure = draw_board(board)
    figure.set_dpi(DPI)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[:, :, :3])


@pytest.mark.parametrize(
    "board",
    [
        Board(number=20, length_m=0.15),
        Board(number=29, length_m=0.15, paper="Letter"),
        Board(number=40, length_m=0.25, paper="A3"),
        Board(number=17, length_m=0.1, dictionary="APRILTAG_36H11"),
    ],
)
def test_the_drawn_board_is_found_with_its_true_size_and_place(board: Board) -> None:
    found = detect_markers(raster(board), make_detector(board.dictionary))
    assert [number for number, _ in found] == [board.number]
    corners_mm = found[0][1] * 25.4 / DPI
    sides_mm = np.linalg.norm(corners_mm - np.roll(corners_mm, 1, axis=0), axis=1)
    assert np.abs(sides_mm - 1000 * board.length_m).max() < 0.2
    left_mm, bottom_mm, rim_mm = square_place_mm(board)
    assert corners_mm[:, 0].min() == pytest.approx(left_mm, abs=0.5)
    assert PAPERS_MM[board.paper][1] - corners_mm[:, 1].max() == pytest.approx(bottom_mm, abs=0.5)
    assert rim_mm >= 1000 * board.length_m / 12  # half a module of a 4x4 marker


def test_the_bar_is_100_mm_long() -> None:
    board = Board(number=20, length_m=0.15)
    dark = raster(board).mean(axis=2) < 128
    _, bottom_mm, rim_mm = square_place_mm(board)
    rows = PAPERS_MM["A4"][1] - (bottom_mm - rim_mm - 15)
    row = round(rows / 25.4 * DPI)
    columns = np.flatnonzero(dark[row - 3 : row + 1].any(axis=0))
    # The label beside the bar begins 3 mm after it.
    bar = columns[columns <= columns[0] + 101.5 / 25.4 * DPI]
    assert (bar[-1] - bar[0] + 1) * 25.4 / DPI == pytest.approx(100, abs=0.4)


def test_the_pdf_has_a_page_of_paper_size_for_each_board(tmp_path: Path) -> None:
    boards = write_marker_pdf(tmp_path / "m.pdf", paper="a3", count=3)
    assert [(b.number, b.length_m, b.speaks) for b in boards] == [(n, 0.25, True) for n in (40, 41, 42)]
    data = (tmp_path / "m.pdf").read_bytes()
    sizes = re.findall(rb"/MediaBox \[ *0 0 ([\d.]+) ([\d.]+) *\]", data)
    assert len(sizes) == 3
    points = [(float(a), float(b)) for a, b in sizes]
    assert points[0] == pytest.approx((297 / 25.4 * 72, 420 / 25.4 * 72), abs=0.1)
    # Vectors: there is no picture in it.
    assert b"/Subtype /Image" not in data
    write_marker_pdf(tmp_path / "again.pdf", paper="A3", count=3)
    assert (tmp_path / "again.pdf").read_bytes() == data


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"length_m": 0.3}, "does not fit on A4"),
        ({"numbers": [50]}, "numbers 0 to 49"),
        ({"numbers": [41]}, "tells fsinfer a side of 0.25 m"),
        # The first markers of 4X4_100 are those of 4X4_50, and are taken for them.
        ({"numbers": [20], "length_m": 0.1, "dictionary": "4X4_100"}, "tells fsinfer a side of 0.15 m"),
        ({"paper": "A9"}, "A4, A3, Letter"),
        ({"count": 11}, "1 to 10 numbers"),
    ],
)
def test_what_cannot_be_printed_says_why(tmp_path: Path, options: dict[str, object], says: str) -> None:
    with pytest.raises(InputError, match=says):
        write_marker_pdf(tmp_path / "m.pdf", **options)  # type: ignore[arg-type]
    assert not (tmp_path / "m.pdf").exists()


def test_wrong_dictionary_and_suffix(tmp_path: Path) -> None:
    with pytest.raises(ScaleError, match="no ArUco dictionary"):
        write_marker_pdf(tmp_path / "m.pdf", dictionary="9X9_3")
    with pytest.raises(InputError, match=r"ends in \.pdf"):
        write_marker_pdf(tmp_path / "m.png")


def test_numbers_and_lengths_agree() -> None:
    lengths = board_lengths()
    for first, end, length_m in RANGES:
        assert numbers_of_length(length_m, end - first) == list(range(first, end))
        assert {lengths[number] for number in range(first, end)} == {length_m}
    assert numbers_of_length(0.12, 3) == [0, 1, 2]
    # What people print first when they make boards of their own must mean nothing.
    assert min(lengths) == 20


def test_nobody_is_told_to_hang_a_number_twice() -> None:
    with pytest.raises(InputError, match="one place only") as told:
        numbers_of_length(0.15, 14)
    assert "twice" not in str(told.value)
    # It would be doubted, as photos in a wrong place are.
    boards = [seen_board(20 + rank % 10, (3.0 * rank, 0.0, 1.0), ["a"], length_m=0.15) for rank in range(14)]
    assert doubt_about_all(scale_of_boards(boards)) is not None


def test_boards_of_a_larger_dictionary_are_not_taken_for_those_that_tell_their_length(tmp_path: Path) -> None:
    boards = write_marker_pdf(tmp_path / "m.pdf", length_m=0.1, count=25, dictionary="4X4_100")
    detector = make_detector(DICTIONARY)
    for board in boards:
        found = {number for number, _ in detect_markers(raster(board), detector)}
        assert not found & board_lengths().keys()
    assert len(boards) == 25
