"""Coordinate reference systems of clouds by their EPSG code: positions as longitude and latitude in WGS84.

Longitude and latitude and the UTM zones of WGS84 are known here; everything else takes ``pyproj`` (the extra ``gis``),
which this module alone knows.
"""

from __future__ import annotations

import logging
import math
import re
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from pyproj import CRS

Floats = NDArray[np.float64]

#: EPSG code of longitude and latitude in WGS84. Source: format; EPSG registry.
WGS84 = 4326
#: Positions may lie so far outside the area that a frame was made for, degrees: a plot at the border of two zones has
#: one of them. Source: judgement; a third of a UTM zone.
_BEYOND_AREA_DEG = 2.0
#: A transformation is told that is worse than so many metres. Source: judgement; what GNSS of a phone gives at best.
_WORTH_TELLING_M = 2.0

# WKT 1 (OGC 01-009) and WKT 2 (OGC 18-010r7): where the vertical part of a compound frame begins, and a code that is
# followed by no more than the bracket of the frame itself.
VERTICAL_PART = re.compile(r"VERT(?:_CS|CRS|ICALCRS)\s*\[", flags=re.IGNORECASE)
_LAST_CODE = re.compile(r'(?:AUTHORITY|ID)\s*\[\s*"EPSG"\s*,\s*"?(\d+)"?\s*\]\s*\]?[\s,\x00]*$', flags=re.IGNORECASE)

#: Easting and northing in a UTM zone, metres: what lies beyond has its axes the other way round. Source: judgement;
#: some countries use one zone for all, up to 800 km from its middle, which has an easting of 500 km.
_UTM_LOW, _UTM_HIGH = (-500_000.0, 0.0), (1_500_000.0, 10_000_000.0)
#: Of a cloud that was moved both are less, metres. Source: judgement; at the equator an easting of less lies 4 degrees
#: and more outside of the zone.
_LOCAL_M = 100_000.0
#: What is told of positions that cannot be in their frame.
_MOVED = "no longitude and latitude: the positions lie far from where EPSG:%d is used; has the cloud been moved?"

_log = logging.getLogger(__name__)


def to_wgs84(xy: Floats, epsg: int | None) -> Floats | None:
    """Longitude and latitude in degrees (N, 2) of positions (N, 2) in the frame ``epsg``.

    Returns
    -------
    None where that cannot be told: local metres, a frame that nobody knows, positions far from where it is used, or a
    frame for which ``pyproj`` would be needed and is not installed. But for local metres the log says why.
    """
    if epsg is None:
        return None
    if epsg == WGS84:
        return np.array(xy, dtype=np.float64)
    zone = _utm_zone(epsg)
    if zone is not None:
        outside = (xy < _UTM_LOW) | (xy > _UTM_HIGH)
        if outside.any() or (xy < _LOCAL_M).all(axis=1).any():
            _log.warning(_MOVED, epsg)
            return None
        return np.array([utm_to_wgs84(x, y, *zone) for x, y in xy.tolist()]).reshape(-1, 2)
    return _by_pyproj(xy, epsg)


def utm_to_wgs84(x_m: float, y_m: float, zone: int, south: bool) -> tuple[float, float]:
    """Longitude and latitude in degrees of a position in a UTM zone of WGS84.

    Inverse transverse Mercator by Krueger's series to the third order of n (millimetres within a zone).
    """
    a, f = 6378137.0, 1.0 / 298.257223563
    n = f / (2.0 - f)
    rectifying = a / (1.0 + n) * (1.0 + n**2 / 4.0 + n**4 / 64.0)
    xi = (y_m - (10_000_000.0 if south else 0.0)) / (0.9996 * rectifying)
    eta = (x_m - 500_000.0) / (0.9996 * rectifying)
    beta = (n / 2 - 2 * n**2 / 3 + 37 * n**3 / 96, n**2 / 48 + n**3 / 15, 17 * n**3 / 480)
    delta = (2 * n - 2 * n**2 / 3 - 2 * n**3, 7 * n**2 / 3 - 8 * n**3 / 5, 56 * n**3 / 15)
    waves = list(enumerate(beta, start=1))
    xi_, eta_ = (
        xi - sum(b * math.sin(2 * j * xi) * math.cosh(2 * j * eta) for j, b in waves),
        eta - sum(b * math.cos(2 * j * xi) * math.sinh(2 * j * eta) for j, b in waves),
    )
    conformal = math.asin(math.sin(xi_) / math.cosh(eta_))
    latitude = conformal + sum(d * math.sin(2 * j * conformal) for j, d in enumerate(delta, start=1))
    longitude = math.radians(6 * zone - 183) + math.atan2(math.sinh(eta_), math.cos(xi_))
    return math.degrees(longitude), math.degrees(latitude)


