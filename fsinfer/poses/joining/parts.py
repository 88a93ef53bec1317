"""Parts of a torn walk put together: each is moved to its place in the rest, and its points become one with theirs.

Each part is right in itself and has a scale, a place and a turn of its own: a similarity joins it to the rest. It is
estimated from what both know, checked against all that both know, and adjusted with everything else afterwards.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fsinfer.geometry.similarity import Floats, rotation_of, scale_of
from fsinfer.poses.boards import BoardSighting, boards_in
from fsinfer.poses.joining.place import find_place


def join_parts(
    model: Any,
    parts: Sequence[Any],
    sightings: Sequence[BoardSighting],
    *,
    database: Path | None = None,
    walk: Sequence[str] = (),
    least_boards: int = 0,
) -> tuple[list[str], list[Any]]:
    """Join to ``model`` each part that can be; returns the files of the photos that were gained, and the other parts.

    Parameters
    ----------
    model: ``pycolmap.Reconstruction``; it is changed.
    parts: further reconstructions of photos from the same database, the largest first. One that is joined may show
        the way for another, so that all are tried again after each.
    database: of the matches, if photos of two parts may share some.
    walk: files of all photos in the order of walking, if they have one.
    least_boards: that must speak for the place of a part.
    """
    left = [(part, boards_in(part, sightings)) for part in parts]
    gained: list[str] = []
    progress = bool(left)
    while progress:
        progress = False
        ours = boards_in(model, sightings)
        for number, (part, theirs) in enumerate(left):
            where = find_place(
                model, part, ours, theirs, sightings, database=database, walk=walk, least_boards=least_boards
            )
            if where is not None:
                gained += _take_over(model, part, where)
                del left[number]
                progress = bool(left)
                break
    return gained, [part for part, _ in left]


def _take_over(model: Any, part: Any, where: Floats) -> list[str]:
    """Add the photos and points of ``part`` to ``model``; returns the files of the photos that it had not."""
    import pycolmap

    part.transform(pycolmap.Sim3d(scale_of(where), pycolmap.Rotation3d(rotation_of(where)), where[:3, 3]))
    had = set(model.reg_image_ids())
    gained = []
    for image_id in sorted(set(part.reg_image_ids()) - had):
        image = part.images[image_id]
        pose = image.cam_from_world()
        if not model.exists_camera(image.camera_id):
            model.add_camera_with_trivial_rig(pycolmap.Camera(part.cameras[image.camera_id].todict()))
        if model.exists_image(image_id):
            frame = model.frames[model.images[image_id].frame_id]
            frame.set_cam_from_world(image.camera_id, pose)
            model.register_frame(frame.frame_id)
        else:
            keypoints = np.array([point.xy for point in image.points2D]).reshape(-1, 2)
            copy = pycolmap.Image(name=image.name, keypoints=keypoints, camera_id=image.camera_id, image_id=image_id)
            model.add_image_with_trivial_frame(copy, pose)
        gained.append(str(image.name))
    for point in part.points3D.values():
        _add_point(model, point)
    return gained


def _add_point(model: Any, point: Any) -> None:
    """Add a point, or its observations to the point that the model has there already."""
    import pycolmap

    free, known = [], None
    for element in point.track.elements:
        if not model.images[element.image_id].has_pose:
            continue
        seen = model.images[element.image_id].points2D[element.point2D_idx]
        if not seen.has_point3D():
            free.append(element)
        elif known is None:
            known = seen.point3D_id
    if known is not None:
        seen_by = {element.image_id for element in model.points3D[known].track.elements}
        for element in free:
            if element.image_id not in seen_by:
                model.add_observation(known, element)
                seen_by.add(element.image_id)
    elif len(free) >= 2:
        track = pycolmap.Track()
        for element in free:
            track.add_element(element.image_id, element.point2D_idx)
        model.add_point3D(point.xyz, track, point.color)
