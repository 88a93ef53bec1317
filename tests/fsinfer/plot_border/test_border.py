"""Distances from circles and polygons, and where a border is placed."""

from __future__ import annotations

import numpy as np
import pytest

from fsinfer.notices.notice import Notice
from fsinfer.notices.plots import PlotCode
from fsinfer.notices.sentences import sentence
from fsinfer.plot_border.border import Border
from fsinfer.plot_border.place import middle_of_walk, place_border
from fsinfer.plot_border.request import BorderRequest

# An L: not convex.
CORNERS = ((0.0, 0.0), (4.0, 0.0), (4.0, 2.0), (2.0, 2.0), (2.0, 6.0), (0.0, 6.0))


def test_a_circle() -> None:
    border = Border(center=(1.0, 2.0), radius_m=3.0, origin="walk", moves_along=True)
    assert border.area_m2 == pytest.approx(28.274, abs=1e-3)
    places = np.array([[1.0, 2.0], [4.0, 2.0], [1.0, -2.0], [3.5, 2.0]])
    np.testing.assert_allclose(border.inside_m(places), [3.0, 0.0, -1.0, 0.5], atol=1e-12)
    np.testing.assert_allclose(border.inside_m(border.outline), 0.0, atol=1e-12)


@pytest.mark.parametrize("corners", [CORNERS, CORNERS[::-1]])
def test_a_polygon_that_is_not_convex(corners: tuple[tuple[float, float], ...]) -> None:
    border = Border(corners=corners, origin="polygon", moves_along=False)
    assert border.area_m2 == pytest.approx(16.0)
    places = np.array([[1.0, 1.0], [3.0, 3.0], [2.5, 4.0], [1.5, 4.0], [5.0, 1.0], [-1.0, -1.0], [3.0, 1.0]])
    np.testing.assert_allclose(border.inside_m(places), [1.0, -1.0, -0.5, 0.5, -1.0, -np.sqrt(2), 1.0])


def test_a_border_of_many_corners_is_looked_at_in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    turn = np.linspace(0.0, 2.0 * np.pi, 300, endpoint=False)
    ring = np.column_stack([np.cos(turn), np.sin(turn)]) * (10.0 + np.sin(7.0 * turn))[:, None]
    border = Border(corners=tuple((x, y) for x, y in ring.tolist()), origin="polygon", moves_along=False)
    places = np.random.default_rng(0).uniform(-12.0, 12.0, (500, 2))
    whole = border.inside_m(places)
    assert border.inside_m(np.zeros((0, 2))).shape == (0,)
    monkeypatch.setattr("fsinfer.plot_border.border._AT_ONCE", 2_000)
    np.testing.assert_array_equal(border.inside_m(places), whole)


def test_the_walks_middle_is_not_where_most_photos_were_taken() -> None:
    turn = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    ring = np.column_stack([5 + 8 * np.cos(turn), -3 + 8 * np.sin(turn)])
    crowd = np.tile(ring[:1], (200, 1)) + np.random.default_rng(0).normal(0, 0.1, (200, 2))
    middle = middle_of_walk(np.concatenate([ring, crowd]))
    np.testing.assert_allclose(middle, [5, -3], atol=0.15)
    assert np.linalg.norm(np.concatenate([ring, crowd]).mean(axis=0) - [5, -3]) > 5
    # A straight walk, two photographs and one enclose nothing.
    np.testing.assert_allclose(middle_of_walk(np.array([[0.0, 0], [1, 1], [2, 2], [3, 3]])), [1.5, 1.5])
    np.testing.assert_allclose(middle_of_walk(np.array([[0.0, 0], [4, 2]])), [2, 1])
    np.testing.assert_allclose(middle_of_walk(np.array([[3.0, 1]])), [3, 1])


CAMERAS = np.array([[0.0, 0], [4, 0], [4, 4], [0, 4]])


def placed(request: BorderRequest, **more: object) -> Border | Notice:
    return place_border(request, **({"cameras_xy": CAMERAS} | more))  # type: ignore[arg-type]


def test_a_circle_lies_round_walk_marker_or_place() -> None:
    round_walk = placed(BorderRequest(radius_m=3.0))
    assert isinstance(round_walk, Border)
    assert (round_walk.center, round_walk.origin, round_walk.anchor) == ((2.0, 2.0), "walk", (2.0, 2.0))
    markers = [(7, (1.0, 5.0)), (8, (9.0, 9.0)), (7, (1.2, 5.0))]
    round_marker = placed(BorderRequest(radius_m=3.0, marker=7), markers=markers)
    assert isinstance(round_marker, Border)
    assert round_marker.center == pytest.approx((1.1, 5.0))
    assert round_marker.origin == "marker 7"
    at_place = placed(BorderRequest(radius_m=3.0, center=(8.0, 1.0)), cameras_xy=None)
    assert isinstance(at_place, Border)
    # What was written down stays where it is when the scale is off; stems move away from the frame's origin.
    assert (at_place.center, at_place.anchor) == ((8.0, 1.0), (0.0, 0.0))
    polygon = placed(BorderRequest(polygon=CORNERS))
    assert isinstance(polygon, Border)
    assert polygon.corners == CORNERS


def test_why_there_is_no_border() -> None:
    missing = placed(BorderRequest(radius_m=3.0, marker=7), markers=[(8, (0.0, 0.0)), (5, (0.0, 0.0))])
    assert isinstance(missing, Notice)
    assert missing.code == PlotCode.no_such_marker
    assert "marker 7, was not found; found: 5, 8;" in sentence(missing)
    twice = placed(BorderRequest(radius_m=3.0, marker=7), markers=[(7, (0.0, 0.0)), (7, (3.0, 4.0))])
    assert isinstance(twice, Notice)
    assert sentence(twice) == "its centre, marker 7, was found at two places 5.0 m apart"
    unknown = placed(BorderRequest(radius_m=3.0), cameras_xy=None)
    assert isinstance(unknown, Notice)
    assert unknown.code == PlotCode.no_walk
