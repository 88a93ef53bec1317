"""What a depth map takes off a stem by averaging over patches.

The depth of a pixel is that of a patch of them. A patch of a plane has its middle's, but bark bends away from the
camera on both sides of it: over a patch with the standard deviation s along a circle of the radius R the mean lies by
s^2 / 2R behind the surface (the second-order term of the arc's sagitta). From six metres that makes a stem of 10 cm
two millimetres thinner. What is known of the patch and of the stem is put back before the stem is measured.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fsinfer.trees.points.errors import PIXEL, outward_of, tells_errors

Floats = NDArray[np.float64]

#: Standard deviation of the patch that a depth is the mean of, pixels of the depth map: of the photograph it is as much
#: more as that was reduced. Source: depth maps of stems of a rendered plot with its true cameras
#: (docs/trials-accuracy.md).
PATCH_PX = 0.85
#: A patch is no larger than this share of the radius: beyond it the arc is no parabola. Source: geometry.
MOST_OF_RADIUS = 0.5


def unsmoothed(points: Floats, parameters: Floats, height_m: float) -> Floats:
    """Points (N, 3, 5 or 7) where the surface of a stem is rather than where depth maps have it.

    ``parameters`` (6,) are those of the axis at ``height_m`` (:class:`fsinfer.trees.cylinder.axis.Axis`). Points of
    clouds that do not tell how large a pixel is are returned as they are.
    """
    if not tells_errors(points):
        return points
    radius = float(parameters[4])
    patch = np.minimum(PATCH_PX * points[:, PIXEL], MOST_OF_RADIUS * radius)
    outward = outward_of(points, parameters, height_m)
    moved = points.copy(order="K")
    moved[:, :2] += outward * (patch**2 / (2.0 * radius))[:, None]
    return moved
