"""``transforms.json`` of nerfstudio and instant-ngp.

``transform_matrix`` leads from the camera (x right, y up, z backward, as in OpenGL) to the world. Intrinsics stand at
the top, or with each frame; the centre of the top left pixel lies at (0.5, 0.5). Whether a unit is a metre the file
does not say. Source: nerfstudio's documentation, "Data conventions"; instant-ngp, ``docs/nerf_dataset_tips.md``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from fsinfer.errors import SceneError
from fsinfer.importers.files import find_photo, numbers, read_json, unfit
from fsinfer.importers.foreign import FROM_OPENGL, ForeignScene, near_origin, pose_from_center
from fsinfer.importers.lens import Lens
from fsinfer.importers.photos import Registered, gather
from fsinfer.io.images import image_size

PROGRAM = "nerfstudio"
FILE = "transforms.json"
#: Camera models of the lens here; a file that names none has a pinhole or its coefficients.
_MODELS = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "PERSPECTIVE", "")


def read_transforms(path: Path, photos: Sequence[Path]) -> ForeignScene:
    """Read ``transforms.json``; ``photos`` are the folders in which its photographs may lie.

    Raises
    ------
    SceneError
        It is damaged, a camera is a fisheye, or no photograph is found.
    """
    content = read_json(path)
    frames = content.get("frames")
    if not isinstance(frames, list) or not all(isinstance(frame, dict) for frame in frames):
        raise unfit(path, "it has no list of frames")
    registered = []
    for number, frame in enumerate(frames):
        name = str(frame.get("file_path", ""))
        if not name:
            raise unfit(path, f"frame {number} has no file_path")
        matrix = numbers(frame.get("transform_matrix"), 16, path, f"the transform_matrix of {name}").reshape(4, 4)
        pose = pose_from_center(matrix @ FROM_OPENGL, f"{path}, {name}")
        lens = _lens({**content, **frame}, name, path, photos)
        registered.append(Registered(name=name, lens=lens, cam_from_world=pose))
    gathered = gather(registered, photos, source=path)
    scene = ForeignScene(
        program=PROGRAM,
        files=(path,),
        photos=gathered.photos,
        left_out=gathered.missing,
        remarks=("transforms.json does not say how long its unit is", *gathered.remarks),
    )
    return near_origin(scene)


def _lens(values: Mapping[str, Any], name: str, path: Path, photos: Sequence[Path]) -> Lens:
    model = str(values.get("camera_model") or "").upper()
    if model not in _MODELS or values.get("is_fisheye"):
        msg = f"{path}: {name} has the camera model {model or ''} (or a fisheye), which is not read; undistort it"
        raise SceneError(msg)

    def number(key: str, default: float) -> float:
        value = values.get(key)
        return default if value is None else float(numbers([value], 1, path, f"{key} of {name}")[0])

    width, height = number("w", 0), number("h", 0)
    if not (width > 0 and height > 0):
        photo = find_photo(name, photos)
        if photo is not None:
            width, height = image_size(photo, upright=False)
        else:
            width, height = 2 * number("cx", 0.5), 2 * number("cy", 0.5)  # it is left out
    angle = number("camera_angle_x", 0.0)
    focal = number("fl_x", width / 2 / math.tan(angle / 2) if 0 < angle < math.pi else 0.0)
    angle_y = number("camera_angle_y", 0.0)
    focal_y = number("fl_y", height / 2 / math.tan(angle_y / 2) if 0 < angle_y < math.pi else focal)
    if not (focal > 0 and focal_y > 0):
        raise unfit(path, f"{name} has no focal length (fl_x or camera_angle_x)")
    return Lens(
        width=round(width) or 1,
        height=round(height) or 1,
        fx=focal,
        fy=focal_y,
        cx=number("cx", width / 2) - 0.5,
        cy=number("cy", height / 2) - 0.5,
        radial=(number("k1", 0.0), number("k2", 0.0), number("k3", 0.0), number("k4", 0.0)),
        tangential=(number("p1", 0.0), number("p2", 0.0)),
    )
