"""Geometric consistency of two depth maps: does view s see the surface that view r says is there?

Frames: maps have pixel centres at integers, ``x_cam = R x_world + t``. A pixel (u, v) of r with depth z is projected
into s, the depth of s is looked up there, and that point of s is projected back into r. What is left is the
reprojection error in pixels of the map and the difference of the depths (Yao et al. 2018, MVSNet, section 4.2).
The graded tolerances follow the dynamic consistency checking of Yan et al. 2020 (D2HC-RMVSNet), section 3.3.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fsinfer.depth.maps import DepthMap

#: Levels of the tolerances. Source: D2HC-RMVSNet (Yan et al. 2020, section 3.3) grades by the number of views.
LEVELS = 10
#: Of a pixel that no level holds. Source: format; the last value of a byte.
NO_LEVEL = 255
#: Width of the table in which scattered lookups are handed to cv2.remap: its height must stay below 32767. Source:
#: numerics.
_REMAP_WIDTH = 2048
#: Where bilinear and nearest lookup differ by more than this part, the four pixels lie on two surfaces (or one has no
#: depth): the mixture is on neither, so the nearest one counts. Source: judgement.
_SAME_SURFACE = 0.01
#: Nearer than this part of the depth to the plane of a camera counts as behind it. Source: numerics.
_BEHIND = 1e-6
#: Least baseline times focal length. Source: numerics.
_LEAST_BASELINE = 1e-12


@dataclass(frozen=True, kw_only=True)
class Tolerances:
    """Tolerances of level i = 1 ... 10 are i times these steps.

    Attributes
    ----------
    reprojection_step_px: in pixels of the depth map. Source: D2HC-RMVSNet (i/2).
    relative_depth_step: part of the depth. Source: D2HC-RMVSNet grades alike; this step is judgement.
    disparity_step_px: no tolerance is tighter than a matching error of so many map pixels means for the baseline of
        the pair, because what is below the noise of a pair says nothing: z / (f b) * disparity_step_px. Capped at
        ``relative_depth_step_max``. Source: matching is precise to 0.1-0.3 px, which level 2 to 5 reach.
    relative_depth_step_max: see above. Source: judgement.
    seen_through: a confident depth of the other view that lies behind the point by more than so many times the
        tolerance of level 10, all around, says that the point floats in empty space. Source: judgement.
    """

    reprojection_step_px: float = 0.5
    relative_depth_step: float = 1e-3
    disparity_step_px: float = 0.06
    relative_depth_step_max: float = 4e-3
    seen_through: float = 1.5


@dataclass(frozen=True, kw_only=True)
class PairEvidence:
    """What view s says of N pixels of view r.

    Attributes
    ----------
    level: (N,) uint8, lowest level 1..10 within whose tolerances s agrees; 255 where it does not.
    depth: (N,) float32, depth in r of the point that s sees (0 where s says nothing).
    confidence: (N,) float32 of s there.
    seen_through: (N,) bool, s looks through the point onto something clearly behind it.
    """

    level: NDArray[np.uint8]
    depth: NDArray[np.float32]
    confidence: NDArray[np.float32]
    seen_through: NDArray[np.bool_]


def depth_tolerance_step(reference: DepthMap, source: DepthMap, tolerances: Tolerances) -> float:
    """Return k such that the relative depth tolerance of one level is ``clip(k * z, lowest, highest)``."""
    baseline = float(np.linalg.norm(source.center - reference.center))
    return tolerances.disparity_step_px / max(float(source.intrinsic[0, 0]) * baseline, _LEAST_BASELINE)


def check_pair(
    reference: DepthMap,
    source: DepthMap,
    u: NDArray[np.float32],
    v: NDArray[np.float32],
    depth: NDArray[np.float32],
    *,
    tolerances: Tolerances,
    min_confidence: float,
) -> PairEvidence:
    """Compare N pixels of ``reference`` with ``source``, vectorized; :func:`check_pixel` is its plain equivalent.

    Parameters
    ----------
    u, v, depth: (N,) float32, pixels of the reference map with z depth > 0.
    min_confidence: the source says nothing where it is less sure.
    """
    relative = source.cam_from_world @ np.linalg.inv(reference.cam_from_world)
    forth = source.intrinsic @ relative[:3, :3] @ np.linalg.inv(reference.intrinsic)
    back = np.linalg.inv(forth)
    shift = source.intrinsic @ relative[:3, 3]
    height, width = source.inverse_depth.shape
    x, y, z = _map_rays(forth, u, v, depth, shift)
    ahead = z > _BEHIND * depth
    safe = np.where(ahead, z, np.float32(1))
    su, sv = x / safe, y / safe
    inside = ahead & (su >= 0) & (su <= width - 1) & (sv >= 0) & (sv <= height - 1)
    su, sv = np.where(inside, su, np.float32(0)), np.where(inside, sv, np.float32(0))
    # Looked up by their number in the map, which takes a third of what rows and columns take.
    pixel = (np.rint(sv).astype(np.int32) * np.int32(width) + np.rint(su).astype(np.int32)).astype(np.intp)
    nearest = source.inverse_depth.take(pixel)
    confidence = source.confidence.take(pixel)
    linear = _remap(source.inverse_depth, su, sv)
    inverse = np.where(np.abs(linear - nearest) <= _SAME_SURFACE * nearest, linear, nearest)
    known = inside & (nearest > 0) & (confidence >= min_confidence)
    found = np.float32(1) / np.where(known, inverse, np.float32(1))
    # Back into the reference: K_r R^T (K_s^-1 z_s p_s - t) = back (z_s p_s - shift).
    bx, by, bz = _map_rays(back, su, sv, found, -(back @ shift))
    known &= bz > _BEHIND * depth
    bz = np.where(known, bz, np.float32(1))
    error = _length(bx / bz - u, by / bz - v) / np.float32(tolerances.reprojection_step_px)
    step = np.clip(
        depth_tolerance_step(reference, source, tolerances) * depth,
        tolerances.relative_depth_step,
        max(tolerances.relative_depth_step_max, tolerances.relative_depth_step),
    ).astype(np.float32)
    score = np.ceil(np.maximum(error, np.abs(bz - depth) / (depth * step)))
    agrees = known & (score <= LEVELS)
    level = np.where(agrees, np.maximum(score, 1), NO_LEVEL).astype(np.uint8)
    # Every pixel round it must look past the point.
    front = source.nearest_around.take(pixel)
    through = known & (front * z * (1 + np.float32(tolerances.seen_through * LEVELS) * step) < 1)
    return PairEvidence(
        level=level,
        depth=np.where(known, bz, 0).astype(np.float32),
        confidence=np.where(known, confidence, 0).astype(np.float32),
        seen_through=through,
    )


def check_pixel(
    reference: DepthMap, source: DepthMap, u: float, v: float, depth: float, *, tolerances: Tolerances
) -> tuple[int, float]:
    """Return (level, depth in the reference) of one pixel: the plain NumPy form of :func:`check_pair`.

    Level 255 and depth 0 where the source says nothing. Confidence and seen-through are left out.
    """
    world_from_reference = np.linalg.inv(reference.cam_from_world)
    in_reference = np.append(depth * (np.linalg.inv(reference.intrinsic) @ [u, v, 1.0]), 1.0)
    in_source = source.cam_from_world @ world_from_reference @ in_reference
    projected = source.intrinsic @ in_source[:3]
    if projected[2] <= 0:
        return NO_LEVEL, 0.0
    su, sv = projected[:2] / projected[2]
    height, width = source.inverse_depth.shape
    if not (0 <= su <= width - 1 and 0 <= sv <= height - 1):
        return NO_LEVEL, 0.0
    nearest = float(source.inverse_depth[round(sv), round(su)])
    if nearest == 0:
        return NO_LEVEL, 0.0
    u0, v0 = math.floor(su), math.floor(sv)
    linear = 0.0
    for du, dv in ((0, 0), (1, 0), (0, 1), (1, 1)):
        weight = (1 - abs(su - u0 - du)) * (1 - abs(sv - v0 - dv))
        if u0 + du < width and v0 + dv < height:
            linear += weight * float(source.inverse_depth[v0 + dv, u0 + du])
    inverse = linear if abs(linear - nearest) <= _SAME_SURFACE * nearest else nearest
    seen = np.append((np.linalg.inv(source.intrinsic) @ [su, sv, 1.0]) / inverse, 1.0)
    returned = reference.intrinsic @ (reference.cam_from_world @ np.linalg.inv(source.cam_from_world) @ seen)[:3]
    if returned[2] <= 0:
        return NO_LEVEL, 0.0
    error_px = math.hypot(returned[0] / returned[2] - u, returned[1] / returned[2] - v)
    step = depth_tolerance_step(reference, source, tolerances) * depth
    step = min(max(step, tolerances.relative_depth_step), tolerances.relative_depth_step_max)
    for level in range(1, LEVELS + 1):
        if error_px <= level * tolerances.reprojection_step_px and abs(returned[2] - depth) <= level * step * depth:
            return level, float(returned[2])
    return NO_LEVEL, float(returned[2])


def _map_rays(
    matrix: NDArray[np.float64],
    u: NDArray[np.floating],
    v: NDArray[np.floating],
    depth: NDArray[np.floating],
    shift: NDArray[np.float64],
) -> tuple[NDArray[np.floating], NDArray[np.floating], NDArray[np.floating]]:
    m = matrix.astype(np.float32)
    t = shift.astype(np.float32)
    x, y, z = (_along(m[i], u, v, depth, t[i]) for i in range(3))
    return x, y, z


def _along(
    row: NDArray[np.float32],
    u: NDArray[np.floating],
    v: NDArray[np.floating],
    depth: NDArray[np.floating],
    shift: np.float32,
) -> NDArray[np.floating]:
    """``depth * (row . (u, v, 1)) + shift``, (N,), in the place of its first term, since fresh memory costs more."""
    found: NDArray[np.floating] = row[0] * u
    found += row[1] * v
    found += row[2]
    found *= depth
    found += shift
    return found


def _length(x: NDArray[np.float32], y: NDArray[np.float32]) -> NDArray[np.float32]:
    """(N,), written into ``x``; NumPy's ``hypot`` goes one by one."""
    x *= x
    y *= y
    x += y
    return np.asarray(np.sqrt(x, out=x))


def _remap(values: NDArray[np.float32], u: NDArray[np.floating], v: NDArray[np.floating]) -> NDArray[np.float32]:
    """Bilinear lookup at N scattered places by cv2.remap with float maps (exact on OpenCV >= 5)."""
    rows = -(-len(u) // _REMAP_WIDTH)
    maps = np.zeros((2, rows * _REMAP_WIDTH), dtype=np.float32)
    maps[0, : len(u)], maps[1, : len(v)] = u, v
    tables = maps.reshape(2, rows, _REMAP_WIDTH)
    found = cv2.remap(values, tables[0], tables[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
    return np.asarray(found, dtype=np.float32).reshape(-1)[: len(u)]
