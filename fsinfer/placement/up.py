"""Which way is up, from all that tells it: what phones noted, how they were held, and the stems.

A phone may have noted which way gravity pulled it. People hold a camera level sideways (its x axis is horizontal,
whatever its pitch), and the surfaces of stems have horizontal normals. Stems tell up to a fraction of a degree, unless
they lean together, as on a creeping slope or after a storm, or one of them is all there is; the notes of many
photographs, or how many cameras were held, tell it to a degree. So the stems are believed where these do not contradict
them, and where they do both are weighed.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fsinfer.placement.ground_plane import ground_plane
from fsinfer.placement.settings import LevelSettings

_log = logging.getLogger(__name__)

Array = NDArray[np.float64]

#: Patches whose normals are estimated where the cloud brings none, points that are looked at for each, and its nearest
#: points. Source: numerics.
_MOST_NORMALS, _POINTS_PER_NORMAL, _NEIGHBOURS = 12_000, 8, 24
#: Variance along a patch over that across it, at least: thicker than a third of its width it has no normal. Source:
#: judgement.
_FLAT = 9
#: Rounds that find up from notes of gravity, from the cameras, and from the stems. Source: numerics.
_GRAVITY_ROUNDS, _CAMERA_ROUNDS, _STEM_ROUNDS = 10, 10, 15
#: The window for stems shrinks so from round to round, down to so many times ``lean_scale``. Source: numerics.
_SHRINK, _LEAST_WINDOW = 0.85, 3
#: Lengths that stand for none. Source: numerics.
_LEAST_NORM = 1e-300
#: An axis nearer than this to up (its cosine) gives way to another. Source: numerics.
_TOO_UPRIGHT = 0.9


@dataclass(frozen=True, kw_only=True)
class _Held:
    """Up without the stems: the direction (3,), two axes across it (3, 2), and its variance along each (2,), rad^2."""

    up: Array
    axes: Array
    variance: Array
    source: str


def estimate_up(
    points: Array,
    normals: NDArray[np.floating] | None,
    camera_right: Array | None,
    camera_down: Array,
    *,
    gravity: Array | None = None,
    camera_centers: Array | None = None,
    settings: LevelSettings | None = None,
) -> tuple[Array, str]:
    """Estimate the direction against gravity.

    First what phones noted, ``gravity`` (G, 3), unit vectors down in model coordinates; else the cameras: up is the
    direction most orthogonal to all their x axes. Then the stems, if enough of the surface is nearly vertical: up is
    most orthogonal to the normals of that surface. Where these contradict the former beyond chance both are weighed by
    their variances: the stand leans.

    Returns
    -------
    (3,) unit vector, and what it comes from: ``stems``, ``gravity and leaning stems``, ``cameras and leaning stems``,
    ``gravity``, ``cameras``, ``ground`` (the normal of the ground plane, only when the cameras give nothing but a
    biased direction) or ``camera tilt``.
    """
    settings = settings or LevelSettings()
    down = np.asarray(camera_down, dtype=np.float64)
    tilted = -_unit(down.mean(axis=0))
    held = None if gravity is None else _from_gravity(np.asarray(gravity), settings)
    if held is None and camera_right is not None:
        held = _from_cameras(np.asarray(camera_right), tilted, settings)
    start, window = (tilted, settings.blind_window) if held is None else (held.up, settings.stem_window)
    if normals is None:
        normals = sample_normals(points, _MOST_NORMALS)
    else:
        normals = np.asarray(normals[:: -(-len(normals) // _MOST_NORMALS)], dtype=np.float64)
    stems = _up_from_normals(np.asarray(normals, dtype=np.float64), start, window, settings)
    if stems is not None and held is not None:
        weighed = _weighed(stems, held, settings)
        if weighed is not None:
            return weighed, f"{held.source} and leaning stems"
    if stems is not None:
        return stems, "stems"
    if held is not None:
        return held.up, held.source
    if camera_centers is not None:
        rotation = upright_frame(tilted)
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


def _from_gravity(down: Array, settings: LevelSettings) -> _Held | None:
    """Up from what phones noted, (G, 3); None from too few notes, or from such as contradict each other."""
    if len(down) < settings.min_noted:
        return None
    down = down / np.linalg.norm(down, axis=1, keepdims=True)
    scale = np.radians(settings.noted_gravity_deg)
    mean = _unit(np.median(down, axis=0))
    for _ in range(_GRAVITY_ROUNDS):
        apart = np.linalg.norm(down - mean, axis=1)
        weights = 1 / (1 + (apart / (2 * scale)) ** 2)
        mean = _unit(weights @ down)
    spread = float(np.sqrt((weights * apart**2).sum() / weights.sum()))
    if spread > np.radians(settings.max_noted_deg):
        _log.info("gravity as the phone noted it is at odds with the poses by %.1f degrees", np.degrees(spread))
        return None
    variance = np.radians(settings.gravity_floor_deg) ** 2 + max(spread, scale) ** 2 / len(down)
    axes = upright_frame(-mean)[:2].T
    return _Held(up=-mean, axes=axes, variance=np.full(2, variance), source="gravity")


def _from_cameras(right: Array, tilted: Array, settings: LevelSettings) -> _Held | None:
    """Up from the x axes of the cameras (C, 3): most orthogonal to them; None where the downward axes contradict it."""
    right = right / np.linalg.norm(right, axis=1, keepdims=True)
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
    if up @ tilted <= np.cos(np.radians(settings.max_tilt_deg)):
        return None
    roll = right @ up
    weights = 1 / (1 + (roll / settings.roll_scale) ** 2)
    usual = np.radians(settings.usual_roll_deg) ** 2
    variance = float(((weights * roll**2).sum() + settings.alike * usual) / (weights.sum() + settings.alike))
    values, axes = np.linalg.eigh((right * weights[:, None]).T @ right)
    # Of the level axes the one that fewer cameras tell comes first.
    of_each = variance * settings.alike / np.maximum(values[1:], _LEAST_NORM)
    of_each += np.radians(settings.camera_floor_deg) ** 2
    if values[1] < settings.min_second_spread * values.sum():
        of_each[0] = np.pi**2  # that is their pitch
    return _Held(up=up, axes=axes[:, 1:], variance=of_each, source="cameras")


def _weighed(stems: Array, held: _Held, settings: LevelSettings) -> Array | None:
    """Both directions by their precision, where the stems contradict what is held up; None where they do not."""
    apart = held.axes.T @ (stems - held.up)
    if float((apart**2 / held.variance).sum()) <= settings.contradiction:
        return None
    of_stems = np.radians(settings.common_lean_deg) ** 2
    share = held.variance / (held.variance + of_stems)  # of the stems
    up = _unit(held.up + held.axes @ (share * apart))
    _log.info(
        "the stems lean by %.1f degrees from where the %s has up, together",
        np.degrees(np.arccos(np.clip(stems @ up, -1.0, 1.0))),
        "gravity that was noted" if held.source == "gravity" else "way the cameras were held",
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


def upright_frame(up: Array) -> Array:
    """(3, 3) rotation with ``up`` as third row and the model's x axis (else y) as first, made horizontal."""
    axis = np.array([1.0, 0, 0]) if abs(up[0]) < _TOO_UPRIGHT else np.array([0, 1.0, 0])
    first = _unit(axis - (axis @ up) * up)
    return np.stack([first, np.cross(up, first), up])


def _unit(vector: Array) -> Array:
    return np.asarray(vector / max(float(np.linalg.norm(vector)), _LEAST_NORM))
