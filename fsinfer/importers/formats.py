"""Which program a scene is from, and its reader."""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
#: Files that are a scene by themselves, and what knows them.
_ALONE = (("*.xml", is_metashape), ("*.mvs", is_openmvs))


def reader_of(source: Path, images: Path | None = None) -> Callable[[], ForeignScene] | None:
    """What reads ``source``, a file or a folder; None where it is of no format that is known here.

    ``images`` is the folder of its photographs, where that does not lie beside it.
    """
    found = _file(source) if source.is_file() else _folder(source) if source.is_dir() else None
    if found is None:
        return None
    reader, folders = found
    return partial(reader, [images] if images is not None else folders)


def _file(path: Path) -> tuple[Reader, list[Path]] | None:
    beside = _beside(path.parent)
    if is_metashape(path):
        return partial(read_metashape, path), beside
    if is_openmvs(path):
        return partial(read_openmvs, path), beside
    if path.suffix.lower() == ".json" and _has_frames(path):
        return partial(read_transforms, path), beside
    if path.name in ("cameras.bin", "cameras.txt", "images.bin", "images.txt") and find_models(path.parent):
        return partial(read_colmap, path.parent), beside
    return None


def _folder(folder: Path) -> tuple[Reader, list[Path]] | None:
    models = find_models(folder)
    if models:
        return partial(read_colmap, models[0], others=models[1:]), _beside(models[0])
    if (folder / TRANSFORMS).is_file():
        return partial(read_transforms, folder / TRANSFORMS), _beside(folder)
    polycam = find_polycam(folder)
    if polycam is not None:
        return partial(read_polycam, polycam[0]), [polycam[1]]
    if is_scanner_app(folder):
        return partial(read_scanner_app, folder), [folder]
    metadata = find_record3d(folder)
    if metadata is not None:
        return partial(read_record3d, metadata), [folder / "rgb", folder / "rgbd"]
    poses = find_rtabmap(folder)
    if poses is not None:
        return partial(read_rtabmap, poses), folders_of(poses, "rgb")
    # A file alone of its kind: the folder of an export is a scene as well.
    for pattern, fits in _ALONE:
        files = [path for path in sorted(folder.glob(pattern)) if fits(path)]
        if len(files) == 1:
            return _file(files[0])
    return None


def camera_files(folder: Path) -> tuple[Path, ...]:
    """Files among those that the reader of this folder reads for its cameras, which tell it from another scene."""
    models = find_models(folder)
    if models:
        return colmap_cameras(models[0])
    if (folder / TRANSFORMS).is_file():
        return (folder / TRANSFORMS,)
    polycam = find_polycam(folder)
    if polycam is not None:
        return tuple(sorted(polycam[0].glob("*.json")))
    if is_scanner_app(folder):
        return tuple(sorted(folder.glob("frame_*.json")))
    alone = find_record3d(folder) or find_rtabmap(folder)
    if alone is not None:
        return (alone,)
    files = (path for pattern, fits in _ALONE for path in sorted(folder.glob(pattern)) if fits(path))
    return tuple(files)[:1]


def _beside(folder: Path) -> list[Path]:
    return [folder / part for part in _BESIDE]


def _has_frames(path: Path) -> bool:
    try:
        with path.open("rb") as stream:
            return b'"frames"' in stream.read(1 << 20) or path.name == TRANSFORMS
    except OSError:
        return False
