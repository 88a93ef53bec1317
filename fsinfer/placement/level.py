"""From model coordinates to the plot's: z up, ground near z = 0 at the plot's centre.

Trees grow along gravity, not along the normal of a slope, so the ground plane only gives the height; up comes from
:mod:`fsinfer.placement.up`.
"""

from __future__ import annotations

import logging

import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import CloudError
from fsinfer.notices.capture import CaptureCode
from fsinfer.notices.notice import notice
from fsinfer.notices.sentences import sentence
from fsinfer.placement.ground_plane import ground_plane
from fsinfer.placement.settings import LevelSettings
from fsinfer.placement.up import estimate_up, upright_frame

_log = logging.getLogger(__name__)

Array = NDArray[np.float64]

#: With fewer points nothing is levelled. Source: judgement.
_MIN_POINTS = 100
#: Where no ground plane is found, this percentile of the heights stands for the ground. Source: judgement.
_LOW_PERCENT = 5


def level(
    points: Array,
    camera_centers: Array,
    camera_down: Array,
    *,
    camera_right: Array | None = None,
    gravity: Array | None = None,
    normals: NDArray[np.floating] | None = None,
    settings: LevelSettings | None = None,
) -> tuple[Array, bool]:
    """Find the rigid motion into the plot's frame.

    Parameters
    ----------
    points: (N, 3), any unit.
    camera_centers, camera_down: (C, 3), positions and downward image axes (second rows of the rotations).
    camera_right: (C, 3), x axes of the images (first rows); give them: they are free of pitch.
    gravity: (G, 3), unit vectors down in model coordinates, from the photographs whose phone noted it.
    normals: (N, 3) unit normals of the points; estimated from a sample when missing.

    Returns
    -------
    (4, 4) ``level_from_model``, rotation with determinant +1: z up, the cameras' median at x = y = 0, the ground
    there at z = 0, x along the model's x axis as far as that is horizontal (else y), so that it is reproducible; and
    whether a ground plane was found, without which the lowest points stand for the ground.

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
        local,
        normals,
        camera_right,
        camera_down,
        gravity=gravity,
        camera_centers=camera_centers - middle,
        settings=settings,
    )
    rotation = upright_frame(up)
    upright = local @ rotation.T
    cameras = (camera_centers - middle) @ rotation.T
    center = np.median(cameras[:, :2], axis=0)
    ground = ground_plane(upright, cameras, settings=settings)
    if ground is None:
        height = float(np.percentile(upright[:, 2], _LOW_PERCENT))
        _log.warning(sentence(notice(CaptureCode.no_ground_plane)))
    else:
        height = float(ground[0] * center[0] + ground[1] * center[1] + ground[2])
    _log.info("up from %s, cameras %.3g above the ground", method, float(np.median(cameras[:, 2])) - height)
    motion = np.eye(4)
    motion[:3, :3] = rotation
    motion[:3, 3] = -rotation @ middle - (center[0], center[1], height)
    return motion, ground is not None
