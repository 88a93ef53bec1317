"""What a run prints of its scale: the boards that gave it, and those that did not count."""

from __future__ import annotations

from dataclasses import replace

from fsinfer.cli.tables import scale_rows
from fsinfer.scale.scale import UNKNOWN, BoardVerdict, RejectedMarker, scale_from_factor
from tests.support.boards import board, scale_of_boards

VIEWS = ("a", "b", "c")


def test_boards_that_count_and_numbers_that_do_not_are_named() -> None:
    boards = [board(number, (4.0 * number, 0.0, 1.0), VIEWS) for number in (11, 2, 5)]
    boards[2] = replace(boards[2], verdict=BoardVerdict.outvoted)
    # The second face of a board is no other board.
    boards.append(board(2, (8.0, 0.01, 1.0), VIEWS))
    seldom = RejectedMarker(id=9, reason="2 views: fewer than 3 agree on one place")
    assert scale_rows(scale_of_boards(boards, rel_std=0.0015, rejected=(seldom,))) == [
        "Scale: by 2 boards (2, 11), known to 0.3 %",
        "  number 9 does not count: 2 views: fewer than 3 agree on one place",
    ]


def test_one_board_is_told_as_one() -> None:
    (row,) = scale_rows(scale_of_boards([board(3, (0.0, 0.0, 1.0), VIEWS)], rel_std=0.005))
    assert row == "Scale: by 1 board (3), known to 1.0 %"


def test_of_a_scale_from_elsewhere_nothing_is_told_here() -> None:
    assert scale_rows(UNKNOWN) == scale_rows(scale_from_factor(0.5)) == []
