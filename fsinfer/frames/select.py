"""Photos and videos to the frames worth using: sharp, well exposed, upright; with a reason for each that is not."""

from __future__ import annotations

import json
import logging
import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from fsinfer.errors import ImageError, OutputError
from fsinfer.frames.contact_sheet import Tile, thumbnail, write_contact_sheet
from fsinfer.frames.quality import EQUALIZERS, FrameScore, QualityLimits, equalize, reasons_to_drop, score_frame
from fsinfer.frames.table import FrameRow, frames_csv, read_frames_csv
from fsinfer.frames.video import VIDEO_SUFFIXES, VideoSettings, sharpest_frames
from fsinfer.io.digest import file_digest
from fsinfer.io.exif import camera_exif, named_camera_exif
from fsinfer.io.files import make_folder, write_text
from fsinfer.io.images import PHOTO_SUFFIXES, is_upright_jpeg_or_png, list_images, read_image, write_image
from fsinfer.progress import Progress, silent

__all__ = ["FrameRow", "FrameSettings", "FramesResult", "list_captures", "select_frames"]

_log = logging.getLogger(__name__)
_JPEG_SUFFIXES = frozenset({".jpg", ".jpeg"})
CONTACT_SHEET = "frames_contact.jpg"


@dataclass(frozen=True, kw_only=True)
class FrameSettings:
    """How frames are chosen.

    Attributes
    ----------
    interval_s, window_s, max_shift: of video, see :class:`fsinfer.frames.video.VideoSettings`.
    equalize: ``none``, ``clahe`` or ``hist`` (the paper's histogram equalization). None by default: SIFT and the depth
        network take out brightness and contrast themselves, upright photos are copied without coding them again,
        and the colours of the cloud stay those of the photos.
    limits: when a frame is dropped.
    jpeg_quality: of frames that are written anew; upright JPEG photos are copied as they are.
    """

    interval_s: float = 2.0
    window_s: float = 0.5
    max_shift: float = 0.3
    equalize: str = "none"
    limits: QualityLimits = field(default_factory=QualityLimits)
    jpeg_quality: int = 97


@dataclass(frozen=True, kw_only=True)
class FramesResult:
    """The chosen images in order, a row for every candidate, and sentences for the user."""

    images: tuple[Path, ...]
    rows: tuple[FrameRow, ...]
    warnings: tuple[str, ...] = ()


def list_captures(source: Path) -> list[Path]:
    """The photos and videos that ``source`` (a folder or one video) holds, sorted by name.

    Raises
    ------
    ImageError
        It is missing, or a folder without any.
    """
    if not source.is_dir():
        return [source]
    videos = [
        path
        for path in source.iterdir()
        if path.suffix.lower() in VIDEO_SUFFIXES and not path.name.startswith(".") and path.is_file()
    ]
    photos = [] if videos and not _has_photos(source) else list_images(source)
    return sorted([*photos, *videos])


def _has_photos(folder: Path) -> bool:
    return any(path.suffix.lower() in PHOTO_SUFFIXES for path in folder.iterdir())


