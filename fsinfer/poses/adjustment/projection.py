"""Where a photo shows a point, with a lens shared by the photos of a camera and four effects of each photo's own.

A point at ``x`` in the camera of the middle row's time is seen by the row that is read at ``tau``, from -1/2 to 1/2,
at ``x + tau (omega x x + d)``: the camera turns and moves evenly while its rows are read (Hedborg, Forssén, Felsberg
and Ringaby 2012, "Rolling shutter bundle adjustment"; linearised as in Albl, Kukelova and Pajdla 2015, "R6P: rolling
shutter absolute camera pose"; angles are some milliradians). ``tau`` is that of the measured row. Rows run along the
longer side, as a phone's sensor has them whichever way it is held; which of them comes first does not matter, as motion
backwards is as likely. The lens is COLMAP's FULL_OPENCV, of which SIMPLE_RADIAL and RADIAL are special cases.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

#: Numbers of a lens: fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6. Source: format; COLMAP's FULL_OPENCV.
LENS = 12
#: Numbers of a photo's own: log of the focal length's factor, shift of the principal point (2, pixels), rotation omega
#: (3, radians over the image height) and way d (3, model units over the image height). Source: format.
OWN = 9
#: The places of these. Source: format.
FOCAL, PRINCIPAL, TURN, DRIFT = slice(0, 1), slice(1, 3), slice(3, 6), slice(6, 9)
#: Least depth before the camera, model units; what lies behind is no observation. Source: numerics.
_LEAST_DEPTH = 1e-6


def rows_axis(width_px: int | NDArray[np.int64], height_px: int | NDArray[np.int64]) -> NDArray[np.int64]:
    """Which axis of a picture, or of each of several, the rows run along, 0 for x and 1 for y: the longer."""
    return np.where(np.greater_equal(width_px, height_px), 0, 1)


def read_at(pixels: Floats, width_px: int, height_px: int) -> Floats:
    """(n,) when the rows of (n, 2) pixels, COLMAP's origin, are read: -1/2 the first, 1/2 the last."""
    across = 1 - rows_axis(width_px, height_px)
    return np.asarray(pixels[:, across] / (width_px, height_px)[across] - 0.5)


def read_at_of(pixels: Floats, sizes: NDArray[np.int64]) -> Floats:
    """As :func:`read_at`, for (n, 2) pixels of photos whose (n, 2) widths and heights are given."""
    across = 1 - rows_axis(sizes[:, 0], sizes[:, 1])
    rows = np.arange(len(pixels))
    return np.asarray(pixels[rows, across] / sizes[rows, across] - 0.5)


def moved(points: Floats, tau: Floats, own: Floats) -> Floats:
    """(n, 3) places in the cameras of their rows' times, from those at the middle row's time; ``own`` is (n, 9)."""
    return points + tau[:, None] * (np.cross(own[:, TURN], points) + own[:, DRIFT])


def project(points: Floats, tau: Floats, lens: Floats, own: Floats) -> Floats:
    """(n, 2) pixels, COLMAP's origin, of (n, 3) points in the camera of the middle row; lens (n, 12), own (n, 9)."""
    at = moved(points, tau, own)
    plane = at[:, :2] / np.maximum(at[:, 2:], _LEAST_DEPTH)
    bent, _ = _bend(plane, lens, with_jacobian=False)
    return lens[:, :2] * np.exp(own[:, FOCAL]) * bent + lens[:, 2:4] + own[:, PRINCIPAL]


