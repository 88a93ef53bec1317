"""Which stems a photograph is near enough to, told of a whole hectare at once."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from fsinfer.scene import Camera
from fsinfer.silhouettes.edge_settings import EdgeSettings
from fsinfer.silhouettes.stem_axis import StemAxis
from fsinfer.silhouettes.visibility import in_reach, stems_in_reach


def leaning_stems(count: int, rng: np.random.Generator) -> list[StemAxis]:
    along = np.column_stack([rng.normal(0, 0.1, (count, 2)), np.ones(count)])
    along /= np.linalg.norm(along, axis=1)[:, None]
    places = np.column_stack([rng.uniform(0, 100, (count, 2)), rng.uniform(0, 5, count)])
    radii = rng.uniform(0.03, 0.4, count)
    return [
        StemAxis(breast=place, along=way, radius_m=float(radius), taper=0.0)
        for place, way, radius in zip(places, along, radii, strict=True)
    ]


def level_camera(place: np.ndarray, heading: float) -> Camera:
    ahead = np.array([np.cos(heading), np.sin(heading), 0.0])
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(ahead, right), ahead])
    pose[:3, 3] = -pose[:3, :3] @ place
    intrinsic = np.array([[800.0, 0, 479.5], [0, 800, 359.5], [0, 0, 1]])
    return Camera(intrinsic=intrinsic, cam_from_world=pose, depth_min=0.5, depth_max=30.0)


def test_stems_of_a_hectare_are_in_reach_as_each_by_itself_is() -> None:
    rng = np.random.default_rng(0)
    stems, settings = leaning_stems(3000, rng), EdgeSettings()
    cameras = [level_camera(np.array([*rng.uniform(0, 100, 2), 1.5]), rng.uniform(0, 6.3)) for _ in range(10)]
    began = time.process_time()
    together = [stems_in_reach(stems, camera, settings) for camera in cameras]
    took = time.process_time() - began
    alone = [[n for n, stem in enumerate(stems) if in_reach(stem, camera, settings)] for camera in cameras]
    assert together == alone
    assert 100 < sum(map(len, alone)) < 10_000
    # A tenth of it: most of a hectare is not near.
    assert took < 0.5 * (time.process_time() - began - took)
    assert stems_in_reach([], cameras[0], settings) == []


def test_a_thin_stem_before_a_small_picture_is_in_reach() -> None:
    camera = level_camera(np.array([0.0, 0.0, 1.5]), 0.0)
    small = replace(camera, intrinsic=camera.intrinsic * [[0.1], [0.1], [1.0]])
    stems = [
        StemAxis(breast=np.array([x, 0.0, 1.3]), along=np.array([0.0, 0.0, 1.0]), radius_m=0.03, taper=0.0)
        for x in (0.6, 0.8, 1.5)
    ]
    # 4, 3 and 1.6 pixels.
    assert stems_in_reach(stems, small, EdgeSettings()) == [0, 1]
    assert stems_in_reach(stems, camera, EdgeSettings()) == [0, 1, 2]
