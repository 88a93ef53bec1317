"""Plots: a walk of many photographs around and through a stand, as a forester with a phone would make it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fsinfer.scene import Camera
from training.synthesize.cameras.camera_path import intrinsics, look_at, make_camera
from training.synthesize.forest.terrain import Terrain

#: Preferred distance between neighbouring photographs, metres. Source: a step of a walker.
STEP_M = 0.4
#: The lens keeps at least this far from bark. Source: judgement; how people walk.
CLEARANCE_M = 0.8


def _loops(radius_m: float, photos: int, *, both_ways: bool) -> list[float]:
    """Radii of the concentric loops whose length suits the number of photographs best."""
    outside = radius_m + 1.0
    if both_ways:
        return [outside, 0.45 * outside, 0.45 * outside]
    options = [[outside, *(outside * f for f in inner)] for inner in ((), (0.45,), (0.66, 0.33), (0.78, 0.55, 0.3))]
    return min(options, key=lambda loops: abs(np.log(2 * np.pi * sum(loops) / photos / STEP_M)))


def walk(radius_m: float, photos: int, *, both_ways: bool = False) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A spiral of loops: places (n, 2), equally spaced, and headings (n,).

    The photographer looks inward, swaying slowly to both sides: from the inner loops that shows the trees beyond the
    centre. ``both_ways`` walks one inner loop twice, the second time looking outward, so that the trees at the rim
    are seen from inside at half the distance.
    """
    loops = _loops(radius_m, photos, both_ways=both_ways)
    turns, start = [], 0.0
    for number, radius in enumerate(loops):
        last = number + 1 == len(loops)
        # Twice walked, a loop is closed before its last eighth of a turn leads inward, and after the turning round.
        end = 2 * np.pi * (1.0 if not both_ways else 1.25 if last else 1.125)
        angle = np.linspace(0, end, 721)[:-1]
        here = np.full(720, radius)
        if not last:  # the last eighth of a turn leads inward to the next loop
            t = np.clip((angle - end) / (2 * np.pi) / 0.125 + 1, 0, 1)
            here = radius + (loops[number + 1] - radius) * t**2 * (3 - 2 * t)
        turns.append(np.stack([angle + start, here], -1))
        start += end
    angle, radius = np.concatenate(turns).T
    line = np.stack([radius * np.cos(angle), radius * np.sin(angle)], -1)
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    at = np.linspace(0, length[-1], photos)
    places = np.stack([np.interp(at, length, line[:, i]) for i in range(2)], -1)
    bearing = np.interp(at, length, angle)
    heading = bearing + np.pi + 0.3 * np.sin(np.arange(photos) * 2 * np.pi / 23)
    if both_ways:  # turning round takes the first quarter of the last loop
        heading += np.pi * np.clip((bearing - turns[-1][0, 0]) / (np.pi / 2), 0, 1)
    return places, heading


def transects(radius_m: float, photos: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A zig-zag through the plot: places (n, 2) and headings (n,) along the walk."""
    # As many crossings as the photographs last for at the preferred step, at least one.
    crossings = max(1, int(photos * STEP_M / (2.1 * radius_m)))
    y = np.linspace(-0.6, 0.6, crossings + 1) if crossings > 1 else np.array([-0.1, 0.1])
    corners = radius_m * np.stack([np.where(np.arange(crossings + 1) % 2, 1.0, -1.0), y], -1)
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    at = np.linspace(0, length[-1], photos)
    places = np.stack([np.interp(at, length, corners[:, i]) for i in range(2)], -1)
    step = np.gradient(places, axis=0)
    heading = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    kernel = np.hanning(9) / np.hanning(9).sum()  # nobody turns on the spot
    return places, np.convolve(np.pad(heading, 4, mode="edge"), kernel, mode="valid")


def plot_cameras(
    rng: np.random.Generator,
    terrain: Terrain,
    obstacles: NDArray[np.float64],
    *,
    radius_m: float,
    photos: int,
    width: int,
    height: int,
    hfov_deg: float,
    zigzag: float = 0.0,
    both_ways: bool = False,
) -> list[Camera]:
    """The photographs' cameras in walking order (:func:`walk`); a share ``zigzag`` of them is taken on transects."""
    places, yaw = _whole_walk(radius_m, photos, zigzag, both_ways=both_ways)
    places = _keep_clear(places, obstacles)
    intrinsic = intrinsics(width, height, hfov_deg)
    cameras = []
    for (x, y), direction in zip(places + rng.normal(0, 0.03, places.shape), yaw, strict=True):
        z = float(terrain.height(x, y)) + 1.5 + rng.normal(0, 0.05)
        center = np.array([x, y, z])
        direction += rng.normal(0, 0.03)
        ahead = 4.0 * np.array([np.cos(direction), np.sin(direction)])
        slope = float(terrain.height(x + ahead[0], y + ahead[1])) - float(terrain.height(x, y))
        drop = 4.0 * np.tan(np.radians(rng.normal(8.0, 2.0)))
        target = center + np.array([*ahead, 0.7 * slope - drop])
        cameras.append(make_camera(intrinsic, look_at(center, target, rng.normal(0, 0.03))))
    return cameras


def _whole_walk(
    radius_m: float, photos: int, zigzag: float, *, both_ways: bool
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Loops, the way from their end to the transects, turning on the way, and the transects: no photograph leaps."""
    crossing = round(photos * zigzag)
    if not crossing:
        return walk(radius_m, photos, both_ways=both_ways)
    places, yaw = walk(radius_m, photos - crossing, both_ways=both_ways)
    gap = np.linalg.norm(transects(radius_m, crossing)[0][0] - places[-1])
    step = np.median(np.linalg.norm(np.diff(places, axis=0), axis=1))
    between = min(int(gap / step), photos // 4)
    crossing = round((photos - between) * zigzag)
    places, yaw = walk(radius_m, photos - between - crossing, both_ways=both_ways)
    more, heading = transects(radius_m, crossing)
    share = np.arange(1, between + 1) / (between + 1)
    way = places[-1] + share[:, None] * (more[0] - places[-1])
    turn = (heading[0] - yaw[-1] + np.pi) % (2 * np.pi) - np.pi
    return np.concatenate([places, way, more]), np.concatenate([yaw, yaw[-1] + share * turn, heading])


def _keep_clear(places: NDArray[np.float64], obstacles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Push the path away from ``obstacles`` (k, 3: x, y, radius), smoothing it in between."""
    places = places.copy()
    for _ in range(30):
        smooth = places.copy()
        smooth[1:-1] = 0.5 * places[1:-1] + 0.25 * (places[:-2] + places[2:])
        places = smooth if _ < 25 else places
        for x, y, radius in obstacles:
            away = places - [x, y]
            distance = np.maximum(np.linalg.norm(away, axis=1), 1e-6)
            push = np.clip(radius + CLEARANCE_M - distance, 0, None)
            places += away / distance[:, None] * push[:, None]
    return places
