"""Which program a scene is from, and its reader."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from fsinfer.importers.arkit import (
    find_polycam,
    find_record3d,
    is_scanner_app,
    read_polycam,
    read_record3d,
    read_scanner_app,
)
from fsinfer.importers.colmap import camera_files as colmap_cameras
from fsinfer.importers.colmap import find_models, read_colmap
from fsinfer.importers.foreign import ForeignScene
from fsinfer.importers.metashape import is_metashape, read_metashape
from fsinfer.importers.openmvs import is_openmvs, read_openmvs
from fsinfer.importers.rtabmap import find_rtabmap, folders_of, read_rtabmap
from fsinfer.importers.transforms import FILE as TRANSFORMS
from fsinfer.importers.transforms import read_transforms

#: Reads a scene, given the folders in which its photographs may lie.
Reader = Callable[[Sequence[Path]], ForeignScene]
#: Where photographs are looked for beside the files of a scene, from the folder of the file.
_BESIDE = (".", "images", "..", "../images", "../../images", "../../../images")


@dataclass(frozen=True, kw_only=True)
class _Found:
    """A scene: what reads it, the folders in which its photographs may lie, and what tells it from another scene.

    ``cameras`` are files among those that are read for its cameras.
    """

    read: Reader
    photos: list[Path]
    cameras: tuple[Path, ...]


def reader_of(source: Path, images: Path | None = None) -> Callable[[], ForeignScene] | None:
    """What reads ``source``, a file or a folder; None where it is of no format that is known here.

    ``images`` is the folder of its photographs, where that does not lie beside it.
    """
    found = _found(source)
    return None if found is None else partial(found.read, [images] if images is not None else found.photos)


def camera_files(source: Path) -> tuple[Path, ...]:
    """Files among those that are read for the cameras of a scene, which tell it from another; none of no scene."""
    found = _found(source)
    return () if found is None else found.cameras


def _found(source: Path) -> _Found | None:
    return _file(source) if source.is_file() else _folder(source) if source.is_dir() else None


def _file(path: Path) -> _Found | None:
    reader: Reader
    if is_metashape(path):
        reader = partial(read_metashape, path)
    elif is_openmvs(path):
        reader = partial(read_openmvs, path)
    elif path.suffix.lower() == ".json" and _has_frames(path):
        reader = partial(read_transforms, path)
    elif path.name in ("cameras.bin", "cameras.txt", "images.bin", "images.txt") and find_models(path.parent):
        reader = partial(read_colmap, path.parent)
    else:
        return None
    return _Found(read=reader, photos=_beside(path.parent), cameras=(path,))


def _folder(folder: Path) -> _Found | None:
    models = find_models(folder)
    if models:
        reader = partial(read_colmap, models[0], others=models[1:])
        return _Found(read=reader, photos=_beside(models[0]), cameras=colmap_cameras(models[0]))
    transforms = folder / TRANSFORMS
    if transforms.is_file():
        return _Found(read=partial(read_transforms, transforms), photos=_beside(folder), cameras=(transforms,))
    polycam = find_polycam(folder)
    if polycam is not None:
        cameras, photos = polycam
        files = tuple(sorted(cameras.glob("*.json")))
        return _Found(read=partial(read_polycam, cameras), photos=[photos], cameras=files)
    if is_scanner_app(folder):
        files = tuple(sorted(folder.glob("frame_*.json")))
        return _Found(read=partial(read_scanner_app, folder), photos=[folder], cameras=files)
    metadata = find_record3d(folder)
    if metadata is not None:
        photo_folders = [folder / "rgb", folder / "rgbd"]
        return _Found(read=partial(read_record3d, metadata), photos=photo_folders, cameras=(metadata,))
    poses = find_rtabmap(folder)
    if poses is not None:
        return _Found(read=partial(read_rtabmap, poses), photos=folders_of(poses, "rgb"), cameras=(poses,))
    # A file alone of its kind: the folder of an export is a scene as well.
    for pattern, fits in (("*.xml", is_metashape), ("*.mvs", is_openmvs)):
        alone = [path for path in sorted(folder.glob(pattern)) if fits(path)]
        if len(alone) == 1:
            return _file(alone[0])
    return None


def _beside(folder: Path) -> list[Path]:
    return [folder / part for part in _BESIDE]


def _has_frames(path: Path) -> bool:
    try:
        with path.open("rb") as stream:
            return b'"frames"' in stream.read(1 << 20) or path.name == TRANSFORMS
    except OSError:
        return False
