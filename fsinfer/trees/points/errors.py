"""How far the points of a stem may lie off its surface, by what a cloud of photographs tells of each.

A point seen from near is known to a millimetre, one seen from fifteen metres to centimetres, and both lie on the same
side of a stem. And beside the edge of a stem, as a camera sees it, depth maps go on for some centimetres before they
fall to the background: that fringe faces the camera, and not away from the stem's axis as bark does. It is what makes
stems that are seen from one side too thick. So the normal of a point counts as well as its distance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsinfer.io.cloud import DEPTH_STD, PIXEL_SIZE, PointCloud
from fsinfer.trees.points.sums import lengths
from fsinfer.trees.points.surface import sector_of

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

#: Columns of points that tell it: x, y, height, standard deviation, length of a pixel; and x and y of the normal as
#: well. Source: layout.
WITH_STD, WITH_NORMAL = 5, 7
#: Which column is which. Source: layout.
STD, PIXEL, NORMAL = 3, 4, 5
#: Noise of every point, metres, beside what it has along its line of sight. Source: chosen on three rendered plots
#: (docs/trials-accuracy.md).
SHARED_M = 0.0015
#: A normal may be off by this, as the chord between unit vectors (11 degrees); what is more is so much noise, metres
#: for a chord of one. Source: as ``SHARED_M``.
TURNED, TURNED_M = 0.2, 0.3
#: The noise of a stem's sharp points: this percentile of them. Source: judgement.
SHARP_PERCENTILE = 25.0
#: What the points of one of so many sides share of their errors, beside those of a mean, in units of one's own noise.
#: Source: chosen on six rendered plots; 0.2 to 0.5 are as good (docs/trials-accuracy.md).
SIDES, TOGETHER = 24, 0.3
#: Nearer to the axis than this, metres, no way is outward. Source: numerics.
_LEAST_M = 1e-6


@dataclass(frozen=True, kw_only=True)
class PointErrors:
    """What a cloud of photographs tells of its points.

    ``std_m`` (N,) are standard deviations along the lines of sight, metres; ``normals`` (N, 3) unit vectors towards the
    cameras, or None where they are not to be asked; ``pixel_m`` (N,) the length of a pixel of the depth maps at
    each, metres, 0 or None where that is not known.
    """

    std_m: NDArray[np.floating]
    normals: NDArray[np.floating] | None
    pixel_m: NDArray[np.floating] | None = None

    @classmethod
    def of(cls, cloud: PointCloud) -> PointErrors | None:
        """What a cloud in metres tells, as :func:`fsinfer.fusion.fuse.fuse` makes it; None where it tells nothing."""
        std = cloud.extra.get(DEPTH_STD)
        if std is None or cloud.normals is None:
            return None
        pixel = cloud.extra.get(PIXEL_SIZE)
        return cls(std_m=_lengths_of(std), normals=cloud.normals, pixel_m=None if pixel is None else _lengths_of(pixel))

    def __len__(self) -> int:
        return len(self.std_m)

    def select(self, chosen: Bools) -> PointErrors:
        """Those of ``chosen`` points (N,)."""
        return PointErrors(
            std_m=self.std_m[chosen],
            normals=None if self.normals is None else self.normals[chosen],
            pixel_m=None if self.pixel_m is None else self.pixel_m[chosen],
        )

    def beside(self, points: Floats) -> Floats:
        """Points (N, 3) with it in further columns (N, 5 or 7), in memory column by column."""
        columns = np.empty((WITH_STD if self.normals is None else WITH_NORMAL, len(points)))
        columns[:STD], columns[STD] = points.T, self.std_m
        columns[PIXEL] = 0.0 if self.pixel_m is None else self.pixel_m
        if self.normals is not None:
            columns[NORMAL:] = self.normals[:, :2].T
        return columns.T


def _lengths_of(values: NDArray[np.floating]) -> NDArray[np.floating]:
    """What is a positive number of ``values`` (N,), 0 elsewhere."""
    known = np.isfinite(values) & (values > 0)
    return np.where(known, values, np.float32(0.0))


def tells_errors(points: Floats) -> bool:
    """Whether points (N, 3, 5 or 7) have theirs beside them."""
    return bool(points.shape[1] >= WITH_STD)


def relative_errors(points: Floats, parameters: Floats, height_m: float) -> Floats:
    """Noise (N,) of a stem's points in units of that of the sharper ones.

    ``points`` (N, 5 or 7) tell it, of others (N, 3) it is 1; ``parameters`` (6,) are those of the axis at ``height_m``
    (:class:`fsinfer.trees.cylinder.axis.Axis`).
    """
    if not tells_errors(points):
        return np.ones(len(points))
    variance = SHARED_M**2 + points[:, STD] ** 2
    if points.shape[1] == WITH_NORMAL:
        variance += (TURNED_M * _turned(points, parameters, height_m)) ** 2
    noise = np.sqrt(variance)
    return np.asarray(noise / np.percentile(noise, SHARP_PERCENTILE))


def worth_of_word(points: Floats, parameters: Floats, height_m: float) -> Floats:
    """What the word of each of a stem's points (N,) counts beside its noise, where they err together: at most 1.

    The points of a side that are as sure as one another come from the same photographs, and half of what one of them
    is off by the others are off by as well: of n of them the mean is no surer than ``TOGETHER`` times one. Taken for
    independent, a thousand points from far away outvote what a section may look like. ``points`` and ``parameters`` as
    of :func:`relative_errors`.
    """
    if not tells_errors(points):
        return np.ones(len(points))
    # Alike sure: standard deviations within a factor of two.
    level = np.rint(0.5 * np.log2(1.0 + (points[:, STD] / SHARED_M) ** 2)).astype(np.int64)
    cell = level * SIDES + sector_of(_away(points, parameters, height_m), SIDES)
    count = np.bincount(cell)[cell]
    return np.asarray(1.0 / (1.0 + TOGETHER**2 * count))


def outward_of(points: Floats, parameters: Floats, height_m: float) -> Floats:
    """(N, 2) unit vectors from the axis to each point, at the point's own height; shorter ones on the axis."""
    away = _away(points, parameters, height_m)
    away /= np.maximum(lengths(away), _LEAST_M)[:, None]
    return away


def _away(points: Floats, parameters: Floats, height_m: float) -> Floats:
    """(N, 2) from the axis to each point, at the point's own height."""
    return points[:, :2] - (parameters[:2] + parameters[2:4] * (points[:, 2:3] - height_m))


def _turned(points: Floats, parameters: Floats, height_m: float) -> Floats:
    """(N,) how far normals turn away from the direction from the axis, beyond what they may."""
    outward = outward_of(points, parameters, height_m)
    along = outward[:, 0] * points[:, NORMAL] + outward[:, 1] * points[:, NORMAL + 1]
    return np.maximum(np.sqrt(np.maximum(2.0 - 2.0 * along, 0.0)) - TURNED, 0.0)
