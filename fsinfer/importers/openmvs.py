"""OpenMVS's interface format (``scene.mvs`` as converters from COLMAP, OpenMVG and others write it), versions 1 to 7.

A platform holds cameras and poses; an image names one of each. ``x_cam = R (x - C)``; a camera may have a rotation
and a place on its platform. Integer coordinates are pixel centres; intrinsics without a size are divided by the longer
side, by newer versions with the principal point counted from the corner of the picture; one of 0, 0 is the middle.
Images are undistorted already. Source: OpenMVS, ``libs/MVS/Interface.h`` (its structures and their order) and
``Camera.h`` (``GetK``, ``ScaleK``).

Not read: the project format of OpenMVS itself (it begins with MVS instead of MVSI), which its own tools write.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fsinfer.errors import SceneError
from fsinfer.importers.files import MOST, ByteReader, find_photo, numbers, unfit
from fsinfer.importers.foreign import Floats, ForeignScene, exact_rotation, near_origin
from fsinfer.importers.lens import Lens
from fsinfer.importers.photos import Registered, gather
from fsinfer.io.images import image_size
from fsinfer.poses.sparse import SparseModel

PROGRAM = "OpenMVS"
_MAGIC, _PROJECT = b"MVSI", b"MVS\0"
#: The newest version that is known, and the number that stands for none. Source: format.
_VERSION, _NONE = 7, 0xFFFFFFFF
#: Vertices kept; of denser clouds every so many-th tells ranges and neighbours as well. Source: numerics.
_MOST_VERTICES = 500_000


@dataclass(frozen=True, kw_only=True)
class _Camera:
    width: int
    height: int
    intrinsic: Floats
    rotation: Floats
    center: Floats


@dataclass(frozen=True, kw_only=True)
class _Platform:
    cameras: tuple[_Camera, ...]
    poses: tuple[tuple[Floats, Floats], ...]


def is_openmvs(path: Path) -> bool:
    """Whether a file is a scene of OpenMVS, of either format."""
    if path.suffix.lower() != ".mvs":
        return False
    try:
        with path.open("rb") as stream:
            return stream.read(4) in (_MAGIC, _PROJECT)
    except OSError:
        return False


def read_openmvs(path: Path, photos: Sequence[Path]) -> ForeignScene:
    """Read ``scene.mvs``; ``photos`` are the folders in which its photographs may lie.

    Raises
    ------
    SceneError
        It is damaged, of a newer version, or the project format, or no photograph is found.
    """
    reader = ByteReader(path)
    magic = bytes(reader.array("u1", 4))
    if magic == _PROJECT:
        msg = f"{path} is a project of OpenMVS, not its interface format; give the scene.mvs that it was begun with"
        raise SceneError(msg)
    if magic != _MAGIC:
        raise unfit(path, "it does not begin with MVSI")
    version, _ = reader.take("II")
    if version > _VERSION:
        raise unfit(path, f"version {version}; up to {_VERSION} are known")
    platforms = [_platform(reader, version) for _ in range(reader.count("Q", 24))]
    registered, left_out = [], []
    for number in range(reader.count("Q", 28)):
        name, platform, camera, pose = _image(reader, version)
        if pose == _NONE:
            left_out.append(name)
            continue
        try:
            chosen = platforms[platform].cameras[camera]
            rotation, center = platforms[platform].poses[pose]
        except IndexError as error:
            raise unfit(path, f"{name} names a camera or a pose that is not there") from error
        where = f"{path}, {name}"
        for part in (chosen.rotation, chosen.center, rotation, center):
            numbers(part, part.size, path, f"the pose of {name}")
        cam_from_world = np.eye(4)
        cam_from_world[:3, :3] = exact_rotation(chosen.rotation @ rotation, where)
        place = rotation.T @ chosen.center + center
        cam_from_world[:3, 3] = numbers(-cam_from_world[:3, :3] @ place, 3, path, f"the place of {name}")
        lens = _lens(chosen, find_photo(name, photos), path)
        if lens is not None:
            registered.append(Registered(name=name, lens=lens, cam_from_world=cam_from_world, number=number))
        else:
            left_out.append(name)
    if not registered and left_out:
        looked = " or ".join(str(folder) for folder in dict.fromkeys(photos))
        msg = f"none of the photographs of {path} ({left_out[0]}, ...) is in {looked}; give their folder with --images"
        raise SceneError(msg)
    gathered = gather(registered, photos, source=path)
    sparse = _vertices(reader, {number: name for name, number in gathered.numbers.items()})
    scene = ForeignScene(
        program=PROGRAM,
        files=(path,),
        photos=gathered.photos,
        sparse=sparse,
        left_out=(*left_out, *gathered.missing),
        remarks=gathered.remarks,
    )
    # Aligned to markers or GNSS, its coordinates are those of a national grid, or count from the middle of the Earth.
    return near_origin(scene)


def _string(reader: ByteReader) -> str:
    return reader.text(reader.count("Q", 1))


def _platform(reader: ByteReader, version: int) -> _Platform:
    _string(reader)
    cameras = []
    for _ in range(reader.count("Q", 176)):
        _string(reader)
        if version > 3:
            _string(reader)
        width, height = reader.take("II") if version > 0 else (0, 0)
        intrinsic, rotation = (reader.array("<f8", 9).reshape(3, 3) for _ in range(2))
        center = reader.array("<f8", 3)
        cameras.append(
            _Camera(width=int(width), height=int(height), intrinsic=intrinsic, rotation=rotation, center=center)
        )
    poses = []
    for _ in range(reader.count("Q", 96)):
        rotation = reader.array("<f8", 9).reshape(3, 3)
        poses.append((rotation, reader.array("<f8", 3)))
    return _Platform(cameras=tuple(cameras), poses=tuple(poses))


def _image(reader: ByteReader, version: int) -> tuple[str, int, int, int]:
    name = _string(reader)
    if version > 4:
        _string(reader)
    platform, camera, pose = reader.take("III")
    if version > 2:
        reader.skip(4)
    if version > 6:
        reader.skip(12)
        reader.skip(24 * reader.count("Q", 24))
    return name, int(platform), int(camera), int(pose)


def _lens(camera: _Camera, photo: Path | None, path: Path) -> Lens | None:
    """The lens in pixels; None where neither the file nor the photograph says how large that is."""
    width, height, intrinsic = camera.width, camera.height, camera.intrinsic
    numbers(intrinsic, 9, path, "the intrinsics of a camera")
    if not (width and height):
        if photo is None:
            return None
        width, height = image_size(photo, upright=False)
        intrinsic = _in_pixels(intrinsic, width, height)
    return Lens(
        width=width,
        height=height,
        fx=float(intrinsic[0, 0]),
        fy=float(intrinsic[1, 1]),
        cx=float(intrinsic[0, 2]),
        cy=float(intrinsic[1, 2]),
        skew=float(intrinsic[0, 1]),
    )


def _in_pixels(normalized: Floats, width: int, height: int) -> Floats:
    """Intrinsics (3, 3) that were divided by the longer side, in pixels.

    The file does not tell which way its writer did that. The two differ by half of the longer side, so that only one of
    them has the principal point anywhere near the middle.
    """
    longer = max(width, height)
    intrinsic = normalized * longer
    middle = np.array([width - 1, height - 1]) / 2
    given = normalized[:2, 2]
    ways = [given * longer, (given + 0.5) * longer - 0.5] if given.any() else [middle]
    intrinsic[:2, 2] = min(ways, key=lambda point: float(np.linalg.norm(point - middle)))
    return np.asarray(intrinsic)


def _vertices(reader: ByteReader, names: dict[int, str]) -> SparseModel | None:
    count = reader.count("Q", 20)
    step = max(1, -(-count // _MOST_VERTICES))
    xyz: list[Floats] = []
    lengths: list[int] = []
    seen: dict[str, list[int]] = {name: [] for name in names.values()}
    for rank in range(count):
        place = reader.array("<f4", 3)
        views = reader.array("<u4", 2 * reader.count("Q", 8))
        if rank % step or not (np.abs(place) < MOST).all():
            continue
        images = views[::2].tolist()
        for image in set(images) & names.keys():
            seen[names[image]].append(len(xyz))
        xyz.append(place)
        lengths.append(len(images))
    if not xyz:
        return None
    return SparseModel(
        points=np.array(xyz, dtype=np.float64),
        errors_px=np.zeros(len(xyz)),
        track_lengths=np.array(lengths, dtype=np.int64),
        observations={name: np.array(ranks, dtype=np.int64) for name, ranks in seen.items()},
    )
