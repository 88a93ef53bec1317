"""Sides of the plot along which no photo stands: a walk that began late, stopped early or left a part out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

Floats = NDArray[np.float64]

#: Shortest open side, metres. Source: a photo is taken every half metre; the end of a spiral comes 4.5 m short of its
#: beginning on one rendered plot that was walked all round, which is no open side; renders only.
_MIN_LENGTH_M = 5.0
#: A walk round a plot is no polygon: photos so near to its hull are on it, metres. Source: judgement.
_ON_HULL_M = 1.0


@dataclass(frozen=True, kw_only=True)
class OpenSide:
    """A stretch of the hull of the walk that no placed photo stands on.

    Attributes
    ----------
    photos: indices of the photos at its ends, in the order of walking.
    length_m: without a photo.
    edge: (2, 2) plan positions of the corners of the hull between which it lies, counter-clockwise.
    """

    photos: tuple[int, int]
    length_m: float
    edge: Floats

    def beyond(self, places: Floats) -> NDArray[np.bool_]:
        """Whether places, (N, 2), lie outside the edge, in the half disc over it: where the plot went on, if it did.

        A round plot of which no more than half was left out lies in there.
        """
        way = self.edge[1] - self.edge[0]
        reach_m = float(np.linalg.norm(way)) / 2
        offsets = np.asarray(places, dtype=np.float64).reshape(-1, 2) - self.edge.mean(axis=0)
        outwards = offsets @ [way[1], -way[0]]
        return np.asarray((outwards > 0) & (np.linalg.norm(offsets, axis=1) < reach_m))


def open_sides(cameras: Floats) -> list[OpenSide]:
    """Open sides of a walk, the longest first; ``cameras`` are the (P, 2) plan positions of the photos, metres.

    A straight walk has no inside, and so no open side.
    """
    try:
        corners = ConvexHull(cameras).vertices  # counter-clockwise
    except (QhullError, ValueError):
        return []
    found = []
    for corner, following in zip(corners, np.roll(corners, -1), strict=True):
        start, edge = cameras[corner], cameras[following] - cameras[corner]
        length = float(np.linalg.norm(edge))
        if length < _MIN_LENGTH_M:
            continue
        along = edge / length
        offsets = cameras - start
        passed = offsets @ along
        on_hull = (np.abs(offsets @ [-along[1], along[0]]) < _ON_HULL_M) & (passed > 0) & (passed < length)
        on_hull[[corner, following]] = True  # whatever rounding says of the corners themselves
        ordered = np.flatnonzero(on_hull)[np.argsort(passed[on_hull])]
        widest = int(np.diff(passed[ordered]).argmax())
        ends = ordered[widest], ordered[widest + 1]
        length = float(passed[ends[1]] - passed[ends[0]])
        if length >= _MIN_LENGTH_M:
            low, high = sorted(int(end) for end in ends)
            found.append(OpenSide(photos=(low, high), length_m=length, edge=np.array([start, start + edge])))
    return sorted(found, key=lambda side: -side.length_m)