def select_frames(
    source: Path | str, out: Path | str, *, settings: FrameSettings | None = None, progress: Progress = silent
) -> FramesResult:
    """Choose frames and write ``out/images/NAME.jpg``, ``out/frames.csv`` and ``out/frames_contact.jpg``.

    A folder may hold photos and videos of several cameras: each video is judged by itself, and gets a calibration of
    its own later. The contact sheet shows what was dropped and why; there is none when nothing was.

    A photo that cannot be read is a row with a reason, not the end: it may be one of a hundred. Photos may differ in
    size. Called again with the same source and settings it returns what was chosen before.

    Parameters
    ----------
    source: folder of photos and videos, or a video.
    out: folder for ``images``, ``frames.csv`` and ``frames_contact.jpg``.

    Raises
    ------
    ImageError
        The source is missing or empty, no photo can be read, or none is usable.
    OutputError
        ``out`` cannot be written.
    """
    source, out, settings = Path(source), Path(out), settings or FrameSettings()
    if settings.equalize not in EQUALIZERS:
        msg = f"there is no equalization {settings.equalize!r}; choose one of {', '.join(EQUALIZERS)}"
        raise ImageError(msg)
    if not source.exists():
        msg = f"{source} does not exist; give a folder of photos or a video file"
        raise ImageError(msg)
    if source.resolve().is_relative_to((out / "images").resolve()):
        msg = f"{source} would be overwritten by the chosen frames; choose another output folder than {out}"
        raise ImageError(msg)
    paths = list_captures(source)
    key = {"settings": asdict(settings), "source": {path.name: file_digest(path) for path in paths}}
    finished = _finished(out, key)
    if finished is not None:
        return finished
    _clear(out)
    write_text(out / "frames.json", json.dumps({"key": None}) + "\n")
    tiles: list[Tile] = []
    rows: list[FrameRow] = []
    clips = [path for path in paths if path.suffix.lower() in VIDEO_SUFFIXES or not source.is_dir()]
    photos = [path for path in paths if path not in clips]
    if photos:
        rows += _from_photos(photos, out / "images", settings, tiles, progress)
    names = [row.name for row in rows]
    for clip in clips:
        # Clips of several phones may have one size: the name of the clip in the metadata keeps their lenses apart.
        exif = named_camera_exif(f"clip {clip.name}") if len(paths) > 1 else None
        try:
            rows += _from_video(clip, out / "images", settings, exif, names, tiles, progress)
        except ImageError as error:
            if len(paths) == 1:
                raise
            rows.append(_row(clip.stem, clip.name, None, None, f"cannot be read: {error}"))
    rows.sort(key=lambda row: row.name)
    write_contact_sheet(out / CONTACT_SHEET, tiles, total=len(rows))
    images = tuple(out / "images" / f"{row.name}.jpg" for row in rows if row.kept)
    warnings = _warnings(rows)
    write_text(out / "frames.csv", frames_csv(rows))
    write_text(out / "frames.json", json.dumps({"key": key, "warnings": warnings}, indent=1) + "\n")
    if not images:
        counts = "; ".join(sorted({row.reason for row in rows if row.reason}))
        msg = f"none of the {len(rows)} photos in {source} can be used ({counts}); see {out / 'frames.csv'}"
        raise ImageError(msg)
    for warning in warnings:
        _log.warning(warning)
    return FramesResult(images=images, rows=tuple(rows), warnings=tuple(warnings))


def _from_photos(
    paths: Sequence[Path], folder: Path, settings: FrameSettings, tiles: list[Tile], progress: Progress
) -> list[FrameRow]:
    scores: dict[Path, FrameScore] = {}
    reasons: dict[Path, str] = {}
    first_of: dict[str, Path] = {}
    first_error: ImageError | None = None
    for done, path in enumerate(paths):
        progress(done, 2 * len(paths), "judging photos")
        try:
            score = score_frame(read_image(path))
        except ImageError as error:
            first_error = first_error or error
            reasons[path] = f"cannot be read: {error}"
            continue
        if path.stem in first_of:
            # Many phones write IMG_1.HEIC and IMG_1.JPG of the same moment.
            reasons[path] = f"same name as {first_of[path.stem].name}"
            continue
        first_of[path.stem] = path
        scores[path] = score
    if not scores and first_error is not None:
        raise first_error
    usable = list(scores)
    for path, reason in zip(usable, reasons_to_drop([scores[p] for p in usable], settings.limits), strict=True):
        reasons[path] = reason
    for done, path in enumerate(paths):
        progress(len(paths) + done, 2 * len(paths), "writing frames")
        if not reasons[path]:
            _write_photo(path, folder / f"{path.stem}.jpg", settings)
        else:
            readable = path in scores or not reasons[path].startswith("cannot be read")
            small = thumbnail(read_image(path)) if readable else None
            tiles.append(Tile(image=small, name=path.name, reason=reasons[path]))
    progress(2 * len(paths), 2 * len(paths), "writing frames")
    return [_row(path.stem, path.name, None, scores.get(path), reasons[path]) for path in paths]


