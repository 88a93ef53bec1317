"""Where on earth a plot lies: what its photographs say."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from pathlib import Path

from fsinfer.io.exif import gnss_degrees
from fsinfer.io.photo_folders import PHOTO_SUFFIXES

#: Photographs of a plot that are asked, evenly spread. Source: judgement; their median is good to some metres, as
#: each of them is.
MOST_ASKED = 25


def place_of_photos(files: Sequence[Path]) -> tuple[float, float] | None:
    """Latitude and longitude in degrees (WGS84): the median of the photographs'; None where none carries a place."""
    photos = sorted(path for path in files if path.suffix.lower() in PHOTO_SUFFIXES)
    asked = photos[:: -(-len(photos) // MOST_ASKED)] if photos else []
    places = [place for place in map(gnss_degrees, asked) if place is not None]
    if not places:
        return None
    # A walk that crosses the meridian of 180 degrees would have its median on the other side of the earth.
    east = [longitude + 360.0 if places[0][1] - longitude > 180.0 else longitude for _, longitude in places]
    longitude = statistics.median(east)
    return statistics.median(latitude for latitude, _ in places), longitude - 360.0 if longitude > 180.0 else longitude
