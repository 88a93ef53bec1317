"""The rendered room as the mapper would leave it, without mapping: exact cameras, and points on its two planes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.support.rendered_room import FLOOR, FOCAL_PX, SIZE, WALL

_POINTS = 300


def room_model(files: Sequence[str], poses: Sequence[NDArray[np.float64]]) -> Any:
    """A ``pycolmap.Reconstruction`` of photos with these (4, 4) poses, noise-free."""
    import pycolmap

    model = pycolmap.Reconstruction()
    # COLMAP's pixel centres are at 0.5.
    params = [FOCAL_PX, SIZE[0] / 2, SIZE[1] / 2, 0.0]
    camera = pycolmap.Camera(model="SIMPLE_RADIAL", width=SIZE[0], height=SIZE[1], params=params, camera_id=1)
    model.add_camera_with_trivial_rig(camera)
    shares = np.random.default_rng(2).uniform(0, 1, (_POINTS, 2))
    cloud = np.vstack([origin + shares @ np.stack([across, down]) for origin, across, down in (WALL, FLOOR)])
    tracks: list[list[tuple[int, int]]] = [[] for _ in cloud]
    for image_id, (file, pose) in enumerate(zip(files, poses, strict=True), start=1):
        inside = cloud @ pose[:3, :3].T + pose[:3, 3]
        pixels = np.asarray(camera.img_from_cam(inside))
        seen = np.flatnonzero((inside[:, 2] > 0) & (pixels > 0).all(axis=1) & (pixels < SIZE).all(axis=1))
        image = pycolmap.Image(file, pixels[seen], 1, image_id)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose[:3]))
        for feature, point in enumerate(seen.tolist()):
            tracks[point].append((image_id, feature))
    for xyz, elements in zip(cloud, tracks, strict=True):
        if len(elements) >= 2:
            track = pycolmap.Track()
            for image_id, feature in elements:
                track.add_element(image_id, feature)
            model.add_point3D(xyz, track, np.zeros(3, np.uint8))
    model.update_point_3d_errors()
    return model
