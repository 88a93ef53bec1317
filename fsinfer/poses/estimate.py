"""Photos to a scene in MVSNet format: structure from motion, undistortion, source views, depth ranges."""

from __future__ import annotations

import json
import logging
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import ImageError, OutputError, PosesError
from fsinfer.io.exif import camera_exif, camera_key
from fsinfer.io.files import copy_file, make_folder, write_text
from fsinfer.io.images import is_upright_jpeg_or_png, read_image, read_reduced, write_image
from fsinfer.io.walk_order import list_walk
from fsinfer.notices.capture import CaptureCode
from fsinfer.notices.notice import Notice, notice
from fsinfer.notices.numbers import counted
from fsinfer.notices.sentences import sentences
from fsinfer.poses.adjustment.adjust import adjust_photos
from fsinfer.poses.adjustment.tell import told
from fsinfer.poses.colmap import colmap_errors
from fsinfer.poses.colmap_calls import require_pycolmap
from fsinfer.poses.mapping import ADVICE, Walk, map_walk
from fsinfer.poses.refinement import larger_than_usual, refine
from fsinfer.poses.scene_files import Photo, write_scene
from fsinfer.poses.settings import PoseSettings
from fsinfer.poses.verification.misplaced import LEFT_OUT, drop_blind_views
from fsinfer.progress import Progress, silent
from fsinfer.scale.markers_seen import FILE as MARKERS_SEEN
from fsinfer.threads import in_order, one_blas_thread

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class PosesResult:
    """What structure from motion found.

    Attributes
    ----------
    scene: folder in MVSNet format, with the COLMAP model of its images in ``sparse``.
    photos: how many were given.
    registered: how many have a pose.
    left_out: names of those that have none.
    warnings: with the names of photos left out.
    rolling_shutter_px, focal_std_percent, principal_std_px: see
        :class:`fsinfer.poses.adjustment.adjust.PhotoAdjustment`; None where the photos do not bear it out.
    """

    scene: Path
    photos: int
    registered: int
    left_out: tuple[str, ...] = ()
    warnings: tuple[Notice, ...] = ()
    rolling_shutter_px: float | None = None
    focal_std_percent: float | None = None
    principal_std_px: float | None = None


@one_blas_thread()
def estimate_poses(
    images: Path | str,
    out: Path | str,
    *,
    settings: PoseSettings | None = None,
    origin: Path | None = None,
    resume: bool = False,
    progress: Progress = silent,
) -> PosesResult:
    """Find where each photo was taken and write ``out`` as a scene.

    Photos of different cameras or sizes may be mixed: each camera and size gets a calibration of its own. Photos
    that cannot be read or have no place in the largest model are left out with a warning; those larger than
    ``settings.longest_px`` are reduced before anything else, and the scene's images are as large as that.

    Parameters
    ----------
    images: folder of photos; above ``settings.pairs.exhaustive_up_to`` of them in the order of walking, see
        :func:`~fsinfer.io.walk_order.list_walk`.
    out: folder for ``images``, ``cams``, ``pair.txt``, ``sparse``, ``markers_seen.json`` and ``poses.json``.
    origin: what messages call the photos: the folder or video that the user gave and ``images`` were chosen from.
    resume: go on from the database in ``out/work``, which an attempt with the same photos and settings left; else it
        goes, and so does a scene that this stage made.

    Raises
    ------
    ImageError
        The folder is missing or empty, or no photo in it can be read.
    PosesError
        Fewer than ``settings.min_registered`` photos could be placed.
    OutputError
        ``out`` cannot be written.
    """
    images, out, settings = Path(images), Path(out), settings or PoseSettings()
    given = origin or images
    require_pycolmap()
    paths = list_walk(images)
    if images.resolve().is_relative_to((out / "images").resolve()):
        msg = f"{images} would be overwritten by the scene; choose another output folder than {out}"
        raise ImageError(msg)
    if len(paths) == 1:
        msg = (
            f"{given} holds one photo that can be used; depth needs at least {settings.min_registered} from different "
            f"places: {ADVICE}"
        )
        raise PosesError(msg)
    work = _work_folder(out, resume=resume)
    warnings: list[Notice] = []
    photos = _prepare(paths, work / "images", settings, warnings, progress)
    if len(photos) < settings.min_registered:
        many = counted(len(photos), "photo", "photos")
        msg = f"{given} holds {many} that can be used, {settings.min_registered} are needed: {ADVICE}"
        raise PosesError(msg)
    with colmap_errors("finding poses", work):
        mapped = map_walk(_walk_of(photos), given, work, settings, progress)
        model, misplaced = refine(mapped.model, settings.refinement, progress), mapped.misplaced
        larger, threads = larger_than_usual(model), settings.thread_count
        model, adjustment = adjust_photos(
            model, settings.adjustment, larger, progress, images=work / "images", threads=threads
        )
    drop_blind_views(model)
    placed = {model.images[i].name for i in model.reg_image_ids()}
    named = {file for files in (*misplaced.values(), *mapped.apart) for file in files}
    misplaced["unplaced"] = [file for file in (photo.file for photo in photos) if file not in placed | named]
    names = {photo.file: photo.name for photo in photos}
    for how, files in misplaced.items():
        if files:
            warnings.append(notice(LEFT_OUT[how], photos=len(photos), names=tuple(names[file] for file in files)))
    if mapped.joined:
        warnings.append(notice(CaptureCode.parts_joined, names=tuple(names[file] for file in mapped.joined)))
    for part in mapped.apart:
        warnings.append(notice(CaptureCode.part_apart, photos=len(photos), names=tuple(names[file] for file in part)))
    warnings.extend(told(adjustment, settings.adjustment, larger_than_usual(model)))
    seen = write_scene(model, photos, out, settings, adjustment, progress, sightings=mapped.sightings)
    for warning in sentences(warnings):
        _log.warning(warning)
    result = PosesResult(
        scene=out,
        photos=len(paths),
        registered=len(seen),
        left_out=tuple(sorted({path.stem for path in paths} - set(seen))),
        warnings=tuple(warnings),
        rolling_shutter_px=adjustment.rolling_shutter_px,
        focal_std_percent=adjustment.focal_std_percent,
        principal_std_px=adjustment.principal_std_px,
    )
    views = {i: Path(model.images[i].name).stem for i in model.reg_image_ids()}
    record = {"photos": result.photos, "registered": result.registered, "warnings": sentences(result.warnings)}
    write_text(out / "poses.json", json.dumps(record | _quality(model) | adjustment.record(views), indent=1) + "\n")
    shutil.rmtree(work, ignore_errors=True)
    return result


