"""From photographs with a lens to pinhole images, and the model that belongs to them.

COLMAP puts the centre of the top left pixel at (0.5, 0.5), a scene in MVSNet format at (0, 0).
"""

from __future__ import annotations

from typing import Any, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from fsinfer.poses.adjustment.photo_effects import PhotoEffects
from fsinfer.poses.adjustment.problem import lens_of

#: Columns and rows of the pixels' places in a photo, each (h, w).
Maps: TypeAlias = tuple[NDArray[np.float32], NDArray[np.float32]]
#: Pixels between the places where a photo's own effects are computed; between them they are interpolated. Source:
#: numerics; they bend by a pixel over a photo at most.
_APART_PX = 16
#: Steps of the search for the way through a lens, how far off it may end, and how far outside of the picture it is not
#: even begun, pixels. Source: numerics.
_STEPS, _MISSED_PX, _FAR_OUTSIDE_PX = 12, 0.05, 64.0


def pinhole_of(camera: Any) -> Any:
    """The ``pycolmap`` PINHOLE camera whose image has no black border; its size differs from the photo's."""
    import pycolmap

    pinhole = pycolmap.undistort_camera(pycolmap.UndistortCameraOptions(), camera)
    pinhole.camera_id = camera.camera_id
    return pinhole


def intrinsic_of(pinhole: Any) -> NDArray[np.float64]:
    """(3, 3) intrinsics with pixel centres at integers, from a ``pycolmap`` PINHOLE camera."""
    matrix = np.array(pinhole.calibration_matrix(), dtype=np.float64)
    matrix[:2, 2] -= 0.5
    return matrix


def undistortion_maps(camera: Any, pinhole: Any) -> Maps:
    """For each pixel of the pinhole image, where it lies in the photo: x and y, (h, w) float32, integer centres."""
    u, v = np.meshgrid(np.arange(pinhole.width) + 0.5, np.arange(pinhole.height) + 0.5)
    rays = pinhole.cam_from_img(np.stack([u.ravel(), v.ravel()], axis=1))
    pixels = camera.img_from_cam(np.column_stack([rays, np.ones(len(rays))])) - 0.5
    maps = pixels.astype(np.float32).reshape(pinhole.height, pinhole.width, 2)
    return np.ascontiguousarray(maps[..., 0]), np.ascontiguousarray(maps[..., 1])


def maps_of_photo(maps: Maps, camera: Any, pinhole: Any, effects: PhotoEffects) -> Maps:
    """``maps`` of :func:`undistortion_maps` for a photo with effects of its own.

    The pinhole image is then that of the middle row's time and the camera's shared lens: focal length, principal point
    and rotation are undone exactly (to a hundredth of a pixel, between points ``_APART_PX`` apart), the way during the
    read-out with a smooth depth of the photo's sparse points, which is wrong by the depth's share where a stem stands
    before a far background.
    """
    width, height = int(pinhole.width), int(pinhole.height)
    columns, rows = width // _APART_PX + 2, height // _APART_PX + 2
    u, v = np.meshgrid(np.linspace(0, width, columns), np.linspace(0, height, rows))
    rays = pinhole.cam_from_img(np.stack([u.ravel(), v.ravel()], axis=1))
    rays = np.column_stack([rays, np.ones(len(rays))])
    still = camera.img_from_cam(rays)
    shifts = effects.pixels(rays, effects.inverse_depths(still), lens_of(camera)) - still
    coarse = shifts.astype(np.float32).reshape(rows, columns, 2)
    at_x = ((np.arange(width, dtype=np.float32) + 0.5) * ((columns - 1) / width))[None].repeat(height, axis=0)
    at_y = ((np.arange(height, dtype=np.float32) + 0.5) * ((rows - 1) / height))[:, None].repeat(width, axis=1)
    fine = cv2.remap(coarse, at_x, at_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return maps[0] + fine[..., 0], maps[1] + fine[..., 1]


def undistort(image: NDArray[np.uint8], maps: Maps) -> NDArray[np.uint8]:
    """Resample an (H, W, 3) uint8 photo to the pinhole image."""
    # Bilinear blurs bark by up to half a pixel. Lanczos is as sharp as this, in four times the time
    # (docs/trials-speed.md). The border only shows within rounding.
    warped = cv2.remap(image, maps[0], maps[1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(warped, dtype=np.uint8)


class NoWayBackError(Exception):
    """Where places of a photo lie in its pinhole image was not found."""


def straightened(pixels: NDArray[np.float64], maps: Maps, lens: Any, pinhole: Any) -> NDArray[np.float64] | None:
    """Where places (N, 2) of a photo lie in its pinhole image; None where one is not in it. Centres at whole numbers.

    The lens tells nearly where. From there ``maps``, which tell the way back, are searched step by step: they bend by
    far less than a pixel from one to the next.

    Raises
    ------
    NoWayBackError
        The search ends nowhere, beyond where a lens can be told.
    """
    height, width = maps[0].shape
    rays = np.asarray(lens.cam_from_img(pixels + 0.5), np.float64).reshape(-1, 2)
    found = np.asarray(pinhole.img_from_cam(np.column_stack([rays, np.ones(len(rays))])), np.float64) - 0.5
    if not np.isfinite(found).all():
        raise NoWayBackError
    if np.maximum(-found, found - [width - 1, height - 1]).max() > _FAR_OUTSIDE_PX:
        return None
    for _ in range(_STEPS):
        u, v = (np.ascontiguousarray(found[:, axis], np.float32) for axis in range(2))
        back = [cv2.remap(one, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).ravel() for one in maps]
        missed = pixels - np.stack(back, axis=1)
        found = found + missed
    if (found < 0).any() or (found > [width - 1, height - 1]).any():
        return None
    if np.abs(missed).max() > _MISSED_PX:
        raise NoWayBackError
    return found


def undistort_model(model: Any) -> dict[int, Any]:
    """Move the observations of a ``pycolmap.Reconstruction`` to pinhole images, in place.

    Returns
    -------
    The cameras that it had, by number: copies, for :func:`undistortion_maps`.
    """
    import copy

    cameras = {camera_id: copy.deepcopy(camera) for camera_id, camera in model.cameras.items()}
    for image in model.images.values():
        camera = cameras[image.camera_id]
        pinhole = pinhole_of(camera)
        points = image.points2D
        if len(points):
            pixels = np.array([point.xy for point in points])
            rays = camera.cam_from_img(pixels)
            moved = pinhole.img_from_cam(np.column_stack([rays, np.ones(len(rays))]))
            for point, xy in zip(points, moved, strict=True):
                point.xy = xy
    for camera_id, camera in cameras.items():
        pinhole = pinhole_of(camera)
        target = model.cameras[camera_id]
        target.model = pinhole.model
        target.width, target.height = pinhole.width, pinhole.height
        target.params = pinhole.params
    model.update_point_3d_errors()
    return cameras
