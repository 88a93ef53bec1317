"""Which way is up, and where the ground is: from model coordinates to z up, ground near z = 0 at the plot's centre.

Trees grow along gravity, not along the normal of a slope, so the ground plane only gives the height. Up comes from
what is vertical or level in the world: people hold a camera level sideways (its x axis is horizontal, whatever its
pitch), and the surfaces of stems have horizontal normals. Stems tell it to a fraction of a degree, unless they lean
together, as on a creeping slope or after a storm; many cameras tell it to a degree. So the stems are believed where the
cameras do not contradict them, and where they do both are weighed.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fsinfer.errors import CloudError

_log = logging.getLogger(__name__)

Array = NDArray[np.float64]

#: With fewer points nothing is levelled. Source: judgement.
_MIN_POINTS = 100
#: Where no ground plane is found, this percentile of the heights stands for the ground. Source: judgement.
_LOW_PERCENT = 5
#: Patches whose normals are estimated where the cloud brings none, points that are looked at for each, and its nearest
#: points. Source: numerics.
_MOST_NORMALS, _POINTS_PER_NORMAL, _NEIGHBOURS = 12_000, 8, 24
#: Variance along a patch over that across it, at least: thicker than a third of its width it has no normal. Source:
#: judgement.
_FLAT = 9
#: Cells, and points in each, that a ground needs. Source: judgement; twice what a plane needs.
_MIN_CELLS, _MIN_CELL_POINTS = 6, 3
#: One in so many points of a cell lies below the one that stands for it. Source: judgement; single points below the
#: ground are common in clouds from images.
_BELOW_SEED = 10
#: RANSAC trials, and rounds of fits to what a plane holds. Source: numerics; with half of the cells ground, 200 trials
#: miss with probability 3e-12.
_TRIALS, _PLANE_ROUNDS = 200, 5
#: Rounds that find up from the cameras, and from the stems. Source: numerics.
_CAMERA_ROUNDS, _STEM_ROUNDS = 10, 15
#: The window for stems shrinks so from round to round, down to so many times ``lean_scale``. Source: numerics.
_SHRINK, _LEAST_WINDOW = 0.85, 3
#: Lengths that stand for none. Source: numerics.
_LEAST_LENGTH, _LEAST_NORM = 1e-12, 1e-300
#: An axis nearer than this to up (its cosine) gives way to another. Source: numerics.
_TOO_UPRIGHT = 0.9


@dataclass(frozen=True, kw_only=True)
class LevelSettings:
    """Constants of the levelling; lengths are parts of the plot's extent, because the unit is unknown.

    Attributes
    ----------
    max_tilt_deg: the ground's normal and the stems' up lie this near to the cameras' up. Source: people tilt a phone
        down by 20-30 degrees; slopes of forests stay below 35.
    min_second_spread: the x axes of the cameras fix up only if they point in different directions: the second
        eigenvalue of their scatter, as part of the whole. Source: 0.5 for a full circle, 0.03 for a fan of about 20
        degrees.
    stem_window: |n.up| below which a patch may belong to a stem, at first. Source: judgement; 17 degrees.
    blind_window: the same when up is only known from the cameras' downward axes, which pitch biases. Source: judgement;
        27 degrees.
    lean_scale: |n.up| at which a patch counts half (Cauchy weight), so that leaning stems pull little. Source:
        judgement; 3.4 degrees.
    alike: photographs of one walk that are held alike, so that their errors do not average out. Source: judgement.
    usual_roll_deg: by which a photograph is held askew, as a standard deviation; counts as much as ``alike`` of them.
        Source: judgement.
    camera_floor_deg: error of up from however many cameras. Source: judgement; a habit of holding a phone askew
        averages out only where photographs look all round.
    common_lean_deg: by which all stems of a plot lean together, as a standard deviation. Source: judgement; stands on
        creeping slopes and after storms.
    contradiction: squared distance of both, in variances of the cameras', beyond which they contradict each other.
        Source: statistics, 99 % of a chi-square with two degrees of freedom.
    min_stem_patches: fewer patches are no evidence for stems. Source: judgement.
    min_gathered: of the patches within three times ``lean_scale`` this part lies within it. Source: isotropic normals
        (foliage) fill any window evenly, a third; around stems they gather at zero.
    roll_scale: sine of the roll at which a camera counts half. Source: judgement; a tenth of a radian, because single
        photographs are taken with the phone turned.
    cells: the ground is sought among the lowest points of so many cells a side. Source: judgement.
    plane_tolerance: distance to the ground plane of what counts as ground, part of the extent. Source: judgement.
    min_ground_part: a plane must hold this part of the cells. Source: judgement.
    """

    max_tilt_deg: float = 35.0
    min_second_spread: float = 0.03
    stem_window: float = 0.3
    blind_window: float = 0.45
    lean_scale: float = 0.06
    alike: float = 4.0
    usual_roll_deg: float = 3.0
    camera_floor_deg: float = 0.7
    common_lean_deg: float = 2.5
    contradiction: float = 9.2
    min_stem_patches: int = 150
    min_gathered: float = 0.45
    roll_scale: float = 0.1
    cells: int = 30
    plane_tolerance: float = 0.01
    min_ground_part: float = 0.2


def level(
    points: Array,
    camera_centers: Array,
    camera_down: Array,
    *,
    camera_right: Array | None = None,
    normals: NDArray[np.floating] | None = None,
    settings: LevelSettings | None = None,
) -> Array:
    """Find the rigid motion into the plot's frame.

    Parameters
    ----------
    points: (N, 3), any unit.
    camera_centers, camera_down: (C, 3), positions and downward image axes (second rows of the rotations).
    camera_right: (C, 3), x axes of the images (first rows); give them: they are free of pitch.
    normals: (N, 3) unit normals of the points; estimated from a sample when missing.

    Returns
    -------
    (4, 4) ``level_from_model``, rotation with determinant +1: z up, the cameras' median at x = y = 0, the ground
    there at z = 0, x along the model's x axis as far as that is horizontal (else y), so that it is reproducible.

    Raises
    ------
    CloudError
        Fewer than 100 points or no camera.
    """
    settings = settings or LevelSettings()
    points = np.asarray(points, dtype=np.float64)
    if len(points) < _MIN_POINTS or len(camera_centers) == 0:
        msg = f"{len(points)} points and {len(camera_centers)} cameras are too few to level; take more photographs"
        raise CloudError(msg)
    # Everything below works near the origin: georeferenced models would lose digits in the plane fits.
    middle = np.median(camera_centers, axis=0)
    local = points - middle
    up, method = estimate_up(
        local, normals, camera_right, camera_down, camera_centers=camera_centers - middle, settings=settings
    )
    rotation = _upright(up)
    upright = local @ rotation.T
    cameras = (camera_centers - middle) @ rotation.T
    center = np.median(cameras[:, :2], axis=0)
    ground = ground_plane(upright, cameras, settings=settings)
    if ground is None:
        height = float(np.percentile(upright[:, 2], _LOW_PERCENT))
        _log.warning(
            "no ground plane found: the lowest points stand for the ground, and breast height may be off; photograph "
            "the ground between the trees as well"
        )
    else:
        height = float(ground[0] * center[0] + ground[1] * center[1] + ground[2])
    _log.info("up from %s, cameras %.3g above the ground", method, float(np.median(cameras[:, 2])) - height)
    motion = np.eye(4)
    motion[:3, :3] = rotation
    motion[:3, 3] = -rotation @ middle - (center[0], center[1], height)
    return motion


def estimate_up(
    points: Array,
    normals: NDArray[np.floating] | None,
    camera_right: Array | None,
    camera_down: Array,
    *,
    camera_centers: Array | None = None,
    settings: LevelSettings | None = None,
) -> tuple[Array, str]:
    """Estimate the direction against gravity.

    First the cameras: up is the direction most orthogonal to all their x axes. Then the stems, if enough of the
    surface is nearly vertical: up is most orthogonal to the normals of that surface. Where these contradict the
    cameras beyond chance both are weighed by their variances: the stand leans.

    Returns
    -------
    (3,) unit vector, and what it comes from: ``stems``, ``cameras and leaning stems``, ``cameras``, ``ground`` (the
    normal of the ground plane, only when the cameras give nothing but a biased direction) or ``camera tilt``.
    """
    settings = settings or LevelSettings()
    down = np.asarray(camera_down, dtype=np.float64)
    tilted = -_unit(down.mean(axis=0))
    right = None
    if camera_right is not None:
        right = np.asarray(camera_right) / np.linalg.norm(camera_right, axis=1, keepdims=True)
    prior = None if right is None else _up_from_right(right, tilted, settings)
    start, window = (tilted, settings.blind_window) if prior is None else (prior, settings.stem_window)
    if normals is None:
        normals = sample_normals(points, _MOST_NORMALS)
    else:
        normals = np.asarray(normals[:: -(-len(normals) // _MOST_NORMALS)], dtype=np.float64)
    stems = _up_from_normals(np.asarray(normals, dtype=np.float64), start, window, settings)
    if stems is not None and prior is not None and right is not None:
        weighed = _weighed(stems, prior, right, settings)
        if weighed is not None:
            return weighed, "cameras and leaning stems"
    if stems is not None:
        return stems, "stems"
    if prior is not None:
        return prior, "cameras"
    if camera_centers is not None:
        rotation = _upright(tilted)
        plane = ground_plane(points @ rotation.T, camera_centers @ rotation.T, settings=settings)
        if plane is not None:
            return _unit(rotation.T @ [-plane[0], -plane[1], 1.0]), "ground"
    return tilted, "camera tilt"


def sample_normals(points: Array, count: int, *, neighbours: int = _NEIGHBOURS, seed: int = 0) -> Array:
    """(M, 3) unit normals (of either sign) of up to ``count`` flat patches, by PCA of the nearest points.

    Patches whose thickness exceeds a third of their width are left out: foliage and noise have no normal.
    """
    rng = np.random.default_rng(seed)
    if len(points) > _POINTS_PER_NORMAL * count:
        points = points[rng.choice(len(points), _POINTS_PER_NORMAL * count, replace=False)]
    chosen = points if len(points) <= count else points[rng.choice(len(points), count, replace=False)]
    _, near = cKDTree(points).query(chosen, k=min(neighbours, len(points)))
    patches = points[near] - points[near].mean(axis=1, keepdims=True)
    values, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", patches, patches))
    flat = values[:, 0] < values[:, 1] / _FLAT
    return np.asarray(vectors[flat, :, 0])


def ground_plane(
    upright: Array, cameras: Array, *, settings: LevelSettings | None = None, seed: int = 0
) -> Array | None:
    """RANSAC plane through the lowest points of the cells of a grid, below the cameras.

    Parameters
    ----------
    upright: (N, 3), z roughly up. cameras: (C, 3) in the same frame.

    Returns
    -------
    (3,) a, b, c of ``z = a x + b y + c``, or None where no plane within ``max_tilt_deg`` holds a fifth of the cells.
    """
    settings = settings or LevelSettings()
    center = np.median(cameras, axis=0)
    low = upright[upright[:, 2] < np.median(cameras[:, 2])]
    if len(low) < _MIN_CELLS * _MIN_CELL_POINTS:
        return None
    # Backgrounds far away are no ground of this plot: look as far as twice the reach of most points.
    distance = np.hypot(*(low[:, :2] - center[:2]).T)
    reach = 2 * float(np.median(distance))
    low = low[distance <= reach]
    cells = np.floor((low[:, :2] - center[:2]) / (2 * reach / settings.cells)).astype(np.int64)
    _, own = np.unique(cells, axis=0, return_inverse=True)
    order = np.lexsort((low[:, 2], own))
    starts = np.flatnonzero(np.diff(own[order], prepend=-1))
    counts = np.diff(np.append(starts, len(order)))
    # The lowest tenth, not the lowest: single points below the ground are common in clouds from images.
    seeds = low[order[starts + counts // _BELOW_SEED]][counts >= _MIN_CELL_POINTS]
    if len(seeds) < _MIN_CELLS:
        return None
    rng = np.random.default_rng(seed)
    tolerance = settings.plane_tolerance * 2 * reach
    best, best_score = None, settings.min_ground_part * len(seeds)
    for _ in range(_TRIALS):
        three = seeds[rng.choice(len(seeds), 3, replace=False)]
        normal = np.cross(three[1] - three[0], three[2] - three[0])
        length = float(np.linalg.norm(normal))
        if length < _LEAST_LENGTH or abs(normal[2]) < length * np.cos(np.radians(settings.max_tilt_deg)):
            continue
        residual = (seeds - three[0]) @ normal / length
        # MSAC: what lies within counts by how near it lies, so that the best of several full planes wins.
        score = float(np.clip(1 - (residual / tolerance) ** 2, 0, None).sum())
        if score > best_score:
            best, best_score = np.abs(residual) < 2 * tolerance, score
    if best is None:
        return None
    plane = np.zeros(3)
    for _ in range(_PLANE_ROUNDS):
        inliers = seeds[best]
        plane = np.linalg.lstsq(np.column_stack([inliers[:, :2], np.ones(len(inliers))]), inliers[:, 2], rcond=None)[0]
        best = np.abs(seeds[:, :2] @ plane[:2] + plane[2] - seeds[:, 2]) < tolerance
        if best.sum() < _MIN_CELLS:
            break
    return np.asarray(plane)


def _up_from_right(right: Array, tilted: Array, settings: LevelSettings) -> Array | None:
    """Return the direction most orthogonal to the x axes (C, 3), unit; None where it contradicts the downward ones."""
    weights = np.ones(len(right))
    up = tilted
    for _ in range(_CAMERA_ROUNDS):
        values, vectors = np.linalg.eigh((right * weights[:, None]).T @ right)
        if values[1] < settings.min_second_spread * values.sum():
            # All look the same way: only the roll is known, the pitch stays that of the cameras.
            up = _unit(tilted - (tilted @ vectors[:, 2]) * vectors[:, 2])
        else:
            up = vectors[:, 0] * (1 if vectors[:, 0] @ tilted > 0 else -1)
        weights = 1 / (1 + (right @ up / settings.roll_scale) ** 2)
    return up if up @ tilted > np.cos(np.radians(settings.max_tilt_deg)) else None


def _weighed(stems: Array, cameras: Array, right: Array, settings: LevelSettings) -> Array | None:
    """Both directions by their precision, where the cameras contradict the stems; None where they do not."""
    roll = right @ cameras
    weights = 1 / (1 + (roll / settings.roll_scale) ** 2)
    usual = np.radians(settings.usual_roll_deg) ** 2
    variance = float(((weights * roll**2).sum() + settings.alike * usual) / (weights.sum() + settings.alike))
    values, axes = np.linalg.eigh((right * weights[:, None]).T @ right)
    axes = axes[:, 1:]  # level, the one that fewer cameras tell first
    of_cameras = variance * settings.alike / np.maximum(values[1:], _LEAST_NORM)
    of_cameras += np.radians(settings.camera_floor_deg) ** 2
    if values[1] < settings.min_second_spread * values.sum():
        of_cameras[0] = np.pi**2  # that is their pitch
    apart = axes.T @ (stems - cameras)
    if float((apart**2 / of_cameras).sum()) <= settings.contradiction:
        return None
    of_stems = np.radians(settings.common_lean_deg) ** 2
    share = of_cameras / (of_cameras + of_stems)  # of the stems
    up = _unit(cameras + axes @ (share * apart))
    _log.info(
        "the stems lean by %.1f degrees from where the cameras have up, together", np.degrees(np.arccos(stems @ up))
    )
    return up


def _up_from_normals(normals: Array, start: Array, window: float, settings: LevelSettings) -> Array | None:
    """Return the direction most orthogonal to the normals of nearly vertical surface; None with too little of it."""
    up = start
    for step in range(_STEM_ROUNDS):
        cosine = normals @ up
        # The window shrinks, so that ground on a slope and branches, near its rim, lose their say.
        limit = max(window * _SHRINK**step, _LEAST_WINDOW * settings.lean_scale)
        near = normals[np.abs(cosine) < limit]
        if len(near) < settings.min_stem_patches:
            return None
        weights = 1 / (1 + (near @ up / settings.lean_scale) ** 2)
        values, vectors = np.linalg.eigh((near * weights[:, None]).T @ near)
        if values[1] < settings.min_second_spread * values.sum():
            return None
        up = vectors[:, 0] * (1 if vectors[:, 0] @ up > 0 else -1)
    # Isotropic normals (foliage) fill any window evenly; around stems they gather at zero.
    cosine = np.abs(normals @ up)
    inner, outer = (cosine < settings.lean_scale).sum(), (cosine < _LEAST_WINDOW * settings.lean_scale).sum()
    gathered = inner > settings.min_gathered * outer
    close = up @ start > np.cos(np.radians(settings.max_tilt_deg))
    return up if gathered and close else None


def _upright(up: Array) -> Array:
    """(3, 3) rotation with ``up`` as third row and the model's x axis (else y) as first, made horizontal."""
    axis = np.array([1.0, 0, 0]) if abs(up[0]) < _TOO_UPRIGHT else np.array([0, 1.0, 0])
    first = _unit(axis - (axis @ up) * up)
    return np.stack([first, np.cross(up, first), up])


def _unit(vector: Array) -> Array:
    return np.asarray(vector / max(float(np.linalg.norm(vector)), _LEAST_NORM))
