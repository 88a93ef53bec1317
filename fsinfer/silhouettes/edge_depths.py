"""Which edges may be a stem's own, by the depth on both sides of them.

A stem that stands before another one of the same bark has an edge on its own side and one where the other ends; and
where something stands before a stem, its edge lies inside of the stem's. Both are as strong as the stem's edge, and
from a few directions the fit may take them. The depth map parts them: just inside of a stem's edge nothing lies far
behind the stem, and just outside nothing stands before it.

Depth maps go on for some pixels beside an edge, with the nearer depth; what is nearer to an edge is not asked.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fsinfer.depth.maps import DepthMap, look_up
from fsinfer.scene import Camera
from fsinfer.silhouettes.edge_settings import EdgeSettings
from fsinfer.silhouettes.stem_axis import StemAxis

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


def may_be_edges(
    offsets_m: Floats,
    heights_m: Floats,
    right: Floats,
    pixel_m: float,
    *,
    stem: StemAxis,
    camera: Camera,
    depth_map: DepthMap,
    metres: float,
    settings: EdgeSettings,
) -> Bools:
    """Whether candidates (N,) may be edges of the stem.

    Parameters
    ----------
    offsets_m: (N,) across the stem, along the unit vector ``right`` (3,), in the plane through the axis that faces the
        camera.
    heights_m: (N,) along the axis, about breast height.
    pixel_m: one pixel of the photograph at the stem.
    camera: in metres of the cloud; ``metres`` of it make one unit of the depth map.
    """
    s, radius, side = settings, stem.radius_m, np.sign(offsets_m)

    def depths(beside_m: Floats) -> tuple[Floats, Floats]:
        """Z depth (K, N) of the plane at offsets that are so much larger (K,), and what the map has; NaN for none."""
        offset = offsets_m + beside_m[:, None] * side
        offset[offset * side < 0] = 0.0  # not beyond the axis
        points = stem.breast + heights_m[:, None] * stem.along + offset[..., None] * right
        depth, inverse, _ = look_up(points.reshape(-1, 3), camera, depth_map)
        found = np.divide(metres, inverse, out=np.full_like(inverse, np.nan), where=inverse > 0)
        return depth.reshape(offset.shape), found.reshape(offset.shape)

    plane, found = depths(-radius * np.linspace(*s.inside, s.asked))
    behind = found > plane + np.maximum(s.beyond_radii * radius, s.tolerance_of_depth * plane)
    fringe_m = s.fringe_px * depth_map.grid.reduced * pixel_m
    plane, found = depths(np.maximum(radius * np.linspace(*s.outside, s.asked), fringe_m))
    before = found < plane - radius - np.maximum(s.beyond_radii * radius, s.tolerance_of_depth * plane)
    return np.asarray(np.maximum(behind.mean(axis=0), before.mean(axis=0)) < s.against)