def _work_folder(out: Path, *, resume: bool) -> Path:
    """``out/work``, emptied unless the stage goes on with it; old results go, so that none are mixed."""
    make_folder(out)
    work = out / "work"
    try:
        if (out / "poses.json").is_file() or work.is_dir():
            # Only a folder that this stage began or finished is cleared: nothing of the user's can be in it.
            for name in ("images", "cams", "sparse"):
                shutil.rmtree(out / name, ignore_errors=True)
            for name in ("poses.json", MARKERS_SEEN):
                (out / name).unlink(missing_ok=True)
        elif any((out / "images").glob("*")) or any((out / "cams").glob("*")):
            msg = f"{out} holds images or cams that this stage did not make; choose another output folder"
            raise OutputError(msg)
        if work.is_dir() and not resume:
            shutil.rmtree(work)
    except OSError as error:
        msg = f"cannot clear {out} ({error.strerror or error}); choose another output folder"
        raise OutputError(msg) from error
    return make_folder(work)


def _prepare(
    paths: Sequence[Path], folder: Path, settings: PoseSettings, warnings: list[Notice], progress: Progress
) -> list[Photo]:
    """Put every usable photo into ``folder``, upright, not too large, under a name that COLMAP's lists can hold."""
    make_folder(folder)
    photos: list[Photo] = []
    names: dict[str, Path] = {}
    first_error: ImageError | None = None
    progress(0, len(paths), "reading photos")
    looked_at = in_order(lambda path: _usable(path, settings.longest_px), paths, settings.photo_threads)
    for done, (path, usable) in enumerate(zip(paths, looked_at, strict=True)):
        progress(done, len(paths), "reading photos")
        # Many phones write IMG_1.HEIC and IMG_1.JPG of the same moment.
        if path.stem in names:
            warnings.append(notice(CaptureCode.photo_of_same_name, name=path.name, other=names[path.stem].name))
            continue
        if isinstance(usable, ImageError):
            first_error = first_error or usable
            warnings.append(notice(CaptureCode.photo_unreadable, error=str(usable)))
            continue
        names[path.stem] = path
        file = f"{done:05d}{path.suffix.lower() if usable is None else '.jpg'}"
        if not (folder / file).is_file():
            if usable is None:
                copy_file(path, folder / file)
            else:
                write_image(folder / file, usable, quality=settings.jpeg_quality, exif=camera_exif(path))
        photos.append(Photo(name=path.stem, source=path, file=file))
    if not photos and first_error is not None:
        raise first_error
    return photos


def _usable(path: Path, longest_px: int) -> NDArray[np.uint8] | ImageError | None:
    """A photo's pixels, upright and reduced; None where its file is read as it is; or what is wrong with it."""
    try:
        if is_upright_jpeg_or_png(path, longest_px=longest_px):
            # Decoded at an eighth a cut file is an error, too.
            read_image(path, at_least_px=1)
            return None
        return read_reduced(path, longest_px)
    except ImageError as error:
        return error


def _walk_of(photos: Sequence[Photo]) -> Walk:
    """The photos in the order of walking, grouped by what shares a calibration."""
    cameras: dict[tuple[str, ...], list[str]] = {}
    for photo in photos:
        cameras.setdefault(camera_key(photo.source), []).append(photo.file)
    return Walk(
        files=tuple(photo.file for photo in photos), cameras={" ".join(key): files for key, files in cameras.items()}
    )


def _quality(model: Any) -> dict[str, float | None]:
    """Figures that tell a good model from a poor one, for ``poses.json``; None for those that are no number."""
    figures: dict[str, float] = {
        "points": int(model.num_points3D()),
        "mean_reprojection_error_px": round(float(model.compute_mean_reprojection_error()), 4),
        "mean_track_length": round(float(model.compute_mean_track_length()), 3),
        "observations_per_photo": round(float(model.compute_mean_observations_per_reg_image()), 1),
    }
    # A point in the plane of a camera has no place in its photo.
    return {name: value if np.isfinite(value) else None for name, value in figures.items()}