def project_with_jacobians(
    points: Floats, tau: Floats, lens: Floats, own: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """As :func:`project`, and its derivatives.

    Returns
    -------
    pixels: (n, 2).
    by_point: (n, 2, 3), by the point in the camera of the middle row.
    by_own: (n, 2, 9), in the order of ``own``.
    by_lens: (n, 2, 12).
    """
    at = moved(points, tau, own)
    depth = np.maximum(at[:, 2], _LEAST_DEPTH)
    plane = at[:, :2] / depth[:, None]
    bent, by_plane = _bend(plane, lens, with_jacobian=True)
    focal = lens[:, :2] * np.exp(own[:, FOCAL])
    pixels = focal * bent + lens[:, 2:4] + own[:, PRINCIPAL]
    by_plane *= focal[:, :, None]
    by_at = np.empty((len(points), 2, 3))
    by_at[:, :, :2] = by_plane / depth[:, None, None]
    by_at[:, :, 2] = -(by_plane @ plane[:, :, None])[:, :, 0] / depth[:, None]
    by_own = np.zeros((len(points), 2, OWN))
    by_own[:, :, 0] = focal * bent
    by_own[:, 0, 1] = by_own[:, 1, 2] = 1
    by_own[:, :, DRIFT] = tau[:, None, None] * by_at
    # d(omega x x)/d(omega) v = v x x: a row j of a Jacobian becomes x x j.
    by_own[:, :, TURN] = np.cross(points[:, None, :], by_own[:, :, DRIFT])
    by_point = by_at + np.cross(by_own[:, :, DRIFT], own[:, None, TURN])
    return pixels, by_point, by_own, _by_lens(plane, bent, lens, np.exp(own[:, 0]))


def _radial(squared: Floats, lens: Floats) -> tuple[Floats, Floats]:
    """Numerator and denominator of the rational radial factor."""
    k1, k2, k3, k4, k5, k6 = lens[:, [4, 5, 8, 9, 10, 11]].T
    above = 1 + squared * (k1 + squared * (k2 + squared * k3))
    below = 1 + squared * (k4 + squared * (k5 + squared * k6))
    return above, below


def _bend(plane: Floats, lens: Floats, *, with_jacobian: bool) -> tuple[Floats, Floats]:
    """(n, 2) distorted of undistorted normalised coordinates, and (n, 2, 2) its derivative (empty unless asked for)."""
    x, y = plane.T
    p1, p2 = lens[:, 6], lens[:, 7]
    squared = x * x + y * y
    above, below = _radial(squared, lens)
    factor = above / below
    bent = np.stack(
        [
            x * factor + 2 * p1 * x * y + p2 * (squared + 2 * x * x),
            y * factor + p1 * (squared + 2 * y * y) + 2 * p2 * x * y,
        ],
        axis=1,
    )
    if not with_jacobian:
        return bent, np.empty((0, 2, 2))
    k1, k2, k3, k4, k5, k6 = lens[:, [4, 5, 8, 9, 10, 11]].T
    slope_above = k1 + squared * (2 * k2 + 3 * squared * k3)
    slope_below = k4 + squared * (2 * k5 + 3 * squared * k6)
    slope = (slope_above - factor * slope_below) / below
    jacobian = np.empty((len(plane), 2, 2))
    jacobian[:, 0, 0] = factor + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
    jacobian[:, 0, 1] = jacobian[:, 1, 0] = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
    jacobian[:, 1, 1] = factor + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
    return bent, jacobian


def _by_lens(plane: Floats, bent: Floats, lens: Floats, factor: Floats) -> Floats:
    x, y = plane.T
    squared = x * x + y * y
    above, below = _radial(squared, lens)
    by_lens = np.zeros((len(plane), 2, LENS))
    by_lens[:, 0, 0], by_lens[:, 1, 1] = factor * bent[:, 0], factor * bent[:, 1]
    by_lens[:, 0, 2] = by_lens[:, 1, 3] = 1
    focal = lens[:, :2] * factor[:, None]
    radial = focal * plane
    for column, power in ((4, 1), (5, 2), (8, 3)):
        by_lens[:, :, column] = radial * (squared**power / below)[:, None]
    for column, power in ((9, 1), (10, 2), (11, 3)):
        by_lens[:, :, column] = -radial * (above * squared**power / below**2)[:, None]
    by_lens[:, 0, 6], by_lens[:, 1, 6] = focal[:, 0] * 2 * x * y, focal[:, 1] * (squared + 2 * y * y)
    by_lens[:, 0, 7], by_lens[:, 1, 7] = focal[:, 0] * (squared + 2 * x * x), focal[:, 1] * 2 * x * y
    return by_lens
