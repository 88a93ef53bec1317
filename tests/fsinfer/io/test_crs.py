"""Longitude and latitude of positions in the frames that clouds come in, with and without pyproj."""

from __future__ import annotations

import struct
import sys
from pathlib import Path

import numpy as np
import pytest

from fsinfer.io.cloud import PointCloud, write_cloud
from fsinfer.io.crs import horizontal_epsg, to_wgs84, utm_to_wgs84
from fsinfer.io.las import read_epsg

# Metres of a degree on the ground, at most.
DEGREE_M = 111_700.0


@pytest.mark.parametrize(
    ("epsg", "x_m", "y_m", "longitude", "latitude"),
    [
        # The central meridian and the equator are where the projection says; 84 and 0 degrees check the two ends.
        (32632, 500_000.0, 0.0, 9.0, 0.0),
        (32732, 500_000.0, 10_000_000.0, 9.0, 0.0),
        # One degree of the equator east of the meridian: 0.9996 a (lambda + lambda^3 (1 - e'^2...)/6): 611,280.8 m.
        (32632, 611_280.7, 0.0, 10.0, 0.0),
        # Meridian arc to 45 degrees on WGS84 is 4,984,944.38 m, times 0.9996.
        (32632, 500_000.0, 4_984_944.378 * 0.9996, 9.0, 45.0),
        (4326, 11.5, 48.1, 11.5, 48.1),
    ],
)
def test_utm_to_longitude_and_latitude(epsg: int, x_m: float, y_m: float, longitude: float, latitude: float) -> None:
    positions = to_wgs84(np.array([[x_m, y_m]]), epsg)
    assert positions is not None
    assert positions.tolist() == [[pytest.approx(longitude, abs=2e-5), pytest.approx(latitude, abs=1e-7)]]


def test_own_formulas_and_pyproj_agree_to_two_millimetres() -> None:
    pyproj = pytest.importorskip("pyproj")
    rng = np.random.default_rng(3)
    for zone, south in ((1, False), (32, False), (33, True), (60, True)):
        x_m = rng.uniform(200_000.0, 800_000.0, 200)
        y_m = rng.uniform(100_000.0, 9_300_000.0, 200)
        transformer = pyproj.Transformer.from_crs(32700 + zone if south else 32600 + zone, 4326, always_xy=True)
        expected = np.column_stack(transformer.transform(x_m, y_m))
        own = np.array([utm_to_wgs84(x, y, zone, south) for x, y in zip(x_m, y_m, strict=True)])
        # Longitudes beyond the date line count on in one and start again in the other.
        difference = (own - expected + 180.0) % 360.0 - 180.0
        difference[:, 0] *= np.cos(np.radians(expected[:, 1]))
        assert np.abs(difference).max() * DEGREE_M < 0.002


@pytest.mark.parametrize(
    ("epsg", "x_m", "y_m", "longitude", "latitude", "within_m"),
    [
        # A place in ETRS89 is that of WGS84 to the drift of the continent, which is less than a metre.
        (25832, 691_600.0, 5_334_700.0, *utm_to_wgs84(691_600.0, 5_334_700.0, 32, False), 0.01),
        (25833, 400_000.0, 5_800_000.0, *utm_to_wgs84(400_000.0, 5_800_000.0, 33, False), 0.01),
        # Where the frames' authorities put their origins: Lambert-93, and the observatory of Bern (swisstopo).
        (2154, 700_000.0, 6_600_000.0, 3.0, 46.5, 1.0),
        (2056, 2_600_000.0, 1_200_000.0, 7.438632, 46.951083, 2.0),
    ],
)
def test_other_frames_by_pyproj(
    epsg: int, x_m: float, y_m: float, longitude: float, latitude: float, within_m: float
) -> None:
    pytest.importorskip("pyproj")
    positions = to_wgs84(np.array([[x_m, y_m], [x_m, y_m]]), epsg)
    assert positions is not None
    assert positions.shape == (2, 2)
    assert np.abs(positions - [longitude, latitude]).max() * DEGREE_M < within_m
    empty = to_wgs84(np.zeros((0, 2)), epsg)
    assert empty is not None
    assert empty.shape == (0, 2)


def test_gauss_krueger_tells_how_good_it_is(caplog: pytest.LogCaptureFixture) -> None:
    pytest.importorskip("pyproj")
    with caplog.at_level("WARNING"):
        positions = to_wgs84(np.array([[4_468_000.0, 5_334_700.0]]), 31468)
    assert positions is not None
    assert positions[0].tolist() == [pytest.approx(11.568, abs=0.01), pytest.approx(48.149, abs=0.01)]
    assert "EPSG:31468 are good to" in caplog.text


@pytest.mark.parametrize("place", [(-32_000.0, 6_740_000.0), (1_265_000.0, 4_500_000.0)])
def test_a_country_may_use_one_zone_beyond_its_border(place: tuple[float, float]) -> None:
    assert to_wgs84(np.array([place]), 32632) is not None


@pytest.mark.parametrize("place", [(5.0, 7.0), (5_240_000.0, 500_000.0), (500_000.0, -3.0)])
def test_places_that_no_utm_zone_has_were_moved(place: tuple[float, float], caplog: pytest.LogCaptureFixture) -> None:
    assert to_wgs84(np.array([place]), 32632) is None
    assert "has the cloud been moved?" in caplog.text


