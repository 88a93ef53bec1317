"""A board that stands at two places in the scene is told by the run, not by the check alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from fsinfer.check.advice import marker_lines
from fsinfer.notices.capture import CaptureCode
from fsinfer.notices.notice import notice
from fsinfer.notices.sentences import sentence
from fsinfer.scale.doubts import boards_at_two_places, doubt_about_all, doubt_boards, number_of_boards
from fsinfer.scale.find import find_scale
from fsinfer.scale.request import ScaleRequest
from fsinfer.scale.scale import UNKNOWN, BoardVerdict
from fsinfer.scene import Scene
from tests.support.boards import board, scale_of_boards


@pytest.mark.parametrize("twice", [False, True])
def test_a_run_warns_of_a_board_at_two_places(monkeypatch: pytest.MonkeyPatch, twice: bool) -> None:
    markers = [board(1, (0.0, 0.0, 0.0), "abc"), board(2, (3.0, 0.0, 0.0), "ab")]
    if twice:
        markers.append(board(1, (0.0, 2.0, 0.0), "qp"))
    scale = scale_of_boards(markers, m_per_unit=1.5)
    monkeypatch.setattr("fsinfer.scale.find.scale_from_aruco", lambda *_args, **_kwargs: scale)
    scene = Scene(folder=Path("scene"), views=())
    for request in (ScaleRequest(aruco_length_m=0.25), ScaleRequest()):
        found = find_scale(request, scene=scene)
        assert found.scale is scale
        assert len(found.warnings) == int(twice)
        if twice:
            assert sentence(found.warnings[0]).startswith("Board 1 was found at two places 3.0 m apart.")
            assert "p to q" in sentence(found.warnings[0])


@pytest.mark.parametrize("length_m", [0.25, None])
def test_one_board_alone_is_told_whoever_says_its_length(
    monkeypatch: pytest.MonkeyPatch, length_m: float | None
) -> None:
    scale = scale_of_boards([board(41, (0.0, 0.0, 0.0), "abc")], length_m=length_m)
    monkeypatch.setattr("fsinfer.scale.find.scale_from_aruco", lambda *_args, **_kwargs: scale)
    found = find_scale(ScaleRequest(aruco_length_m=length_m), scene=Scene(folder=Path("scene"), views=()))
    (said,) = (sentence(warning) for warning in found.warnings)
    told = "as given" if length_m else "by its number"
    assert f"rests on one board (number 41, 0.25 m {told})" in said
    assert sentence(notice(CaptureCode.one_board, number=21, length_m=0.25)).count("by its number") == 1


def test_the_two_faces_of_one_board_are_no_alarm_and_drift_is() -> None:
    front = board(1, (0.0, 0.0, 0.0), "abc", normal=(0.0, 0.0, 1.0))
    back = board(1, (0.02, 0.0, -0.04), "pq", normal=(0.0, 0.1, -0.995))
    drifted = board(1, (0.0, 0.0, -0.05), "pq", normal=(0.0, 0.1, 0.995))
    across_the_plot = board(1, (0.0, 3.0, 0.0), "pq", normal=(0.0, 0.0, -1.0))
    assert boards_at_two_places(scale_of_boards([front, back]), 1.0) == ()
    assert "at two places 5 cm apart" in sentence(boards_at_two_places(scale_of_boards([front, drifted]), 1.0)[0])
    assert "at two places 3.0 m apart" in sentence(
        boards_at_two_places(scale_of_boards([front, across_the_plot]), 1.0)[0]
    )


@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (0.0, 0.7, -0.7), None])
def test_a_board_is_at_one_place_whichever_way_its_faces_seem_to_look(
    normal: tuple[float, float, float] | None,
) -> None:
    front = board(1, (0.0, 0.0, 0.0), "abc", normal=(0.0, 0.0, 1.0))
    for apart, alarms in ((0.004, 0), (0.025, 0), (0.035, 1)):
        again = board(1, (0.0, 0.0, apart), "pq", normal=normal)
        # In a scene whose unit is half a metre.
        found = boards_at_two_places(scale_of_boards([front, replace(again, center=(0.0, 0.0, 2 * apart))]), 0.5)
        assert len(found) == alarms, apart


def test_a_board_with_two_faces_is_one_board() -> None:
    faces = [board(21, (0.0, 0.0, z), ["a", "b", "c"], normal=(0.0, 0.0, 1.0 if z == 0 else -1.0)) for z in (0.0, 0.01)]
    assert [doubt.code for doubt in doubt_boards(scale_of_boards(faces))] == [CaptureCode.one_board]
    assert number_of_boards(faces) == 1
    lines = marker_lines(scale_of_boards(faces), given=True)
    assert lines[-1].startswith("1 board: three or more")
    other = board(22, (5.0, 0.0, 0.0), ["a", "b", "c"], normal=(0.0, 0.0, 1.0))
    assert not doubt_boards(scale_of_boards([*faces, other]))


def test_a_board_that_a_drift_shows_twice_is_one_board() -> None:
    places = [board(21, (x, 0.0, 0.0), ["a", "b", "c"], normal=(0.0, 0.0, 1.0)) for x in (0.0, 0.1)]
    assert [doubt.code for doubt in doubt_boards(scale_of_boards(places))] == [CaptureCode.one_board]


def test_a_board_that_a_drift_shows_twice_is_told_once() -> None:
    """Seen in six photos it was to be passed again, twice, for the three of each of its places."""

    def lines(apart_m: float, *seen: tuple[str, float]) -> list[str]:
        places = [
            board(21, (apart_m * index, 0.0, 0.0), views, near_side_px=side_px, normal=(0.0, 0.0, 1.0))
            for index, (views, side_px) in enumerate(seen)
        ]
        return [line for line in marker_lines(scale_of_boards(places), given=True) if line.startswith("Board 21")]

    once = "Board 21: in 6 photos, in the five nearest its side is at least 60 pixels: good."
    assert lines(0.1, ("abc", 80.0), ("def", 60.0)) == [once]
    assert lines(0.1, ("abcde", 60.0), ("f", 30.0)) == [once]
    # Farther apart there are two of one number, or photos in a wrong place.
    assert [line.split(":")[1] for line in lines(3.0, ("abc", 80.0), ("def", 60.0))] == [
        " in 3 photos, in all of them its side is at least 80 pixels",
        " in 3 photos, in all of them its side is at least 60 pixels",
    ]


def test_boards_that_contradict_are_named() -> None:
    boards = [board(number, (float(number), 0.0, 0.0), ["a", "b", "c"]) for number in (1, 2, 3)]
    assert not doubt_boards(scale_of_boards(boards))
    wrong = replace(boards[1], verdict=BoardVerdict.outvoted, residual_rel=-0.06)
    (told,) = doubt_boards(scale_of_boards([boards[0], wrong, boards[2]]))
    assert "board 2 comes out 6.0 % smaller than the other boards make it" in sentence(told)
    # The same board elsewhere, too: photos are in the wrong place, and its print is right.
    twice = board(2, (0.0, 9.0, 0.0), ["p", "q", "r"])
    assert not doubt_boards(scale_of_boards([boards[0], wrong, boards[2], twice]))
    # Wrong wherever it is seen it is the print, which is told once.
    twice = replace(twice, verdict=BoardVerdict.outvoted)
    assert [doubt.code for doubt in doubt_boards(scale_of_boards([boards[0], wrong, boards[2], twice]))] == [
        CaptureCode.board_outvoted
    ]
    torn = [replace(boards[0], verdict=BoardVerdict.contradicted)]
    torn.append(replace(boards[1], verdict=BoardVerdict.contradicted, m_per_unit=0.94))
    (told,) = doubt_boards(scale_of_boards(torn))
    assert "boards 2 and 1 contradict each other by 6.4 %" in sentence(told)


@pytest.mark.parametrize(
    ("number", "given_m", "told"),
    [(21, 0.25, True), (41, 0.25, False), (21, 0.142, False), (7, 0.25, False), (31, 0.15, True)],
)
def test_another_length_than_the_board_says_is_told(number: int, given_m: float, told: bool) -> None:
    boards = [board(number, (float(place), 0.0, 0.0), ["a", "b", "c"], length_m=given_m) for place in range(3)]
    found = doubt_boards(scale_of_boards(boards, length_m=given_m))
    assert [doubt.code for doubt in found] == [CaptureCode.printed_length_differs] * told
    if told:
        assert f"says {given_m:g} m" in sentence(found[0])
        assert f"too {'large' if number == 21 else 'small'}" in sentence(found[0])
    # Where the numbers told the length there is nothing to compare.
    assert not doubt_boards(scale_of_boards(boards, length_m=None))


@pytest.mark.parametrize(
    ("twice", "apart_m", "doubted"),
    [((1, 2), 4.0, "1, 2"), ((1,), 4.0, None), ((1, 2), 0.25, None), ((1, 2, 3), 0.35, "1, 2, 3"), ((), 4.0, None)],
)
def test_several_boards_metres_from_themselves_make_all_stems_doubtful(
    twice: tuple[int, ...], apart_m: float, doubted: str | None
) -> None:
    boards = [board(number, (3.0 * number, 0.0, 0.0), "abc", m_per_unit=2.0) for number in (1, 2, 3, 4, 5, 6)]
    boards += [board(number, (3.0 * number, apart_m / 2, 0.0), "pq", m_per_unit=2.0) for number in twice]
    scale = scale_of_boards(boards, m_per_unit=2.0)
    doubt = doubt_about_all(scale)
    assert doubt_about_all(replace(scale, m_per_unit=None)) == doubt
    if doubted is None:
        assert doubt is None
    else:
        assert doubt is not None
        assert doubt.values["boards"] == doubted
        assert doubt.values["apart_m"] == pytest.approx(apart_m)
        assert f"boards {doubted} stand at two places" in sentence(doubt)


def test_two_boards_of_many_are_two_prints_of_one_number() -> None:
    boards = [board(number, (3.0 * number, 0.0, 0.0), "abc") for number in range(1, 8)]
    boards += [board(number, (3.0 * number, 4.0, 0.0), "pq") for number in (1, 2)]
    scale = scale_of_boards(boards)
    assert doubt_about_all(scale) is None
    assert doubt_about_all(UNKNOWN) is None
