"""The scene that a command is given: a scene folder as it is, a scene of another program as what was made of it.

A foreign scene becomes ``OUT/scene``, so that what follows (``trees``, ``scale``) finds it where a run has its own.
"""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Sequence
from pathlib import Path

from fsinfer.errors import InputError, SceneError
from fsinfer.importers.foreign import ForeignScene
from fsinfer.importers.formats import camera_files, reader_of
from fsinfer.importers.write import ImportedScene, ImportSettings, told, write_scene
from fsinfer.io.digest import file_digest
from fsinfer.io.files import make_folder
from fsinfer.output.layout import CAMERAS_FOLDER, SCENE_FOLDER
from fsinfer.progress import StageProgress, silent_stages
from fsinfer.workflow.ledger import Ledger, Stage
from fsinfer.workflow.settings import speedless

_log = logging.getLogger(__name__)

IMPORT = Stage(name="import", version=3, result=ImportedScene, outputs=(SCENE_FOLDER,))


def our_scene(
    source: Path,
    out: Path,
    *,
    images: Path | None = None,
    settings: ImportSettings | None = None,
    progress: StageProgress = silent_stages,
) -> Path:
    """The scene folder to read for ``source``; what the user has to know of an import is logged as warnings.

    Parameters
    ----------
    source: a scene folder, which is used as it is, or a scene of another program: a file or a folder.
    out: output folder; the import goes into ``OUT/scene``.
    images: folder of the photographs of a foreign scene, where they do not lie beside it.

    Raises
    ------
    InputError
        The photographs would be overwritten, or ``images`` is no folder or was given for a scene folder.
    SceneError
        The foreign scene cannot be read.
    """
    if images is not None and not images.is_dir():
        msg = f"--images {images} is not a folder; give the one that the photographs lie in"
        raise InputError(msg)
    reader = None if (source / CAMERAS_FOLDER).is_dir() else reader_of(source, images)
    if reader is None:
        if images is not None and source.exists():
            msg = f"--images belongs to a scene of another program, and {source} is none that is known here"
            raise InputError(msg)
        return source
    foreign = reader()
    target = out / SCENE_FOLDER
    inside = next((p for p in _paths(foreign) if p.resolve().is_relative_to(target.resolve())), None)
    if inside is not None:
        msg = f"{inside} lies in {target}, which the import empties and fills; choose another output folder"
        raise InputError(msg)
    used = settings or ImportSettings()
    record = Ledger(make_folder(out)).run(
        IMPORT,
        lambda _: write_scene(foreign, target, settings=used, progress=progress("scene")),
        inputs={
            "source": _told_as(source),
            "settings": speedless(used),
            "cameras": _camera_digest(foreign),
            "files": _digests(foreign),
        },
    )
    for sentence in told(record.result):
        _log.warning("%s", sentence)
    return target


def imported_scene(source: Path, out: Path) -> Path:
    """The scene folder to read for ``source`` in a command that follows ``fsinfer depth`` into the same ``out``.

    Raises
    ------
    SceneError
        ``source`` is a foreign scene that was not imported into ``out``.
    """
    if (source / CAMERAS_FOLDER).is_dir() or reader_of(source) is None:
        return source
    inputs = Ledger(out).inputs_of(IMPORT.name) or {}
    made_of = inputs.get("source")
    if made_of != _told_as(source) or not _has_its_cameras(source, inputs.get("files")):
        what = "has no depth maps in" if made_of is None else "is not the scene that was imported into"
        msg = f"{source} {what} {out}; make its depth maps with: fsinfer depth {source} {out}"
        raise SceneError(msg)
    return out / SCENE_FOLDER


def _told_as(source: Path) -> str:
    """What tells one source from another without reading its photographs."""
    return file_digest(source) if source.is_file() else source.resolve().name


def _has_its_cameras(source: Path, imported: object) -> bool:
    """Whether the camera files of a folder are among those ``imported``, by digests: many a project is called colmap.

    Digests have the names of files and not of folders, so that a project may be moved. True for a file, which is told
    by its own digest, and where nothing was noted.
    """
    if source.is_file() or not isinstance(imported, list):
        return True
    return {file_digest(path) for path in camera_files(source)} <= set(imported)


def _paths(foreign: ForeignScene) -> Sequence[Path]:
    return (*foreign.files, *(photo.path for photo in foreign.photos))


def _digests(foreign: ForeignScene) -> list[str]:
    return [file_digest(path) for path in _paths(foreign)]


def _camera_digest(foreign: ForeignScene) -> str:
    """Of what was read: a number in the middle of a file may change and its ends and length stay."""
    digest = hashlib.sha256()
    for photo in foreign.photos:
        digest.update(f"{photo.name} {photo.lens}".encode() + photo.cam_from_world.tobytes())
    if foreign.sparse is not None:
        digest.update(foreign.sparse.points.tobytes())
    return digest.hexdigest()[:24]
