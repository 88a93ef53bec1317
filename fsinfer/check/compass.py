"""Words for directions: of the compass where the photos carry GNSS positions, else of the map that is drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fsinfer.io.exif import gnss_degrees

Floats = NDArray[np.float64]

#: Radius of the earth, metres. Source: format; the mean radius of geodesy.
_EARTH_M = 6_371_000.0
#: Photos, extent of the walk in metres, and share of it that the fit must explain before a direction is believed.
#: Source: judgement; a phone under leaves is 5 to 10 m off, and stays off the same way for minutes.
_MIN_PHOTOS, _MIN_EXTENT_M, _MIN_EXPLAINED = 8, 15.0, 0.75
_POINTS = ("the east", "the north-east", "the north", "the north-west", "the west", "the south-west", "the south")
COMPASS_WORDS = (*_POINTS, "the south-east")
MAP_WORDS = (
    "the right of the map",
    "the upper right of the map",
    "the top of the map",
    "the upper left of the map",
    "the left of the map",
    "the lower left of the map",
    "the bottom of the map",
    "the lower right of the map",
)


@dataclass(frozen=True, kw_only=True)
class Compass:
    """How the plan is turned for the map, and what its directions are called.

    Attributes
    ----------
    turn_deg: counter-clockwise turn from the plan to the map; the map's up is north where it is known.
    known: whether north is known.
    """

    turn_deg: float
    known: bool

    def side(self, azimuth_deg: float) -> str:
        """Words for a direction of the plan (counter-clockwise from its x axis), in eighths of a circle."""
        eighth = round((azimuth_deg + self.turn_deg) / 45) % 8
        return (COMPASS_WORDS if self.known else MAP_WORDS)[eighth]


def find_compass(cameras: Floats, places: Mapping[int, tuple[float, float]]) -> Compass:
    """Turn the map north up by GNSS, or else so that the first photo is at the bottom.

    Parameters
    ----------
    cameras: (P, 2) plan positions of the photos, metres.
    places: ``{photo: (latitude, longitude)}`` in degrees.
    """
    if len(places) >= _MIN_PHOTOS:
        ranks = np.array(sorted(places))
        degrees = np.array([places[rank] for rank in ranks])
        middle = degrees.mean(axis=0)
        north = np.radians(degrees[:, 0] - middle[0]) * _EARTH_M
        east = np.radians(degrees[:, 1] - middle[1]) * _EARTH_M * np.cos(np.radians(middle[0]))
        ours = cameras[ranks] - cameras[ranks].mean(axis=0)
        # Plan and map as complex numbers: the best turn is the angle of the sum of products.
        plan, world = ours @ [1, 1j], east + 1j * north
        together = (plan.conj() * world).sum()
        size = float(np.sqrt((np.abs(plan) ** 2).sum() * (np.abs(world) ** 2).sum()))
        extent_m = float(np.ptp(ours, axis=0).max())
        if extent_m >= _MIN_EXTENT_M and size > 0 and abs(together) / size >= _MIN_EXPLAINED:
            return Compass(turn_deg=float(np.degrees(np.angle(together))), known=True)
    start = cameras[0] - np.median(cameras, axis=0)
    return Compass(turn_deg=float(-90 - np.degrees(np.arctan2(start[1], start[0]))), known=False)


def gnss_places(photos: Sequence[Path]) -> dict[int, tuple[float, float]]:
    """``{rank: (latitude, longitude)}`` in degrees of the photos that carry a place in their EXIF."""
    found = {}
    for rank, path in enumerate(photos):
        place = gnss_degrees(path)
        if place is not None:
            found[rank] = place
    return found
