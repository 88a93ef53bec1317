"""What the user says of the plot's border: a radius round a centre, or a polygon. Light to import."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

from fsinfer.errors import InputError
from fsinfer.io.csv_text import read_table
from fsinfer.io.json_text import read_json

Place = tuple[float, float]
#: Radii and sides of plots, metres: outside of these a number is in another unit. Source: forest inventories use 1 to
#: 56 m.
RADII_M = (0.5, 500.0)
#: A polygon of less has its corners in degrees or kilometres, square metres. Source: as the least radius.
LEAST_AREA_M2 = 1.0
_WAYS = "write marker:7 (the number of a board), x,y (metres of the cloud, like 1.5,-2.0), or walk"
#: Files of other programs with polygons in them, which need a reader of their own. Source: format; OGC, Esri, Garmin.
_OTHER_MAPS = frozenset({".gpkg", ".shp", ".shx", ".dbf", ".zip", ".kml", ".kmz", ".gpx", ".dxf", ".gml", ".sqlite"})
_POLYGON = "give a GeoJSON with one Polygon, or a CSV with the columns x_m,y_m, a corner a row, in metres of the plot"


@dataclass(frozen=True, kw_only=True)
class BorderRequest:
    """At most one border. With a radius and neither marker nor centre the circle lies round the middle of the walk.

    Attributes
    ----------
    radius_m: horizontal, metres. Source: option.
    marker: number of the board at the centre. Source: option.
    center: x, y in metres of the cloud's frame. Source: option.
    polygon: corners x, y in their order, metres of the cloud's frame. Source: option.

    Raises
    ------
    InputError
        A centre without a radius, a radius beside a polygon, or numbers that make no plot.
    """

    radius_m: float | None = None
    marker: int | None = None
    center: Place | None = None
    polygon: tuple[Place, ...] = ()

    def __post_init__(self) -> None:
        if self.polygon and self.radius_m is not None:
            msg = "--plot-radius-m and --plot-polygon were given together; a plot has one border"
            raise InputError(msg)
        if self.radius_m is None and (self.marker is not None or self.center is not None):
            msg = "--plot-center was given without --plot-radius-m; give the radius of the plot in metres, too"
            raise InputError(msg)
        if self.radius_m is not None and not RADII_M[0] <= self.radius_m <= RADII_M[1]:
            msg = f"--plot-radius-m is {self.radius_m:g}; it is the horizontal radius in metres, for example 12.62"
            raise InputError(msg)

    @property
    def given(self) -> bool:
        """Whether there is a border at all."""
        return self.radius_m is not None or bool(self.polygon)

    @property
    def needs_walk(self) -> bool:
        """Whether its centre is the middle of the walk, which only photographs tell."""
        return self.radius_m is not None and self.marker is None and self.center is None


def border_request(radius_m: float | None, center: str | None, polygon: Path | None) -> BorderRequest:
    """Of the options as they are written; :class:`InputError` where they make no border.

    ``center`` is ``walk``, ``marker:NUMBER`` or ``x,y``; None is ``walk``.
    """
    marker, place = parse_center(center)
    if center is not None and radius_m is None:
        msg = f"--plot-center {center} was given without --plot-radius-m; give the radius of the plot in metres, too"
        raise InputError(msg)
    corners = () if polygon is None else read_polygon(polygon)
    return BorderRequest(radius_m=radius_m, marker=marker, center=place, polygon=corners)


def parse_center(text: str | None) -> tuple[int | None, Place | None]:
    """Number of the marker and place that ``--plot-center`` names, both None for the walk."""
    if text is None or text.strip().lower() == "walk":
        return None, None
    marker = re.fullmatch(r"\s*marker:\s*(\d+)\s*", text, flags=re.IGNORECASE)
    if marker:
        return int(marker[1]), None
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != 2 or not all(math.isfinite(number) for number in numbers):
        msg = f"--plot-center {text!r} is no place; {_WAYS}"
        raise InputError(msg)
    return None, (numbers[0], numbers[1])


def read_polygon(path: Path) -> tuple[Place, ...]:
    """Corners of the polygon in a GeoJSON or a CSV (columns ``x_m, y_m`` or ``x, y``), the last one not repeated.

    GeoJSON asks for longitude and latitude (RFC 7946); here its numbers are metres of the cloud's frame.

    Raises
    ------
    InputError
        The file cannot be read, holds another shape, more than one, or one with holes, or its sides cross.
    """
    corners = _read_csv(path) if path.suffix.lower() in {".csv", ".txt"} else _read_geojson(path)
    # What was drawn by hand or walked has corners twice, one after the other.
    corners = tuple(place for place, _ in groupby(corners))
    if len(corners) > 1 and corners[0] == corners[-1]:
        corners = corners[:-1]
    if len(set(corners)) < 3:
        msg = f"{path} has {len(set(corners))} different corners; a plot needs three"
        raise InputError(msg)
    from fsinfer.plot_border.crossing import sides_cross  # loads NumPy

    if sides_cross(corners):
        msg = f"the sides of the polygon in {path} cross or touch; give its corners in their order round the plot"
        raise InputError(msg)
    if area_m2(corners) < LEAST_AREA_M2:
        msg = (
            f"the polygon in {path} has an area of {area_m2(corners):.2g} m²: its corners must be metres of the "
            "cloud's frame, not degrees or kilometres"
        )
        raise InputError(msg)
    return corners


def area_m2(corners: tuple[Place, ...]) -> float:
    """Area of a polygon by the shoelace formula."""
    twice = sum(
        x * next_y - next_x * y
        for (x, y), (next_x, next_y) in zip(corners, corners[1:] + corners[:1], strict=True)
    )  # fmt: skip
    return abs(twice) / 2.0


def _read_csv(path: Path) -> tuple[Place, ...]:
    table = read_table(path, what="the plot's polygon", required=(), way_out=_POLYGON)
    names = next((pair for pair in (("x_m", "y_m"), ("x", "y")) if set(pair) <= set(table.columns)), None)
    if names is None:
        msg = f"{path} has no columns x_m and y_m; {_POLYGON}"
        raise InputError(msg)
    return tuple((row.given(names[0]), row.given(names[1])) for row in table.rows)


def _read_geojson(path: Path) -> tuple[Place, ...]:
    if path.suffix.lower() in _OTHER_MAPS and path.exists():
        msg = (
            f"the plot's polygon {path} is a {path.suffix} file, which is not read: export it from the GIS as GeoJSON, "
            "in metres of the plot, not in longitude and latitude"
        )
        raise InputError(msg)
    try:
        content = read_json(path, encoding="utf-8-sig")
    except FileNotFoundError as error:
        msg = f"cannot read the plot's polygon {path}: there is no such file; {_POLYGON}"
        raise InputError(msg) from error
    except (OSError, ValueError) as error:
        msg = f"cannot read the plot's polygon {path}: {error}; {_POLYGON}"
        raise InputError(msg) from error
    shapes = _shapes(content)
    if len(shapes) != 1 or shapes[0].get("type") not in ("Polygon", "MultiPolygon"):
        msg = f"{path} holds {len(shapes)} shapes{_kinds(shapes)}; {_POLYGON}"
        raise InputError(msg)
    rings = shapes[0].get("coordinates")
    if shapes[0]["type"] == "MultiPolygon":
        if not isinstance(rings, list) or len(rings) != 1:
            msg = f"{path} holds several polygons; {_POLYGON}"
            raise InputError(msg)
        rings = rings[0]
    try:
        corners = [tuple((float(x), float(y)) for x, y, *_ in ring) for ring in rings or []]
    except (TypeError, ValueError) as error:
        msg = f"{path}: its coordinates are no polygon; {_POLYGON}"
        raise InputError(msg) from error
    if len(corners) != 1:
        msg = f"the polygon in {path} has {max(len(corners) - 1, 0)} holes; a plot is one area without holes"
        raise InputError(msg)
    if not all(math.isfinite(value) for place in corners[0] for value in place):
        msg = f"{path}: a coordinate is not finite; {_POLYGON}"
        raise InputError(msg)
    return corners[0]


def _shapes(content: Any) -> list[dict[str, Any]]:
    """The geometries of a GeoJSON object; empty where it is none."""
    if not isinstance(content, dict):
        return []
    if content.get("type") == "FeatureCollection":
        features = content.get("features")
        return [shape for feature in features for shape in _shapes(feature)] if isinstance(features, list) else []
    if content.get("type") == "Feature":
        return _shapes(content.get("geometry"))
    return [content] if "coordinates" in content else []


def _kinds(shapes: list[dict[str, Any]]) -> str:
    kinds = sorted({str(shape.get("type")) for shape in shapes})
    return f" ({', '.join(kinds)})" if kinds else ""
