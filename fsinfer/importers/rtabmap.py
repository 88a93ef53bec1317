"""Maps of RTAB-Map, whose apps use ARKit on iPhones and ARCore on Android phones, exported on a computer.

``rtabmap-export --images_id --poses_camera --poses_format 11 map.db`` writes ``map_camera_poses.txt`` (a line a photo:
time x y z qx qy qz qw id, from the camera's axes x right, y down, z forward to a world whose z points up, metres),
``map_rgb/ID.jpg`` and ``map_calib/ID.yaml`` (OpenCV's matrices). With ``--images`` files are named by the time instead.
Source: RTAB-Map's ``Graph.cpp`` and its issues 563, 749 and 1253.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fsinfer.errors import SceneError
from fsinfer.importers.files import find_photo, numbers, read_text, unfit
from fsinfer.importers.foreign import ForeignScene, pose_from_center, rotation_of_quaternion
from fsinfer.importers.lens import Lens
from fsinfer.importers.photos import Registered, gather
from fsinfer.importers.thinning import keyframes

PROGRAM = "RTAB-Map"
_POSES = "*camera_poses.txt"
#: What OpenCV's coefficients k1, k2, p1, p2, k3 to k6 belong to; fisheyes bear other ones. An empty name is the first.
_MODELS = ("plumb_bob", "rational_polynomial", "")
_METRES = "its metres are those of the phone's motion sensors, wrong by a per cent or two"


def find_rtabmap(path: Path) -> Path | None:
    """The file of camera poses of an export; None where ``path`` holds none."""
    found = sorted(path.glob(_POSES))
    return found[0] if found and folders_of(found[0], "calib") else None


def folders_of(poses: Path, part: str) -> list[Path]:
    """The folder ``PREFIX_rgb`` or ``PREFIX_calib`` beside the poses."""
    prefix = poses.name.removesuffix("camera_poses.txt")
    return [folder for folder in (poses.parent / f"{prefix}{part}", poses.parent / part) if folder.is_dir()]


def read_rtabmap(poses: Path, photos: Sequence[Path]) -> ForeignScene:
    """Read the poses of an export; ``photos`` are the folders of its photographs.

    Raises
    ------
    SceneError
        A file is damaged, a camera is a fisheye, a photograph has no calibration, or no photograph is found.
    """
    calibrations = folders_of(poses, "calib")
    registered, files = [], [poses]
    for line in read_text(poses).splitlines():
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        if len(words) not in (8, 9):
            raise unfit(poses, f"{line[:60]!r} is no line of the formats 10 or 11")
        _, *place, x, y, z, w = (float(v) for v in numbers(words[:8], 8, poses, "a pose"))
        stem = words[8] if len(words) == 9 and find_photo(words[8], photos) is not None else words[0]
        calibration = next((path for folder in calibrations if (path := folder / f"{stem}.yaml").is_file()), None)
        if calibration is None:
            continue  # a node of the map without a photograph
        world_from_cam = np.eye(4)
        world_from_cam[:3, :3] = rotation_of_quaternion(w, x, y, z, f"{poses}, {stem}")
        world_from_cam[:3, 3] = place
        files.append(calibration)
        pose = pose_from_center(world_from_cam, f"{poses}, {stem}")
        registered.append(Registered(name=stem, lens=_lens(calibration), cam_from_world=pose))
    kept = keyframes(registered)
    gathered = gather(kept, photos, source=poses)
    return ForeignScene(
        program=PROGRAM,
        files=tuple(files),
        photos=gathered.photos,
        metric=True,
        z_up=True,
        left_out=gathered.missing,
        remarks=(_METRES,),
    )


def _lens(path: Path) -> Lens:
    """The calibration in OpenCV's YAML, of which three matrices, the model and the size are looked at."""
    text = read_text(path)
    named = re.search(r"^distortion_model:[ \t]*(.*)", text, flags=re.MULTILINE)
    model = "" if named is None else named[1].partition("#")[0].strip().strip("\"'")
    if model not in _MODELS:
        msg = (
            f"{path}: the camera has the distortion model {model[:40]}, which is not read (plumb_bob and "
            "rational_polynomial are); undistort the photographs in the program that calibrated them, and export the "
            "map again with the calibration of those"
        )
        raise SceneError(msg)

    def data(name: str) -> str | None:
        found = re.search(rf"^{name}:.*?data:\s*\[([^\]]*)\]", text, flags=re.DOTALL | re.MULTILINE)
        return None if found is None else found[1].replace(",", " ")

    size = [re.search(rf"^image_{side}:\s*(\d+)", text, flags=re.MULTILINE) for side in ("width", "height")]
    width, height = (0 if found is None else int(found[1][:9]) for found in size)
    # The camera's own matrix was written wrongly for years; the projection says the same of one camera.
    projection, matrix = data("projection_matrix"), data("camera_matrix")
    if projection is not None:
        k = numbers(projection, 12, path, "projection_matrix").reshape(3, 4)
    elif matrix is not None:
        k = numbers(matrix, 9, path, "camera_matrix").reshape(3, 3)
    else:
        raise unfit(path, "it has no camera_matrix")
    bent = (data("distortion_coefficients") or "").split()
    k1, k2, p1, p2, k3, *divisor = (
        float(v) for v in numbers([*bent, *["0"] * (8 - len(bent))][:8], 8, path, "distortion_coefficients")
    )
    return Lens(
        width=width,
        height=height,
        fx=float(k[0, 0]),
        fy=float(k[1, 1]),
        cx=float(k[0, 2]),
        cy=float(k[1, 2]),
        radial=(k1, k2, k3),
        divisor=tuple(divisor),
        tangential=(p1, p2),
    )
