"""Photographs of a scene with their cameras, at the size that a benchmark asks for."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import SceneError
from fsinfer.scene import read_scene, read_view_image

#: Images, intrinsics, poses and depth range as :func:`tests.bench.speed.make_views` gives them.
Views = tuple[list[NDArray[np.uint8]], NDArray[np.float64], NDArray[np.float64], tuple[float, float]]


def views_of_scene(folder: Path, count: int, height: int, width: int) -> Views:
    """The middle view of a scene in MVSNet format and its best sources.

    Of each photograph the largest part in the middle that has these proportions, enlarged or reduced to the size.
    """
    scene = read_scene(folder)
    view = scene.views[len(scene.views) // 2]
    if len(view.sources) < count - 1:
        msg = f"{view.name} of {folder} has {len(view.sources)} sources, {count - 1} are needed"
        raise SceneError(msg)
    chosen = [view, *(scene.views[i] for i in view.sources[: count - 1])]
    images, intrinsics = [], []
    for one in chosen:
        image = read_view_image(one)
        rows, columns = image.shape[:2]
        scale = max(height / rows, width / columns)
        kept = round(height / scale), round(width / scale)
        top, left = (rows - kept[0]) // 2, (columns - kept[1]) // 2
        part = image[top : top + kept[0], left : left + kept[1]]
        images.append(np.asarray(cv2.resize(part, (width, height), interpolation=cv2.INTER_AREA), np.uint8))
        intrinsic = one.camera.intrinsic.copy()
        intrinsic[0, 2] -= left
        intrinsic[1, 2] -= top
        # Pixel centre x goes to (x + 0.5) scale - 0.5.
        intrinsic[:2] *= np.array([[width / kept[1]], [height / kept[0]]])
        intrinsic[0, 2] += 0.5 * width / kept[1] - 0.5
        intrinsic[1, 2] += 0.5 * height / kept[0] - 0.5
        intrinsics.append(intrinsic)
    poses = np.stack([one.camera.cam_from_world for one in chosen])
    return images, np.stack(intrinsics), poses, (view.camera.depth_min, view.camera.depth_max)
