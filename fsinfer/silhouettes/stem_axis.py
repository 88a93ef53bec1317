"""Where a stem is looked for in the photographs: its axis about breast height."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fsinfer.scene import Camera
from fsinfer.trees.cylinder.axis import LEAST_RADIUS_M

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class StemAxis:
    """A stem about breast height in the frame of the cloud, metres.

    ``breast`` (3,) lies on the axis, ``along`` (3,) is its unit vector upwards, ``radius_m`` and ``taper`` (dr/dh) are
    what is known of it so far.
    """

    breast: Floats
    along: Floats
    radius_m: float
    taper: float

    @property
    def across(self) -> tuple[Floats, Floats]:
        """Two unit vectors (3,) across the axis; edges' angles are counted from the first to the second.

        The first is the leaning x axis, as in :func:`fsinfer.trees.cylinder.axis.axis_coordinates`.
        """
        first = np.array([1.0, 0.0, 0.0]) - self.along[0] * self.along
        first /= np.linalg.norm(first)
        return first, np.cross(self.along, first)

    def moved(self, shift_m: Floats, radius_m: float) -> StemAxis:
        """The axis ``shift_m`` (2,) from this one, along its two directions across, of a stem of ``radius_m``."""
        first, second = self.across
        breast = self.breast + shift_m[0] * first + shift_m[1] * second
        return replace(self, breast=breast, radius_m=max(float(radius_m), LEAST_RADIUS_M))


def facing(stem: StemAxis, camera: Camera) -> tuple[Floats, Floats, float]:
    """Unit vectors (3,) across the axis, to the camera's right and towards it, and the camera's distance."""
    offset = camera.center - stem.breast
    level = offset - (offset @ stem.along) * stem.along
    distance = float(np.linalg.norm(level))
    towards = level / max(distance, 1e-9)
    return np.cross(stem.along, towards), towards, distance
