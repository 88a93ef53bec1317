"""Which edges of a stem a photograph shows: where it stands in the picture, and what stands before it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fsinfer.depth.maps import DepthMap, seen_and_hidden
from fsinfer.scene import Camera, project
from fsinfer.silhouettes.edge_settings import EdgeSettings
from fsinfer.silhouettes.stem_axis import StemAxis, facing

Floats = NDArray[np.float64]


#: Points of the near side by which it is told whether it is hidden: along the stem and across it, the latter up to
#: this share of the radius. Source: numerics.
SIDE_POINTS, SIDE_OF_RADIUS = (9, 5), 0.6
#: A camera nearer than this to a stem, in radii and metres, or of which it is less deep, sees it too slanted.
#: Source: numerics.
NEAREST_RADII, NEAREST_M, LEAST_DEPTH_M = 2.5, 0.5, 0.3
#: Both edges must lie inside the photograph with this much room, in radii and pixels, and above and below in pixels;
#: one edge by itself with so many radii, and with the last on all sides. Source: not recorded.
ROOM_RADII, ROOM_PX, ROOM_ABOVE_PX = 1.3, 3.0, 5
#: Left and right of the axis. Source: convention.
BOTH_SIDES = (-1.0, 1.0)
#: Of a half that is looked at by itself: points across it, from and to this share of the radius, and how far the depth
#: map may be off, in radii. Source: judgement.
HALF_POINTS, HALF_RANGE, HALF_TOLERANCE = 6, (0.2, 0.9), 0.5
#: What may be in reach is told with so much to spare, metres: rounding decides nothing. Source: numerics.
_REACH_MARGIN_M = 1e-6


def in_reach(stem: StemAxis, camera: Camera, s: EdgeSettings) -> bool:
    """Whether the camera is far enough from the stem, and near enough for its size."""
    _, _, distance = facing(stem, camera)
    depth = float(project(stem.breast, camera)[1])
    nearest = max(NEAREST_RADII * stem.radius_m, NEAREST_M)
    if not nearest <= distance <= s.max_distance_m or depth < LEAST_DEPTH_M:
        return False
    return float(camera.intrinsic[0, 0]) * stem.radius_m / depth >= s.min_radius_px


def stems_in_reach(stems: Sequence[StemAxis], camera: Camera, s: EdgeSettings) -> list[int]:
    """Numbers of the stems that are :func:`in_reach`.

    Those far from it are told all at once: each by itself, a hectare's take minutes in 1,500 photographs.
    """
    if not stems:
        return []
    breast, along = (np.array([getattr(stem, name) for stem in stems]) for name in ("breast", "along"))
    radius = np.array([stem.radius_m for stem in stems])
    offset = camera.center - breast
    distance = np.linalg.norm(offset - (offset * along).sum(axis=1)[:, None] * along, axis=1)
    depth = project(breast, camera)[1]
    may_be = (distance <= s.max_distance_m + _REACH_MARGIN_M) & (depth >= LEAST_DEPTH_M - _REACH_MARGIN_M)
    may_be &= float(camera.intrinsic[0, 0]) * radius >= s.min_radius_px * (depth - _REACH_MARGIN_M)
    return [number for number in np.flatnonzero(may_be).tolist() if in_reach(stems[number], camera, s)]


def sides_shown(
    stem: StemAxis, camera: Camera, size: Floats, depth_map: DepthMap, metres: float, s: EdgeSettings
) -> tuple[float, ...]:
    """The sides of the stem whose edges the photograph shows: both, one, or none.

    Where both halves are seen and the stem is not, something stands before its middle.
    """
    if _inside(stem, camera, size) and _unhidden(stem, camera, depth_map, metres, s):
        return BOTH_SIDES
    halves = tuple(side for side in BOTH_SIDES if _shows_half(side, stem, camera, size, depth_map, metres, s))
    return () if halves == BOTH_SIDES else halves


def _shows_half(
    side: float, stem: StemAxis, camera: Camera, size: Floats, depth_map: DepthMap, metres: float, s: EdgeSettings
) -> bool:
    """Whether one edge lies well inside the photograph, and the depth map shows the half of the near side before it."""
    right, _, _ = facing(stem, camera)
    height = np.linspace(-s.half_length_m, s.half_length_m, SIDE_POINTS[0])[:, None]
    edge = stem.breast + height * stem.along + ROOM_RADII * side * stem.radius_m * right
    pixel, depth = project(edge, camera)
    room = ROOM_ABOVE_PX
    if not (np.all(depth > LEAST_DEPTH_M) and np.all((pixel >= room) & (pixel <= size - room))):
        return False
    across = side * np.linspace(*HALF_RANGE, HALF_POINTS)
    seen, hidden = _seen_and_hidden(across, HALF_TOLERANCE * stem.radius_m, stem, camera, depth_map, metres, s)
    return seen >= s.half_seen and hidden <= s.max_hidden


def _inside(stem: StemAxis, camera: Camera, size: Floats) -> bool:
    """Whether both edges at breast height lie well inside the photograph of ``size`` (2,)."""
    pixel, depth = project(stem.breast, camera)
    reach = ROOM_RADII * float(camera.intrinsic[0, 0]) * stem.radius_m / float(depth) + ROOM_PX
    room = np.array([reach, ROOM_ABOVE_PX])
    return bool(np.all((pixel >= room) & (pixel <= size - room)))


def _unhidden(stem: StemAxis, camera: Camera, depth_map: DepthMap, metres: float, s: EdgeSettings) -> bool:
    """Whether the depth map shows the near side of the stem where it is, and little before it."""
    across = np.linspace(-SIDE_OF_RADIUS, SIDE_OF_RADIUS, SIDE_POINTS[1])
    seen, hidden = _seen_and_hidden(across, stem.radius_m, stem, camera, depth_map, metres, s)
    return seen >= s.min_seen and hidden <= s.max_hidden


def _seen_and_hidden(
    across: Floats,
    tolerance_m: float,
    stem: StemAxis,
    camera: Camera,
    depth_map: DepthMap,
    metres: float,
    s: EdgeSettings,
) -> tuple[float, float]:
    """Shares of the near side that the depth map shows where it is, and that something nearer hides.

    Looked at are points ``across`` the stem (shares of the radius, to the right) along the strip's length.
    """
    right, towards, _ = facing(stem, camera)
    height, side = np.meshgrid(np.linspace(-s.half_length_m, s.half_length_m, SIDE_POINTS[0]), across)
    height, side = height.reshape(-1, 1), side.reshape(-1, 1)
    surface = stem.radius_m * (side * right + np.sqrt(1.0 - side**2) * towards)
    points = stem.breast + height * stem.along + surface
    tolerance = np.maximum(tolerance_m, s.tolerance_of_depth * project(points, camera)[1])
    return seen_and_hidden(points, tolerance, camera, depth_map, units_per_scene_unit=metres)
