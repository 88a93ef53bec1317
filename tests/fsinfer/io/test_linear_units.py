"""What headers say of the length of a unit."""

from __future__ import annotations

import pytest

from fsinfer.io.linear_units import FOOT_M, US_FOOT_M, LinearUnits, units_of_geo_keys, units_of_wkt

PARAMETERS = 'PARAMETER["false_easting",8202099.7],'
GEOGRAPHIC = 'GEOGCS["NAD83",DATUM["d",SPHEROID["GRS 1980",6378137,298.257]],UNIT["degree",0.0174532925199433]]'
OREGON = f'PROJCS["Oregon North",{GEOGRAPHIC},{PARAMETERS}UNIT["foot",0.3048,AUTHORITY["EPSG","9002"]],AXIS["E",EAST]]'
METRES = f'PROJCS["UTM",{GEOGRAPHIC},UNIT["metre",1,AUTHORITY["EPSG","9001"]],AUTHORITY["EPSG","26910"]]'
HEIGHTS = 'VERT_CS["NAVD88 (ftUS)",VERT_DATUM["d",2005],UNIT["US survey foot",0.304800609601219],AXIS["Up",UP]]'
WKT_2 = (
    'COMPOUNDCRS["both",PROJCRS["SPCS",BASEGEOGCRS["NAD83",DATUM["d",ELLIPSOID["GRS 1980",6378137,298.257,'
    'LENGTHUNIT["metre",1]]]],CONVERSION["c",PARAMETER["Easting at false origin",1,LENGTHUNIT["metre",1]]],'
    'CS[Cartesian,2],AXIS["easting",east],AXIS["northing",north],LENGTHUNIT["US survey foot",0.304800609601219],'
    '],VERTCRS["h",VDATUM["d"],CS[vertical,1],AXIS["up",up],LENGTHUNIT["metre",1]]]'
)


@pytest.mark.parametrize(
    ("wkt", "horizontal_m", "vertical_m"),
    [
        (OREGON, FOOT_M, None),
        (METRES, 1.0, None),
        (f'COMPD_CS["both",{METRES},{HEIGHTS}]', 1.0, US_FOOT_M),
        (WKT_2, US_FOOT_M, 1.0),
        (GEOGRAPHIC, None, None),  # degrees
        ('PROJCS["no unit"]', None, None),
        ('PROJCS["bad",UNIT["foot",0..3]]', None, None),
        ('PROJCS["bad",UNIT["foot",0]]', None, None),
        ("", None, None),
    ],
)
def test_the_unit_of_the_axes_counts(wkt: str, horizontal_m: float | None, vertical_m: float | None) -> None:
    units = units_of_wkt(wkt)
    assert units.horizontal_m == (None if horizontal_m is None else pytest.approx(horizontal_m, rel=1e-9))
    assert units.vertical_m == (None if vertical_m is None else pytest.approx(vertical_m, rel=1e-9))


def test_units_by_their_codes() -> None:
    assert units_of_geo_keys({3076: 9003, 4099: 9001}) == LinearUnits(horizontal_m=US_FOOT_M, vertical_m=1.0)
    assert units_of_geo_keys({3076: 32767}) == LinearUnits()
    assert units_of_geo_keys({}) == LinearUnits()


@pytest.mark.parametrize("version", ["WKT1_GDAL", "WKT2_2019", "WKT1_ESRI"])
def test_frames_of_the_registry(version: str) -> None:
    pyproj = pytest.importorskip("pyproj")
    for code, metres in ((2913, FOOT_M), (2269, FOOT_M), (6557, FOOT_M), (26910, 1.0), (2264, US_FOOT_M)):
        assert units_of_wkt(pyproj.CRS(f"EPSG:{code}").to_wkt(version)).horizontal_m == pytest.approx(metres, rel=1e-9)
