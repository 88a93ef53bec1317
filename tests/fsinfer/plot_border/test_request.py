"""What makes a border, what is refused, and with which words."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from fsinfer.errors import InputError
from fsinfer.plot_border.request import BorderRequest, border_request, parse_center, read_polygon

SQUARE = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)]


@pytest.mark.parametrize(
    ("text", "marker", "place"),
    [
        (None, None, None), ("walk", None, None), ("marker:7", 7, None), ("Marker: 12", 12, None),
        ("1.5,-2", None, (1.5, -2.0)), ("486000.5, 5400000", None, (486000.5, 5400000.0)),
    ],
)  # fmt: skip
def test_centers(text: str | None, marker: int | None, place: tuple[float, float] | None) -> None:
    assert parse_center(text) == (marker, place)
    assert border_request(12.62 if text else None, text, None).needs_walk is (text == "walk")


@pytest.mark.parametrize("text", ["7", "marker:x", "1;2", "1,2,3", "nan,1", "", "centre"])
def test_what_is_no_center(text: str) -> None:
    with pytest.raises(InputError, match="--plot-center"):
        border_request(12.62, text, None)


def test_halves_and_doubles_are_refused(tmp_path: Path) -> None:
    path = geojson(tmp_path, {"type": "Polygon", "coordinates": [SQUARE]})
    with pytest.raises(InputError, match="without --plot-radius-m"):
        border_request(None, "walk", path)
    with pytest.raises(InputError, match="given together"):
        border_request(5.0, None, path)
    for radius in (0.0, -1.0, 1262.0, float("nan"), float("inf")):
        with pytest.raises(InputError, match="horizontal radius in metres"):
            BorderRequest(radius_m=radius)
    assert not BorderRequest().given
    assert border_request(None, None, path).polygon == tuple(SQUARE)


def geojson(folder: Path, content: object) -> Path:
    path = folder / "plot.geojson"
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


def feature(shape: object) -> dict[str, object]:
    return {"type": "Feature", "properties": {}, "geometry": shape}


def test_polygons_are_read_from_all_usual_wrappings(tmp_path: Path) -> None:
    ring = [*SQUARE, SQUARE[0]]
    polygon = {"type": "Polygon", "coordinates": [[(*corner, 300.0) for corner in ring]]}
    for content in (
        polygon,
        feature(polygon),
        {"type": "FeatureCollection", "features": [feature(polygon)]},
        {"type": "MultiPolygon", "coordinates": [[ring]]},
    ):
        assert read_polygon(geojson(tmp_path, content)) == tuple(SQUARE)
    twice = {"type": "Polygon", "coordinates": [[corner for corner in ring for _ in range(2)]]}
    assert read_polygon(geojson(tmp_path, twice)) == tuple(SQUARE)
    for text in ("x_m,y_m\n0,0\n10,0\n10,10\n0,10\n", "x;y\n0;0\n10,0;0\n10,0;10\n0;10,0\n0;0\n"):
        path = tmp_path / "plot.csv"
        path.write_text(text, encoding="utf-8")
        assert read_polygon(path) == tuple(SQUARE)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"type": "Point", "coordinates": [0, 0]}, "holds 1 shapes .Point."),
        ({"type": "FeatureCollection", "features": []}, "holds 0 shapes"),
        ([1, 2], "holds 0 shapes"),
        ({"type": "Polygon", "coordinates": [SQUARE, [(2, 2), (3, 2), (3, 3)]]}, "1 holes"),
        ({"type": "Polygon", "coordinates": None}, "0 holes"),
        ({"type": "Polygon", "coordinates": [["a"]]}, "no polygon"),
        ({"type": "Polygon", "coordinates": [[(0, 0), (1, 1), (0, 0)]]}, "2 different corners"),
        ({"type": "Polygon", "coordinates": [[SQUARE[0], SQUARE[2], SQUARE[1], SQUARE[3]]]}, "cross"),
        ({"type": "Polygon", "coordinates": [[(13.1, 52.1), (13.2, 52.1), (13.2, 52.2)]]}, "not degrees"),
        ({"type": "MultiPolygon", "coordinates": [[SQUARE], [SQUARE]]}, "several polygons"),
    ],
)
def test_what_is_no_plot(tmp_path: Path, content: object, words: str) -> None:
    with pytest.raises(InputError, match=words):
        read_polygon(geojson(tmp_path, content))


@pytest.mark.parametrize(
    "corners",
    [
        [(0, 0), (10, 0), (20, 0), (30, 0), (30, 30), (0, 30)],  # surveyed every ten metres along one side
        [(0, 0), (7, 3.5), (14, 7), (28, 14), (0, 30)],  # the same on a slant
        [(0, 0), (30, 0), (30, 20), (20, 20), (20, 10), (10, 10), (10, 20), (0, 20)],  # a U
    ],
)
def test_sides_in_one_line_do_not_cross(tmp_path: Path, corners: list[tuple[float, float]]) -> None:
    ring = [*corners, corners[0]]
    assert read_polygon(geojson(tmp_path, {"type": "Polygon", "coordinates": [ring]})) == tuple(corners)


@pytest.mark.parametrize(
    "corners",
    [
        [(0, 0), (10, 0), (10, 10), (5, 0), (0, 10)],  # a corner on another side
        [(0, 0), (20, 0), (20, 10), (15, 0), (5, 0), (0, 10)],  # a side on another side
    ],
)
def test_sides_that_touch_are_no_border(tmp_path: Path, corners: list[tuple[float, float]]) -> None:
    with pytest.raises(InputError, match="cross or touch"):
        read_polygon(geojson(tmp_path, {"type": "Polygon", "coordinates": [[*corners, corners[0]]]}))


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    for name in ("none.geojson", "none.csv"):
        with pytest.raises(InputError, match="no such file"):
            read_polygon(tmp_path / name)
    (tmp_path / "cut.geojson").write_text('{"type": "Poly', encoding="utf-8")
    with pytest.raises(InputError, match="cannot read"):
        read_polygon(tmp_path / "cut.geojson")
    (tmp_path / "plot.csv").write_text("lon,lat\n1,2\n", encoding="utf-8")
    with pytest.raises(InputError, match="x_m and y_m"):
        read_polygon(tmp_path / "plot.csv")
    (tmp_path / "plot.csv").write_text("x,y\n1,2\n3,a\n", encoding="utf-8")
    with pytest.raises(InputError, match="row 3, column y"):
        read_polygon(tmp_path / "plot.csv")


@pytest.mark.parametrize("name", ["Stichprobe 7.gpkg", "plot.shp", "plot.KML"])
def test_maps_of_a_gis_are_asked_for_as_geojson(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"SQLite format 3\x00\xff")
    with pytest.raises(InputError, match="export it from the GIS as GeoJSON, in metres") as told:
        read_polygon(tmp_path / name)
    assert "column" not in str(told.value)
    with pytest.raises(InputError, match="no such file"):
        read_polygon(tmp_path / "other.gpkg")
