"""From what the user asked for to a border in the cloud, or why there is none."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from fsinfer.notices.notice import Notice, notice
from fsinfer.notices.plots import PlotCode
from fsinfer.plot_border.border import Border
from fsinfer.plot_border.request import BorderRequest

Floats = NDArray[np.float64]
#: A board that is found twice so far apart or less is one board, metres. Source: judgement; several times the error of
#: a board's place.
SAME_PLACE_M = 0.5


def place_border(
    request: BorderRequest,
    *,
    cameras_xy: Floats | None,
    markers: Sequence[tuple[int, tuple[float, float]]] = (),
) -> Border | Notice:
    """The border in the frame of the cloud; a notice says why it cannot be placed.

    Parameters
    ----------
    request: a border, ``request.given``.
    cameras_xy: (V, 2) places of the photographs, metres; None where there are none.
    markers: number and place x, y of each board that was found.
    """
    if request.polygon:
        return Border(corners=request.polygon, origin="polygon", moves_along=False)
    if request.center is not None:
        return Border(center=request.center, radius_m=request.radius_m, origin="coordinate", moves_along=False)
    if request.marker is not None:
        places = np.array([place for number, place in markers if number == request.marker]).reshape(-1, 2)
        if len(places) == 0:
            found = ", ".join(str(number) for number in sorted({number for number, _ in markers})) or "none"
            return notice(PlotCode.no_such_marker, number=request.marker, found=found)
        apart_m = float(np.linalg.norm(places - places[0], axis=1).max())
        if apart_m > SAME_PLACE_M:
            return notice(PlotCode.marker_twice, number=request.marker, apart_m=apart_m)
        x, y = places.mean(axis=0).tolist()
        return Border(center=(x, y), radius_m=request.radius_m, origin=f"marker {request.marker}", moves_along=True)
    if cameras_xy is None or len(cameras_xy) == 0:
        return notice(PlotCode.no_walk)
    x, y = middle_of_walk(cameras_xy).tolist()
    return Border(center=(x, y), radius_m=request.radius_m, origin="walk", moves_along=True)


def middle_of_walk(cameras_xy: Floats) -> Floats:
    """Middle (2,) of the area that the places of photographs (V, 2) enclose.

    The mean of the places would lie where most photographs were taken. Where they enclose nothing it is their mean.
    """
    try:
        hull = cameras_xy[ConvexHull(cameras_xy).vertices]
    except (QhullError, ValueError):
        return np.asarray(cameras_xy.mean(axis=0))
    offset = hull - hull[0]
    nexts = np.roll(offset, -1, axis=0)
    doubled = offset[:, 0] * nexts[:, 1] - nexts[:, 0] * offset[:, 1]
    # Centroid of a polygon, by the triangles that its sides make with the first corner.
    return np.asarray(hull[0] + ((offset + nexts) * doubled[:, None]).sum(axis=0) / (3.0 * doubled.sum()))
