"""COLMAP's models, text and binary, read without COLMAP: cameras, images and points3D.

``cam_from_world`` is a quaternion (w, x, y, z) and a translation; camera axes x right, y down, z forward. The centre of
the top left pixel lies at (0.5, 0.5). Lengths have no unit. Source: COLMAP's documentation, "Output Format", and its
camera models.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from fsinfer.errors import SceneError
from fsinfer.importers.files import MOST, ByteReader, numbers, read_text, unfit
from fsinfer.importers.foreign import Floats, ForeignScene, near_origin, rotation_of_quaternion
from fsinfer.importers.lens import Lens
from fsinfer.importers.photos import Registered, gather
from fsinfer.notices.numbers import counted
from fsinfer.poses.sparse import SparseModel

PROGRAM = "COLMAP"
#: Where a project keeps its models; # stands for any number.
MODEL_FOLDERS = (".", "sparse/#", "sparse", "#", "colmap/sparse/#", "dense/sparse", "dense/#/sparse")
#: Models that a remark names. Source: layout.
_MODELS_TOLD = 3
#: Number, name, and count of parameters of each camera model. Source: format; COLMAP's camera models.
_MODELS = {
    0: ("SIMPLE_PINHOLE", 3),
    1: ("PINHOLE", 4),
    2: ("SIMPLE_RADIAL", 4),
    3: ("RADIAL", 5),
    4: ("OPENCV", 8),
    5: ("OPENCV_FISHEYE", 8),
    6: ("FULL_OPENCV", 12),
    7: ("FOV", 5),
    8: ("SIMPLE_RADIAL_FISHEYE", 4),
    9: ("RADIAL_FISHEYE", 5),
    10: ("THIN_PRISM_FISHEYE", 12),
    11: ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    12: ("SIMPLE_DIVISION", 4),
    13: ("DIVISION", 5),
    14: ("SIMPLE_FISHEYE", 3),
    15: ("FISHEYE", 4),
    16: ("EUCM", 6),
    17: ("EQUIRECTANGULAR", 2),
}
_READ = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV")


@dataclass(frozen=True, kw_only=True)
class _Image:
    """One line of ``images``; ``number`` is what tracks name it by."""

    number: int
    name: str
    camera: int
    cam_from_world: Floats


@dataclass(kw_only=True)
class _Points:
    """Tie points while they are read; ``seen`` are their ranks by the number of the image."""

    xyz: list[tuple[float, ...]] = field(default_factory=list)
    errors_px: list[float] = field(default_factory=list)
    lengths: list[int] = field(default_factory=list)
    seen: dict[int, list[int]] = field(default_factory=dict)

    def add(self, xyz: tuple[float, ...], error_px: float, images: Sequence[int]) -> None:
        """One point and the images that it was seen in."""
        for image in set(images):
            self.seen.setdefault(int(image), []).append(len(self.xyz))
        self.lengths.append(len(images))
        self.xyz.append(xyz)
        self.errors_px.append(error_px)


def find_models(path: Path) -> tuple[Path, ...]:
    """The folders of the COLMAP models in a project or scene, the one with the most images first; none where none is.

    The mapper numbers what it could not join in the order in which it was begun, not by size. Models of one place in a
    project are looked at; those of the next one only where there is none.
    """
    for part in MODEL_FOLDERS:
        found = [folder for folder in _numbered(path, part) if _suffix(folder) is not None]
        if found:
            # Counting takes a look into the files, which is spared where there is nothing to choose.
            return tuple(sorted(found, key=_images_in, reverse=True) if len(found) > 1 else found)
    return ()


def _numbered(path: Path, part: str) -> list[Path]:
    """The folders that ``part`` stands for, by their numbers."""
    before, number, after = part.partition("#")
    if not number:
        return [path / part]
    parent = path / before
    names = [item.name for item in parent.iterdir() if item.name.isdecimal()] if parent.is_dir() else []
    return [parent / name / after.strip("/") for name in sorted(names, key=int)]


def camera_files(model: Path) -> tuple[Path, ...]:
    """The files of a model that its cameras are read from; none where it is none."""
    suffix = _suffix(model)
    return () if suffix is None else (model / f"cameras{suffix}", model / f"images{suffix}")


def _suffix(folder: Path) -> str | None:
    """Of the files of a model; None where there is none."""
    for suffix in (".bin", ".txt"):
        if all((folder / f"{name}{suffix}").is_file() for name in ("cameras", "images")):
            return suffix
    return None


def _images_in(folder: Path) -> int:
    """How many images a model has; 0 where it is damaged, which is no reason to refuse the others."""
    path = folder / f"images{_suffix(folder)}"
    try:
        return ByteReader(path).count("Q", 73) if path.suffix == ".bin" else sum(1 for _ in _text_images(path))
    except SceneError:
        return 0


def _others(folder: Path, others: Sequence[Path]) -> tuple[str, ...]:
    """What to tell of models that are not used."""
    if not others:
        return ()
    told = [f"{other} ({counted(_images_in(other), 'image', 'images')})" for other in others[:_MODELS_TOLD]]
    told += ["..."] if len(others) > _MODELS_TOLD else []
    return (
        f"the project has {len(others) + 1} models that were not joined; {folder}, with the most images "
        f"({_images_in(folder)}), is used and the others are left out: {', '.join(told)}; give the folder of one of "
        "them to use that",
    )


def read_colmap(folder: Path, photos: Sequence[Path], *, others: Sequence[Path] = ()) -> ForeignScene:
    """Read the model in ``folder``; ``photos`` are the folders in which its photographs may lie.

    ``others`` are models of the same project that are left out, which a remark tells.

    Raises
    ------
    SceneError
        A file is damaged, a camera is a fisheye, or no photograph is found.
    """
    suffix = _suffix(folder) or ".txt"
    files = [folder / f"{name}{suffix}" for name in ("cameras", "images", "points3D")]
    lenses = dict(_binary_cameras(files[0]) if suffix == ".bin" else _text_cameras(files[0]))
    images = list(_binary_images(files[1]) if suffix == ".bin" else _text_images(files[1]))
    registered = []
    for image in images:
        if image.camera not in lenses:
            raise unfit(files[1], f"{image.name} has camera {image.camera}, which {files[0].name} does not")
        registered.append(
            Registered(
                name=image.name, lens=lenses[image.camera], cam_from_world=image.cam_from_world, number=image.number
            )
        )
    gathered = gather(registered, photos, source=files[1])
    sparse = None
    if files[2].is_file():
        points = _binary_points(files[2]) if suffix == ".bin" else _text_points(files[2])
        sparse = _sparse(points, {number: name for name, number in gathered.numbers.items()})
    scene = ForeignScene(
        program=PROGRAM,
        files=tuple(file for file in files if file.is_file()),
        photos=gathered.photos,
        sparse=sparse,
        left_out=gathered.missing,
        remarks=(*_others(folder, others), *gathered.remarks),
    )
    # Aligned to markers or GNSS, its coordinates are those of a national grid, or count from the middle of the Earth.
    return near_origin(scene)


def _sparse(points: _Points, names: dict[int, str]) -> SparseModel | None:
    if not points.xyz:
        return None
    return SparseModel(
        points=np.array(points.xyz, dtype=np.float64),
        errors_px=np.array(points.errors_px, dtype=np.float64),
        track_lengths=np.array(points.lengths, dtype=np.int64),
        observations={names[n]: np.array(ranks, dtype=np.int64) for n, ranks in points.seen.items() if n in names},
    )


def _lens(path: Path, model: str, width: int, height: int, given: Sequence[float]) -> Lens:
    if model not in _READ:
        msg = (
            f"{path}: a camera has the model {model}, which is not read ({', '.join(_READ)} are); undistort the "
            "photographs with colmap image_undistorter and give the folder that it writes"
        )
        raise SceneError(msg)
    count = next(count for name, count in _MODELS.values() if name == model)
    values = [float(v) for v in numbers(given, count, path, f"the parameters of a {model} camera")]
    one_focal = model in ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
    fx, fy, cx, cy, *bent = [values[0], *values] if one_focal else values
    full = model == "FULL_OPENCV"
    tangential = (bent[2], bent[3]) if len(bent) >= 4 else (0.0, 0.0)
    return Lens(
        width=width,
        height=height,
        fx=fx,
        fy=fy,
        cx=cx - 0.5,
        cy=cy - 0.5,
        radial=(*bent[:2], *(bent[4:5] if full else ())),
        divisor=tuple(bent[5:8]) if full else (),
        tangential=tangential,
    )


def _binary_cameras(path: Path) -> Iterator[tuple[int, Lens]]:
    reader = ByteReader(path)
    for _ in range(reader.count("Q", 40)):
        number, model, width, height = reader.take("iiQQ")
        if model not in _MODELS:
            raise unfit(path, f"there is no camera model {model}")
        name, count = _MODELS[model]
        yield int(number), _lens(path, name, int(width), int(height), reader.take(f"{count}d"))


def _binary_images(path: Path) -> Iterator[_Image]:
    reader = ByteReader(path)
    for _ in range(reader.count("Q", 73)):
        number, *pose, camera = reader.take("i7di")
        name = reader.text_to_nul()
        reader.skip(24 * reader.count("Q", 24))
        yield _Image(number=int(number), name=name, camera=int(camera), cam_from_world=_pose(pose, path, name))


def _binary_points(path: Path) -> _Points:
    reader = ByteReader(path)
    points = _Points()
    for _ in range(reader.count("Q", 51)):
        _, x, y, z, _, _, _, error = reader.take("Q3d3Bd")
        track = reader.array("<u4", 2 * reader.count("Q", 8))
        points.add((x, y, z), error, track[::2].tolist())
    return _finite(points, path)


def _lines(path: Path) -> Iterator[str]:
    return (line for line in read_text(path).splitlines() if not line.startswith("#"))


def _text_cameras(path: Path) -> Iterator[tuple[int, Lens]]:
    for line in _lines(path):
        words = line.split()
        if not words:
            continue
        try:
            number, model, width, height = int(words[0]), words[1], int(words[2]), int(words[3])
        except (ValueError, IndexError) as error:
            raise unfit(path, f"{line[:60]!r} is no camera") from error
        yield number, _lens(path, model, width, height, words[4:])  # type: ignore[arg-type]


def _text_images(path: Path) -> Iterator[_Image]:
    lines = _lines(path)
    for line in lines:
        if not line.strip():
            continue
        words = line.split(maxsplit=9)
        try:
            number, camera, name = int(words[0]), int(words[8]), words[9].strip()
        except (ValueError, IndexError) as error:
            raise unfit(path, f"{line[:60]!r} is no image") from error
        _observations(next(lines, ""), path, name)
        pose = numbers(words[1:8], 7, path, f"the pose of {name}")
        yield _Image(number=number, name=name, camera=camera, cam_from_world=_pose(pose, path, name))


def _observations(line: str, path: Path, name: str) -> None:
    """Refuse a line behind that of an image which is not its observations: an empty one, or one that ends in a number.

    Who leaves the empty lines out loses every second image, and COLMAP itself reads no such file.
    """
    try:
        float(line.rsplit(maxsplit=1)[-1] if line.strip() else 0)
    except ValueError as error:
        raise unfit(
            path, f"the line behind {name} is not its observations; each image has two lines, the second may be empty"
        ) from error


def _text_points(path: Path) -> _Points:
    points = _Points()
    for line in _lines(path):
        words = line.split()
        if not words:
            continue
        try:
            x, y, z, error = (float(words[index]) for index in (1, 2, 3, 7))
            images = [int(word) for word in words[8::2]]
        except (ValueError, IndexError) as wrong:
            raise unfit(path, f"{line[:60]!r} is no point") from wrong
        points.add((x, y, z), error, images)
    return _finite(points, path)


def _finite(points: _Points, path: Path) -> _Points:
    if points.xyz and not (np.abs(points.xyz) < MOST).all():
        raise unfit(path, "a point has no finite coordinates")
    return points


def _pose(values: Sequence[float] | Floats, path: Path, name: str) -> Floats:
    pose = np.eye(4)
    w, x, y, z, *place = (float(value) for value in numbers(list(values), 7, path, f"the pose of {name}"))
    pose[:3, :3] = rotation_of_quaternion(w, x, y, z, f"{path}, {name}")
    pose[:3, 3] = place
    return pose
