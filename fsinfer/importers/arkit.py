"""Logs of ARKit as three apps for iPhones export them: Polycam, 3D Scanner App, Record3D.

Poses are camera to world with the camera's axes x right, y up, z backward, in metres. The world's y points up,
against gravity; Record3D's is the first camera's frame. Photographs lie as the sensor sees them, or as Record3D turned
them, and have no distortion to speak of; intrinsics count from the centre of the top left pixel.

- Polycam, raw data (developer mode): ``keyframes/cameras/N.json`` (``t_00`` ... ``t_23``, ``fx``, ``fy``, ``cx``,
  ``cy``, ``width``, ``height``) and ``keyframes/images/N.jpg``; ``corrected_cameras`` and ``corrected_images`` after
  its loop closure, which are preferred.
- 3D Scanner App, all data: ``frame_NNNNN.json`` (``cameraPoseARFrame``, 16 numbers row by row; ``intrinsics``, 9) and
  ``frame_NNNNN.jpg``.
- Record3D, as EXR + JPG or an unpacked ``.r3d``: ``metadata.json`` or ``metadata`` (``poses``: quaternion x, y, z, w
  and place; ``K`` column by column or ``perFrameIntrinsicCoeffs``; ``w``, ``h``) and ``rgb/N.jpg`` or ``rgbd/N.jpg``.

Source: Apple's ARKit (``ARCamera.transform``), Polycam's documentation of raw data, issues 27 and 36 of record3d, and
files that the apps wrote.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fsinfer.importers.files import find_photo, numbers, read_json, unfit
from fsinfer.importers.foreign import (
    FROM_OPENGL,
    Z_UP_FROM_Y_UP,
    Floats,
    ForeignScene,
    pose_from_center,
    rotation_of_quaternion,
)
from fsinfer.importers.lens import Lens
from fsinfer.importers.photos import Registered, gather
from fsinfer.importers.thinning import keyframes
from fsinfer.io.images import image_size

POLYCAM, SCANNER, RECORD3D = "Polycam", "3D Scanner App", "Record3D"
_METRES = "its metres are those of the phone's motion sensors, wrong by a per cent or two"
_POLYCAM_FOLDERS = (("corrected_cameras", "corrected_images"), ("cameras", "images"))


def find_polycam(path: Path) -> tuple[Path, Path] | None:
    """The folders of cameras and of images of a Polycam export; None where ``path`` holds none."""
    for base in (path / "keyframes", path):
        for cameras, images in _POLYCAM_FOLDERS:
            if (base / images).is_dir() and next((base / cameras).glob("*.json"), None) is not None:
                return base / cameras, base / images
    return None


def read_polycam(cameras: Path, photos: Sequence[Path]) -> ForeignScene:
    """Read the folder ``cameras`` of a Polycam export; ``photos`` are the folders of its photographs."""
    files = sorted(cameras.glob("*.json"))
    registered = []
    for file in files:
        values = read_json(file)
        rows = [[values.get(f"t_{row}{column}") for column in range(4)] for row in range(3)]
        world_from_cam = np.eye(4)
        world_from_cam[:3] = numbers(rows, 12, file, "t_00 to t_23").reshape(3, 4)
        lens = _lens([values.get(key) for key in ("fx", "fy", "cx", "cy", "width", "height")], file)
        registered.append(Registered(name=file.stem, lens=lens, cam_from_world=_pose(world_from_cam, file)))
    gathered = gather(registered, photos, source=cameras)
    return ForeignScene(
        program=POLYCAM,
        files=tuple(files),
        photos=gathered.photos,
        metric=True,
        z_up=True,
        left_out=gathered.missing,
        remarks=(_METRES,),
    )


def is_scanner_app(path: Path) -> bool:
    """Whether a folder is an export of 3D Scanner App."""
    first = next(iter(sorted(path.glob("frame_*.json"))), None)
    if first is None:
        return False
    try:
        with first.open("rb") as stream:
            return b"cameraPoseARFrame" in stream.read(65536)
    except OSError:
        return False


def read_scanner_app(folder: Path, photos: Sequence[Path]) -> ForeignScene:
    """Read an export of 3D Scanner App; ``photos`` are the folders of its photographs."""
    files = sorted(folder.glob("frame_*.json"))
    registered, left_out = [], []
    for file in files:
        photo = find_photo(file.stem, photos)
        if photo is None:
            left_out.append(file.stem)  # most frames have depth only
            continue
        values = read_json(file)
        world_from_cam = numbers(values.get("cameraPoseARFrame"), 16, file, "cameraPoseARFrame").reshape(4, 4)
        matrix = numbers(values.get("intrinsics"), 9, file, "intrinsics").reshape(3, 3)
        size = image_size(photo, upright=False)
        lens = _lens([matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *size], file)
        registered.append(Registered(name=file.stem, lens=lens, cam_from_world=_pose(world_from_cam, file)))
    kept = keyframes(registered)
    gathered = gather(kept, photos, source=folder)
    return ForeignScene(
        program=SCANNER,
        files=tuple(files),
        photos=gathered.photos,
        metric=True,
        z_up=True,
        left_out=gathered.missing,
        remarks=(_METRES, *_thinned(len(registered), len(kept))),
    )


def find_record3d(path: Path) -> Path | None:
    """The file of poses of a Record3D export; None where ``path`` holds none."""
    for name in ("metadata.json", "metadata"):
        if (path / name).is_file() and any((path / folder).is_dir() for folder in ("rgb", "rgbd")):
            return path / name
    return None


def read_record3d(metadata: Path, photos: Sequence[Path]) -> ForeignScene:
    """Read ``metadata.json`` of a Record3D export; ``photos`` are the folders of its photographs."""
    content = read_json(metadata)
    poses = content.get("poses")
    if not isinstance(poses, list) or not poses:
        raise unfit(metadata, "it has no list of poses")
    each = content.get("perFrameIntrinsicCoeffs")
    each = each if isinstance(each, list) and len(each) == len(poses) else None
    registered = []
    for number, values in enumerate(poses):
        x, y, z, w, *place = (float(v) for v in numbers(values, 7, metadata, f"pose {number}"))
        world_from_cam = np.eye(4)
        world_from_cam[:3, :3] = rotation_of_quaternion(w, x, y, z, f"{metadata}, pose {number}")
        world_from_cam[:3, 3] = place
        lens = _record3d_lens(content, None if each is None else each[number], metadata)
        pose = pose_from_center(world_from_cam @ FROM_OPENGL, f"{metadata}, pose {number}")
        registered.append(Registered(name=str(number), lens=lens, cam_from_world=pose))
    kept = keyframes([item for item in registered if find_photo(item.name, photos) is not None])
    gathered = gather(kept or registered, photos, source=metadata)
    return ForeignScene(
        program=RECORD3D,
        files=(metadata,),
        photos=gathered.photos,
        metric=True,
        left_out=gathered.missing,
        remarks=(_METRES, *_thinned(len(registered), len(kept))),
    )


def _record3d_lens(content: Mapping[str, Any], own: Any, metadata: Path) -> Lens:
    size = [content.get("w"), content.get("h")]
    if own is not None:
        return _lens([*numbers(own, 4, metadata, "perFrameIntrinsicCoeffs"), *size], metadata)
    matrix = numbers(content.get("K"), 9, metadata, "K").reshape(3, 3).T
    return _lens([matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *size], metadata)


def _pose(world_from_cam: Floats, file: Path) -> Floats:
    return pose_from_center(Z_UP_FROM_Y_UP @ world_from_cam @ FROM_OPENGL, str(file))


def _lens(values: Sequence[Any], file: Path) -> Lens:
    fx, fy, cx, cy, width, height = (float(v) for v in numbers(list(values), 6, file, "focal lengths, middle and size"))
    return Lens(width=round(width), height=round(height), fx=fx, fy=fy, cx=cx, cy=cy)


def _thinned(all_frames: int, kept: int) -> tuple[str, ...]:
    return (f"of {all_frames} frames {kept} are used, a step or a turn apart",) if kept < all_frames else ()
