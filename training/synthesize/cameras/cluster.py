"""Training clusters: a few views on a short path that look at a common region."""

from __future__ import annotations

import numpy as np

from fsinfer.scene import Camera
from training.synthesize.cameras.camera_path import intrinsics, look_at, make_camera
from training.synthesize.forest.world import CLUTTER_RADIUS_M, World
from training.synthesize.render import Caster


def cluster_cameras(
    rng: np.random.Generator,
    world: World,
    caster: Caster,
    *,
    views: int,
    width: int,
    height: int,
    wide: bool = False,
) -> list[Camera]:
    """Draw views of one stem or object; retried until all see enough and none stands inside something.

    ``wide`` views stand round it, 8 to 25 degrees from one to the next, as in photographs of a monument.
    """
    best: list[Camera] = []
    for _ in range(40):
        cameras = _draw(rng, world, views, width, height, wide=wide)
        worst = min(_usable(caster, c, width, height) for c in cameras)
        if worst > 0.45:
            return cameras
        best = cameras if worst > 0.2 or not best else best
    return best


def _draw(rng: np.random.Generator, world: World, views: int, width: int, height: int, *, wide: bool) -> list[Camera]:
    inside = world.obstacles[np.hypot(*world.obstacles[:, :2].T) < 7.0] if len(world.obstacles) else world.obstacles
    if len(inside):  # objects that are no trees are few, and are what clutter scenes are for
        things = inside[inside[:, 2] == CLUTTER_RADIUS_M]
        inside = things if len(things) and rng.random() < 0.6 else inside
    aim = inside[int(rng.integers(len(inside)))] if len(inside) else np.array([*rng.normal(0, 2, 2), 0.2])
    distance = np.exp(rng.uniform(np.log(1.0), np.log(8.0))) + aim[2]
    bearing = rng.uniform(0, 2 * np.pi)
    if rng.random() < 0.7:  # from inside the plot, where the detailed ground is
        bearing = np.arctan2(-aim[1], -aim[0]) + rng.normal(0, 0.7)
    middle = aim[:2] + distance * np.array([np.cos(bearing), np.sin(bearing)])
    # Narrow angles too: a crop of a full-size photograph has few degrees, and its texture is as fine.
    intrinsic = intrinsics(width, height, np.exp(rng.uniform(np.log(22), np.log(75))))
    hold = rng.uniform(1.2, 1.8)
    look_h = rng.uniform(0.1, 2.2) if distance > 2 else rng.uniform(0.5, 1.8)
    target = np.array([aim[0], aim[1], float(world.terrain.height(aim[0], aim[1])) + look_h])
    step = np.exp(rng.uniform(np.log(0.08), np.log(0.9)))
    step = min(step, 0.35 * distance) if not wide else distance * np.radians(rng.uniform(8, 25))
    to_target = (target[:2] - middle) / np.linalg.norm(target[:2] - middle)
    side = np.array([-to_target[1], to_target[0]])
    heading = rng.normal(0, 0.35) if wide or rng.random() < 0.8 else rng.uniform(-1.4, 1.4)
    walk = np.cos(heading) * side + np.sin(heading) * to_target
    along = np.cumsum(step * np.exp(rng.normal(0, 0.3, views)))
    along -= along[views // 2]
    orbit = rng.uniform(0, 1) if not wide else 1.0  # 0: straight walk, 1: around the target
    cameras = []
    for s in along:
        angle = s / max(distance, 1.0) * orbit * np.sign(walk @ side)
        offset = s * walk
        if abs(heading) < 1.0:
            turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
            bent = target[:2] + turn @ (middle - target[:2]) - middle
            offset = orbit * bent * np.sign(bent @ offset + 1e-12) + (1 - orbit) * offset
        xy = middle + offset + rng.normal(0, 0.02, 2)
        z = float(world.terrain.height(xy[0], xy[1])) + hold + rng.normal(0, 0.03)
        center = np.array([*xy, z])
        gaze = target + rng.normal(0, 0.05, 3) * np.linalg.norm(target - center)
        cameras.append(make_camera(intrinsic, look_at(center, gaze, rng.normal(0, 0.04))))
    order = rng.permutation(views) if rng.random() < 0.2 else np.arange(views)
    return [cameras[i] for i in order]


def _usable(caster: Caster, camera: Camera, width: int, height: int) -> float:
    """Share of a coarse depth map between 0.5 m and 25 m; 0 where something is too near the lens."""
    small = np.diag([1 / 8, 1 / 8, 1]) @ camera.intrinsic
    coarse = make_camera(small, camera.cam_from_world)
    depth = caster.depth(coarse, width // 8, height // 8)
    hit = depth > 0
    if (hit & (depth < 0.45)).mean() > 0.01 or not hit.any() or np.median(depth[hit]) < 0.8:
        return 0.0
    return float((hit & (depth < 25)).mean())
