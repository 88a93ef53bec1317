"""How long a unit of coordinates is, as a frame in WKT or the GeoTIFF keys of a LAS header tell it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from fsinfer.io.crs import VERTICAL_PART

#: International foot and the foot of the US survey, metres. Source: format; EPSG registry, units 9002 and 9003.
FOOT_M, US_FOOT_M = 0.3048, 1200.0 / 3937.0
#: Codes of linear units. Source: format; EPSG registry.
_UNITS_M = {9001: 1.0, 9002: FOOT_M, 9003: US_FOOT_M}
#: Keys GTModelTypeGeoKey with its value for a frame on the map and for degrees, ProjectedCSTypeGeoKey and
#: GeographicTypeGeoKey. Source: format; GeoTIFF 1.1.
_MODEL_KEY, _ON_MAP, _OF_DEGREES, PROJECTED_KEY, GEOGRAPHIC_KEY = 1024, 1, 2, 3072, 2048
#: Keys ProjLinearUnitsGeoKey and VerticalUnitsGeoKey. Source: format; GeoTIFF 1.1.
_PROJECTED_UNIT_KEY, _VERTICAL_UNIT_KEY = 3076, 4099

# WKT 1 (OGC 01-009) writes UNIT for angles and lengths, WKT 2 (OGC 18-010r7) LENGTHUNIT, and may still write UNIT. The
# unit of the axes stands after those of ellipsoid and parameters.
_UNIT = re.compile(r'(?:LENGTH)?UNIT\s*\[\s*"[^"]*"\s*,\s*([0-9.eE+-]+)', flags=re.IGNORECASE)
_PROJECTED = re.compile(r"PROJ(?:CS|CRS|ECTEDCRS)\s*\[", flags=re.IGNORECASE)
# WKT 2 of 2015 has one word for degrees and for coordinates from the middle of the earth, which are Cartesian.
_GEOGRAPHIC = re.compile(r"\b(?:GEOGCS|GEOGCRS|GEOGRAPHICCRS|GEODCRS|GEODETICCRS)\s*\[", flags=re.IGNORECASE)
_CARTESIAN = re.compile(r"\bCS\s*\[\s*CARTESIAN", flags=re.IGNORECASE)


@dataclass(frozen=True, kw_only=True)
class LinearUnits:
    """Metres in a unit of the coordinates on the map and of the heights; None where that is not told."""

    horizontal_m: float | None = None
    vertical_m: float | None = None


def units_of_wkt(wkt: str) -> LinearUnits:
    """The units of a frame given as WKT; degrees are no length."""
    horizontal, *vertical = VERTICAL_PART.split(wkt, maxsplit=1)
    return LinearUnits(
        horizontal_m=_last_unit(horizontal) if _PROJECTED.search(horizontal) else None,
        vertical_m=_last_unit(vertical[0]) if vertical else None,
    )


def units_of_geo_keys(keys: Mapping[int, int]) -> LinearUnits:
    """The units that GeoTIFF keys name."""
    return LinearUnits(
        horizontal_m=_UNITS_M.get(keys.get(_PROJECTED_UNIT_KEY, 0)),
        vertical_m=_UNITS_M.get(keys.get(_VERTICAL_UNIT_KEY, 0)),
    )


def wkt_in_degrees(wkt: str) -> bool | None:
    """Whether x and y of a frame given as WKT are longitude and latitude; None where the text is of another kind."""
    horizontal = VERTICAL_PART.split(wkt, maxsplit=1)[0]
    if _PROJECTED.search(horizontal) or _CARTESIAN.search(horizontal):
        return False
    return True if _GEOGRAPHIC.search(horizontal) else None


def keys_on_map(keys: Mapping[int, int]) -> bool:
    """Whether GeoTIFF keys are of a frame on the map, be it one without a code: then longitude and latitude are not."""
    return keys.get(_MODEL_KEY) == _ON_MAP or keys.get(PROJECTED_KEY, 0) != 0


def keys_in_degrees(keys: Mapping[int, int]) -> bool:
    """Whether x and y are longitude and latitude by GeoTIFF keys."""
    kind = keys.get(_MODEL_KEY)
    return not keys_on_map(keys) and (kind == _OF_DEGREES or (kind is None and keys.get(GEOGRAPHIC_KEY, 0) != 0))


def _last_unit(wkt: str) -> float | None:
    found = _UNIT.findall(wkt)
    try:
        length_m = float(found[-1]) if found else 0.0
    except ValueError:
        return None
    return length_m if length_m > 0 else None