def test_what_cannot_be_told_is_left_out_with_a_reason(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    local = np.array([[1.0, 2.0]])
    assert to_wgs84(local, None) is None
    assert caplog.text == ""
    monkeypatch.setitem(sys.modules, "pyproj", None)
    assert to_wgs84(local, 25832) is None
    assert "pip install 'fsinfer[gis]'" in caplog.text
    assert to_wgs84(np.array([[500_000.0, 0.0]]), 32632) is not None
    monkeypatch.undo()
    pytest.importorskip("pyproj")
    assert to_wgs84(local, 25832) is None
    assert "far from where EPSG:25832 is used" in caplog.text
    assert to_wgs84(local, 99999) is None
    assert "EPSG:99999 cannot be given as longitude and latitude" in caplog.text


GEOGRAPHIC = 'GEOGCS["WGS 84",DATUM["W",SPHEROID["W",6378137,298.257]],UNIT["d",0.01745],AUTHORITY["EPSG","4326"]]'
UTM = (
    f'PROJCS["WGS 84 / UTM zone 32N",{GEOGRAPHIC},PROJECTION["Transverse_Mercator"],PARAMETER["central_meridian",9],'
    'PARAMETER["latitude_of_origin",0],PARAMETER["scale_factor",0.9996],PARAMETER["false_easting",500000],'
    'PARAMETER["false_northing",0],UNIT["metre",1,AUTHORITY["EPSG","9001"]]'
)
NAMED = f'{UTM},AUTHORITY["EPSG","32632"]]'
HEIGHTS = 'VERT_CS["h",VERT_DATUM["h",2005],UNIT["metre",1],AUTHORITY["EPSG","7837"]]'


@pytest.mark.parametrize("with_pyproj", [True, False])
@pytest.mark.parametrize(
    ("wkt", "epsg"),
    [
        (NAMED, 32632),
        (f'COMPD_CS["both",{NAMED},{HEIGHTS}]', 32632),
        (f'COMPD_CS["both",{NAMED},{HEIGHTS},AUTHORITY["EPSG","5555"]]', 32632),
        (GEOGRAPHIC, 4326),
        # A code of a unit is not that of the frame.
        (UTM.replace("500000", "123456") + "]", None),
        ("nothing[", None),
    ],
)
def test_the_code_of_a_text_is_that_of_its_horizontal_part(
    wkt: str, epsg: int | None, with_pyproj: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if with_pyproj:
        pytest.importorskip("pyproj")
    else:
        monkeypatch.setitem(sys.modules, "pyproj", None)
    assert horizontal_epsg(wkt) == epsg


@pytest.mark.parametrize("code", ["EPSG:25832", "EPSG:25832+7837", "EPSG:2154"])
def test_texts_that_pyproj_writes_are_read_without_it(code: str, monkeypatch: pytest.MonkeyPatch) -> None:
    pyproj = pytest.importorskip("pyproj")
    frame = pyproj.CRS(code)
    texts = [frame.to_wkt(version) for version in ("WKT1_GDAL", "WKT2_2019", "WKT2_2015")]
    expected = int(code.partition(":")[2].partition("+")[0])
    assert [horizontal_epsg(text) for text in texts] == [expected] * 3
    monkeypatch.setitem(sys.modules, "pyproj", None)
    assert [horizontal_epsg(text) for text in texts] == [expected] * 3


def test_a_frame_without_a_code_is_known_to_pyproj_by_what_it_says(monkeypatch: pytest.MonkeyPatch) -> None:
    pyproj = pytest.importorskip("pyproj")
    wkt = pyproj.CRS("EPSG:25832").to_wkt("WKT1_ESRI")
    assert "25832" not in wkt
    assert horizontal_epsg(wkt) == 25832
    shifted = pyproj.CRS("+proj=utm +zone=32 +ellps=bessel +towgs84=598,73,418,0.2,0.04,-2.4,6.7").to_wkt()
    assert horizontal_epsg(shifted) is None
    monkeypatch.setitem(sys.modules, "pyproj", None)
    assert horizontal_epsg(wkt) is None


def test_a_las_without_a_frame_has_no_epsg(tmp_path: Path) -> None:
    write_cloud(tmp_path / "cloud.laz", PointCloud(xyz=np.random.default_rng(0).uniform(0, 1, (10, 3))))
    assert read_epsg(tmp_path / "cloud.laz") is None


def test_epsg_from_geotiff_keys(tmp_path: Path) -> None:
    import laspy

    path = tmp_path / "utm.las"
    header = laspy.LasHeader(point_format=3, version="1.2")
    header.vlrs.append(laspy.vlrs.known.GeoKeyDirectoryVlr())
    directory = header.vlrs[-1]
    directory.parse_record_data(struct.pack("<12H", 1, 1, 0, 2, 1024, 0, 1, 1, 3072, 0, 1, 32632))
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = np.zeros((3, 4))
    cloud.write(path)
    assert read_epsg(path) == 32632
    again = tmp_path / "again.laz"
    write_cloud(again, PointCloud(xyz=np.zeros((4, 3))), frame_of=path)
    assert read_epsg(again) == 32632


@pytest.mark.parametrize("with_pyproj", [True, False])
def test_epsg_from_a_text_in_the_header(tmp_path: Path, with_pyproj: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    import laspy

    path = tmp_path / "utm.laz"
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(f'COMPD_CS["both",{NAMED},{HEIGHTS}]'))
    header.global_encoding.wkt = True
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = np.zeros((3, 4))
    cloud.write(path)
    if not with_pyproj:
        monkeypatch.setitem(sys.modules, "pyproj", None)
    assert read_epsg(path) == 32632
    again = tmp_path / "again.laz"
    write_cloud(again, PointCloud(xyz=np.zeros((4, 3))), frame_of=path)
    assert read_epsg(again) == 32632
    with laspy.open(again) as reader:
        assert reader.header.global_encoding.wkt