def _utm_zone(epsg: int) -> tuple[int, bool] | None:
    """Number of a UTM zone of WGS84 and whether it is south of the equator; None for other frames."""
    if 32601 <= epsg <= 32660:
        return epsg - 32600, False
    if 32701 <= epsg <= 32760:
        return epsg - 32700, True
    return None


def _by_pyproj(xy: Floats, epsg: int) -> Floats | None:
    try:
        from pyproj import CRS, Transformer
        from pyproj.exceptions import ProjError
    except ImportError:
        _log.warning(
            "EPSG:%d is no UTM zone of WGS84, so that longitude and latitude take one more package: "
            "pip install 'fsinfer[gis]'",
            epsg,
        )
        return None
    try:
        frame = CRS.from_epsg(epsg)
        # Never one that leaves the shift between the datums out: it can be hundreds of metres.
        transformer = Transformer.from_crs(frame, WGS84, always_xy=True, allow_ballpark=False)
        longitude, latitude = transformer.transform(*xy.T.tolist())
        accuracy_m = transformer.get_last_used_operation().accuracy if len(xy) else 0.0
    except ProjError as error:
        _log.warning("positions in EPSG:%d cannot be given as longitude and latitude: %s", epsg, error)
        return None
    positions = np.column_stack([longitude, latitude]).astype(np.float64)
    if not _lie_in(positions, frame):
        _log.warning(_MOVED, epsg)
        return None
    if accuracy_m > _WORTH_TELLING_M:
        _log.warning("longitude and latitude from EPSG:%d are good to %.0f m only", epsg, accuracy_m)
    return positions


def _lie_in(positions: Floats, frame: CRS) -> bool:
    if not np.isfinite(positions).all():
        return False
    area = frame.area_of_use
    if area is None or area.west > area.east:  # a frame that crosses the date line
        return True
    low = np.array([area.west, area.south]) - _BEYOND_AREA_DEG
    high = np.array([area.east, area.north]) + _BEYOND_AREA_DEG
    return bool(((positions >= low) & (positions <= high)).all())


def horizontal_epsg(wkt: str) -> int | None:
    """EPSG code of the horizontal part of a frame given as WKT; None where there is none.

    It is the code that the text names, or else, with ``pyproj``, that of the frame which it describes.
    """
    named = _epsg_in_text(wkt)
    if named is not None:
        return named
    try:
        from pyproj import CRS
        from pyproj.exceptions import ProjError
    except ImportError:
        return None
    try:
        return _horizontal(CRS.from_wkt(wkt)).to_epsg()
    except ProjError:
        return None


def _horizontal(frame: CRS) -> CRS:
    """The horizontal part of a compound frame, without a shift of its datum that the text gives."""
    while frame.is_compound or frame.is_bound:
        inner = frame.sub_crs_list[0] if frame.is_compound else frame.source_crs
        if inner is None:
            break
        frame = inner
    return frame


def _epsg_in_text(wkt: str) -> int | None:
    """The code at the very end of the horizontal part, which is its own: those of its units stand farther inside."""
    horizontal = VERTICAL_PART.split(wkt)[0]
    found = _LAST_CODE.search(horizontal)
    return None if found is None else int(found.group(1))