def _write_photo(path: Path, target: Path, settings: FrameSettings) -> None:
    copied = settings.equalize == "none" and path.suffix.lower() in _JPEG_SUFFIXES and is_upright_jpeg_or_png(path)
    if copied:
        make_folder(target.parent)
        try:
            shutil.copyfile(path, target)
        except OSError as error:
            msg = f"cannot write {target}: {error.strerror or error}; choose another output folder"
            raise OutputError(msg) from error
        return
    image = equalize(read_image(path), settings.equalize)
    write_image(target, image, quality=settings.jpeg_quality, exif=camera_exif(path))


def _from_video(
    path: Path,
    folder: Path,
    settings: FrameSettings,
    exif: bytes | None,
    taken: list[str],
    tiles: list[Tile],
    progress: Progress,
) -> list[FrameRow]:
    found: list[tuple[str, float, FrameScore]] = []
    stem = path.stem.replace(" ", "_")
    # IMG_1.mov beside IMG_1.mp4, or beside a photo IMG_1_000030.jpg.
    while any(name.startswith(f"{stem}_") for name in taken):
        stem += "_clip"
    video = VideoSettings(interval_s=settings.interval_s, window_s=settings.window_s, max_shift=settings.max_shift)
    frames = sharpest_frames(path, settings=video, progress=progress)
    for frame in frames:
        name = f"{stem}_{frame.index:06d}"
        score = score_frame(frame.image)
        image = equalize(frame.image, settings.equalize)
        write_image(folder / f"{name}.jpg", image, quality=settings.jpeg_quality, exif=exif)
        found.append((name, frame.time_s, score))
    reasons = reasons_to_drop([score for _, _, score in found], settings.limits)
    rows = []
    for (name, time_s, score), reason in zip(found, reasons, strict=True):
        if reason:
            tiles.append(Tile(image=thumbnail(read_image(folder / f"{name}.jpg")), name=name, reason=reason))
            (folder / f"{name}.jpg").unlink(missing_ok=True)
        rows.append(_row(name, path.name, time_s, score, reason))
    taken += [row.name for row in rows]
    return rows


def _row(name: str, source: str, time_s: float | None, score: FrameScore | None, reason: str) -> FrameRow:
    return FrameRow(
        name=name,
        source=source,
        time_s=time_s,
        sharpness=None if score is None else score.sharpness,
        mean_luminance=None if score is None else score.mean_luminance,
        dark_share=None if score is None else score.dark_share,
        bright_share=None if score is None else score.bright_share,
        kept=not reason,
        reason=reason,
    )


def _warnings(rows: Sequence[FrameRow]) -> list[str]:
    dropped = [row for row in rows if not row.kept]
    if not dropped:
        return []
    shown = "; ".join(f"{row.source if row.time_s is None else row.name}: {row.reason}" for row in dropped[:5])
    more = f"; and {len(dropped) - 5} more" if len(dropped) > 5 else ""
    return [f"{len(dropped)} of {len(rows)} frames were not used ({shown}{more})"]


def _finished(out: Path, key: dict[str, Any]) -> FramesResult | None:
    """The result of an earlier run with the same source, if all of it is still there."""
    try:
        record = json.loads((out / "frames.json").read_text(encoding="utf-8"))
        if record["key"] != json.loads(json.dumps(key)):
            return None
        rows = read_frames_csv(out / "frames.csv")
        warnings = tuple(record["warnings"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
    images = tuple(out / "images" / f"{row.name}.jpg" for row in rows if row.kept)
    if not images or not all(path.is_file() for path in images):
        return None
    return FramesResult(images=images, rows=rows, warnings=warnings)


def _clear(out: Path) -> None:
    """Take away the frames of an earlier choice, so that two choices never mix."""
    if not (out / "frames.json").is_file():
        if any((out / "images").glob("*")):
            msg = f"{out / 'images'} holds files that this stage did not make; choose another output folder"
            raise OutputError(msg)
        return
    try:
        shutil.rmtree(out / "images", ignore_errors=True)
        for name in ("frames.json", "frames.csv", CONTACT_SHEET):
            (out / name).unlink(missing_ok=True)
    except OSError as error:
        msg = f"cannot clear {out} ({error.strerror or error}); choose another output folder"
        raise OutputError(msg) from error
