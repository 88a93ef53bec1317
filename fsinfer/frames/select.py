"""Photos and videos to the frames worth using: sharp, well exposed, upright; with a reason for each that is not."""

from __future__ import annotations

import logging
import re
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from fsinfer.errors import ImageError, OutputError
from fsinfer.frames.contact_sheet import Tile, thumbnail, write_contact_sheet
from fsinfer.frames.quality import (
    EQUALIZERS,
    SCORE_SIZE_PX,
    FrameScore,
    equalize,
    is_edited_copy,
    reasons_to_drop,
    score_frame,
)
from fsinfer.frames.settings import FrameSettings, VideoSettings
from fsinfer.frames.table import FrameRow, frames_csv
from fsinfer.frames.times import names_against_times
from fsinfer.frames.video import is_live_photo, sharpest_frames
from fsinfer.io.exif import camera_exif, camera_key, named_camera_exif, shows_sphere
from fsinfer.io.files import copy_file, write_text
from fsinfer.io.images import is_upright_jpeg_or_png, read_image, read_reduced, reduce_image, write_image
from fsinfer.io.names import by_number, sortable
from fsinfer.io.photo_folders import (
    PHOTO_SUFFIXES,
    VIDEO_SUFFIXES,
    folders_of_photos,
    list_images,
    unread_photos,
    unread_videos,
)
from fsinfer.notices.capture import CaptureCode
from fsinfer.notices.notice import Notice, notice
from fsinfer.notices.sentences import sentence, sentences
from fsinfer.progress import Progress, silent
from fsinfer.threads import in_order, photo_threads

__all__ = ["FrameRow", "FrameSettings", "FramesResult", "list_captures", "select_frames"]

_log = logging.getLogger(__name__)
_JPEG_SUFFIXES = frozenset({".jpg", ".jpeg"})
CONTACT_SHEET = "frames_contact.jpg"


@dataclass(frozen=True, kw_only=True)
class FramesResult:
    """The frames that were chosen into ``folder/images``: a row for every candidate, and warnings."""

    folder: Path
    rows: tuple[FrameRow, ...]
    warnings: tuple[Notice, ...] = ()

    @property
    def images(self) -> tuple[Path, ...]:
        """The chosen images in order."""
        return tuple(self.folder / "images" / f"{row.name}.jpg" for row in self.rows if row.kept)


def list_captures(source: Path) -> list[Path]:
    """The photos and videos that ``source`` (a folder or one video) holds, sorted by name, 2 before 10.

    The short clips of Live Photos are not taken.

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
    photos = [] if videos and not _has_photos(source) else list_images(source, videos=VIDEO_SUFFIXES)
    return sorted([*photos, *_without_live_photos(videos, photos)], key=lambda path: by_number(path.name))


def _has_photos(folder: Path) -> bool:
    return any(path.suffix.lower() in PHOTO_SUFFIXES and not path.name.startswith(".") for path in folder.iterdir())


def _without_live_photos(videos: Sequence[Path], photos: Sequence[Path]) -> list[Path]:
    """The videos without the clips of seconds that a phone records by itself round each photo, and names like it."""
    names = {path.stem.casefold() for path in photos}
    return [path for path in videos if path.stem.casefold() not in names or not is_live_photo(path)]


def frame_stems(paths: Sequence[Path]) -> dict[Path, str]:
    """What the frame of each photo, or those of each video, are called: its own name, in the order of its numbers."""
    stems = sortable(sorted({path.stem for path in paths}))
    return {path: stems[path.stem] for path in paths}


def select_frames(
    source: Path | str, out: Path | str, *, settings: FrameSettings | None = None, progress: Progress = silent
) -> FramesResult:
    """Choose frames and write ``out/images/NAME.jpg``, ``out/frames.csv`` and ``out/frames_contact.jpg``.

    Frames keep the names of their photos, except where the numbers in these have several lengths; see
    :func:`frame_stems`.

    A folder may hold photos and videos of several cameras: each video is judged by itself, and gets a calibration of
    its own later. The contact sheet shows what was dropped and why; there is none when nothing was.

    A photo that cannot be read is a row with a reason, not the end: it may be one of a hundred. Photos may differ in
    size. What an earlier call chose into ``out`` goes.

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
    _clear(out)
    # From here on the folder is known for this stage's, also after a kill.
    write_text(out / "frames.csv", frames_csv(()))
    tiles: list[Tile] = []
    rows: list[FrameRow] = []
    stems = frame_stems(paths)
    clips = [path for path in paths if path.suffix.lower() in VIDEO_SUFFIXES or not source.is_dir()]
    photos = [path for path in paths if path not in clips]
    if photos:
        rows += _from_photos(photos, stems, out / "images", settings, tiles, progress)
    names = [row.name for row in rows]
    cut: list[Notice] = []
    for clip in clips:
        # Clips of several phones may have one size: the name of the clip in the metadata keeps their lenses apart.
        exif = named_camera_exif(f"clip {clip.name}") if len(paths) > 1 else None
        try:
            rows += _from_video(clip, stems[clip], out / "images", settings, exif, names, tiles, cut, progress)
        except ImageError as error:
            if len(paths) == 1:
                raise
            rows.append(_row(stems[clip], clip.name, None, None, notice(CaptureCode.unreadable, error=str(error))))
    rows.sort(key=lambda row: row.name)
    write_contact_sheet(out / CONTACT_SHEET, tiles, total=len(rows))
    write_text(out / "frames.csv", frames_csv(rows))
    warnings = (*_warnings(rows), *cut, *names_against_times(photos), *_beside(source, out))
    result = FramesResult(folder=out, rows=tuple(rows), warnings=warnings)
    if not result.images:
        counts = "; ".join(sorted({row.reason for row in rows if row.reason}))
        msg = f"none of the {len(rows)} photos in {source} can be used ({counts}); see {out / 'frames.csv'}"
        raise ImageError(msg)
    for warning in sentences(result.warnings):
        _log.warning(warning)
    return result


def _from_photos(
    paths: Sequence[Path],
    stems: Mapping[Path, str],
    folder: Path,
    settings: FrameSettings,
    tiles: list[Tile],
    progress: Progress,
) -> list[FrameRow]:
    scores: dict[Path, FrameScore] = {}
    reasons: dict[Path, Notice | None] = {}
    first_of: dict[str, Path] = {}
    first_error: ImageError | None = None

    def look(path: Path) -> FrameScore | ImageError:
        try:
            return score_frame(read_image(path, at_least_px=SCORE_SIZE_PX))
        except ImageError as error:
            return error

    for done, (path, score) in enumerate(zip(paths, in_order(look, paths, photo_threads()), strict=True)):
        progress(done, 2 * len(paths), "judging photos")
        if isinstance(score, ImageError):
            first_error = first_error or score
            reasons[path] = notice(CaptureCode.unreadable, error=str(score))
            continue
        if path.stem in first_of:
            # Many phones write IMG_1.HEIC and IMG_1.JPG of the same moment.
            reasons[path] = notice(CaptureCode.same_name, other=first_of[path.stem].name)
            continue
        first_of[path.stem] = path
        scores[path] = score
    if not scores and first_error is not None:
        raise first_error
    usable = list(scores)
    found = reasons_to_drop([scores[path] for path in usable], settings.limits, [_camera(path) for path in usable])
    for path, reason in zip(usable, found, strict=True):
        # No lens makes such a picture, and what is worked out from it after many minutes is none of the plot.
        reasons[path] = notice(CaptureCode.whole_sphere) if shows_sphere(path) else reason
    kept = {path: scores[path] for path in usable if reasons[path] is None}
    reasons |= {path: notice(CaptureCode.same_picture, other=one.name) for path, one in _copies(kept).items()}

    def write(path: Path) -> Tile | None:
        reason = reasons[path]
        if reason is None:
            _write_photo(path, folder / f"{stems[path]}.jpg", settings)
            return None
        unreadable = reason.code == CaptureCode.unreadable
        small = None if unreadable else thumbnail(read_image(path, at_least_px=SCORE_SIZE_PX))
        return Tile(image=small, name=path.name, reason=sentence(reason))

    for done, tile in enumerate(in_order(write, paths, photo_threads())):
        progress(len(paths) + done, 2 * len(paths), "writing frames")
        if tile is not None:
            tiles.append(tile)
    progress(2 * len(paths), 2 * len(paths), "writing frames")
    return [_row(stems[path], path.name, None, scores.get(path), reasons[path]) for path in paths]


def _copies(scores: Mapping[Path, FrameScore]) -> dict[Path, Path]:
    """Photos that are the same picture as another, with that one: of each picture the photo of the shortest name stays.

    ``Copy of IMG_1.jpg`` stands far from ``IMG_1.jpg``. Both would be source views of others, and one witness of their
    depth would count as two. So would ``IMG_1-edited.jpg``, which is known by its name and what it shows.
    """
    same: dict[tuple[object, ...], list[Path]] = {}
    for path, score in scores.items():
        same.setdefault((score.sharpness, score.mean_luminance, score.thumbnail.tobytes()), []).append(path)
    found: dict[Path, Path] = {}
    for paths in same.values():
        first = min(paths, key=lambda path: len(path.stem))
        found |= {path: first for path in paths if path != first}
    by_stem = {path.stem.casefold(): path for path in scores if path not in found}
    for path in [path for path in scores if path not in found]:
        originals = [by_stem[stem] for stem in _stems_before_editing(path.stem.casefold()) if stem in by_stem]
        alike = (one for one in originals if is_edited_copy(scores[one].thumbnail, scores[path].thumbnail))
        if (original := next(alike, None)) is not None:
            found[path] = original
    return found


def _stems_before_editing(stem: str) -> list[str]:
    """What the photo may be called that one of this name, in lower case, was made of; the shortest first.

    Phones and their clouds add to its name (``-edited``, in the user's language; ``~2``), iPhones a letter before the
    number: ``img_e1234``.
    """
    longer = [stem[: sign.start()] for sign in re.finditer(r"[^0-9a-z]", stem) if sign.start()]
    return [*longer, *([stem.replace("_e", "_", 1)] if re.fullmatch(r"img_e\d+", stem) else [])]


def _camera(path: Path) -> tuple[str, ...]:
    """Maker, model and lens of a photo; one turned upright has the same, so that its size is left out."""
    return camera_key(path)[2:]


def _write_photo(path: Path, target: Path, settings: FrameSettings) -> None:
    jpeg = settings.equalize == "none" and path.suffix.lower() in _JPEG_SUFFIXES
    if jpeg and is_upright_jpeg_or_png(path, longest_px=settings.longest_px):
        copy_file(path, target)
        return
    image = equalize(read_reduced(path, settings.longest_px), settings.equalize)
    write_image(target, image, quality=settings.jpeg_quality, exif=camera_exif(path))


def _from_video(
    path: Path,
    stem: str,
    folder: Path,
    settings: FrameSettings,
    exif: bytes | None,
    taken: list[str],
    tiles: list[Tile],
    cut: list[Notice],
    progress: Progress,
) -> list[FrameRow]:
    found: list[tuple[str, float, FrameScore]] = []
    stem = stem.replace(" ", "_")
    # IMG_1.mov beside IMG_1.mp4, or beside a photo IMG_1_000030.jpg.
    while any(name.startswith(f"{stem}_") for name in taken):
        stem += "_clip"
    video = VideoSettings(interval_s=settings.interval_s, window_s=settings.window_s, max_shift=settings.max_shift)

    def cut_short(read_s: float, length_s: float) -> None:
        cut.append(
            notice(CaptureCode.video_cut_short, name=path.name, read_s=round(read_s, 1), length_s=round(length_s, 1))
        )

    frames = sharpest_frames(path, settings=video, progress=progress, cut_short=cut_short)
    for frame in frames:
        name = f"{stem}_{frame.index:06d}"
        score = score_frame(frame.image)
        image = equalize(reduce_image(frame.image, settings.longest_px), settings.equalize)
        write_image(folder / f"{name}.jpg", image, quality=settings.jpeg_quality, exif=exif)
        found.append((name, frame.time_s, score))
    reasons = reasons_to_drop([score for _, _, score in found], settings.limits)
    rows = []
    for (name, time_s, score), reason in zip(found, reasons, strict=True):
        if reason is not None:
            tiles.append(Tile(image=thumbnail(read_image(folder / f"{name}.jpg")), name=name, reason=sentence(reason)))
            (folder / f"{name}.jpg").unlink(missing_ok=True)
        rows.append(_row(name, path.name, time_s, score, reason))
    taken += [row.name for row in rows]
    return rows


def _row(name: str, source: str, time_s: float | None, score: FrameScore | None, reason: Notice | None) -> FrameRow:
    return FrameRow(
        name=name,
        source=source,
        time_s=time_s,
        sharpness=None if score is None else score.sharpness,
        mean_luminance=None if score is None else score.mean_luminance,
        dark_share=None if score is None else score.dark_share,
        bright_share=None if score is None else score.bright_share,
        kept=reason is None,
        reason="" if reason is None else sentence(reason),
    )


def _warnings(rows: Sequence[FrameRow]) -> tuple[Notice, ...]:
    dropped = [row for row in rows if not row.kept]
    if not dropped:
        return ()
    rejected = tuple(f"{row.source if row.time_s is None else row.name}: {row.reason}" for row in dropped)
    return (notice(CaptureCode.frames_not_used, frames=len(rows), rejected=rejected),)


def _beside(source: Path, out: Path) -> tuple[Notice, ...]:
    """What lies in folders within ``source``, and pictures in it of other kinds, which nobody looked at."""
    if not source.is_dir():
        return ()
    own = {path.resolve() for path in (out, *out.parents)}
    found = {
        name: count
        for name, count in folders_of_photos(source, PHOTO_SUFFIXES | VIDEO_SUFFIXES).items()
        if (source / name).resolve() not in own
    }
    told = []
    if unread := unread_photos(source):
        told.append(notice(CaptureCode.photos_not_read, kinds=tuple(unread), photos=sum(unread.values())))
    if spheres := unread_videos(source):
        told.append(notice(CaptureCode.videos_not_read, kinds=tuple(spheres), videos=sum(spheres.values())))
    if found:
        told.append(notice(CaptureCode.photos_in_folders, names=tuple(found), photos=sum(found.values())))
    return tuple(told)


def _clear(out: Path) -> None:
    """Take away the frames of an earlier choice, so that two choices never mix."""
    if not (out / "frames.csv").is_file():
        if any((out / "images").glob("*")):
            msg = f"{out / 'images'} holds files that this stage did not make; choose another output folder"
            raise OutputError(msg)
        return
    try:
        shutil.rmtree(out / "images", ignore_errors=True)
        for name in ("frames.csv", CONTACT_SHEET):
            (out / name).unlink(missing_ok=True)
    except OSError as error:
        msg = f"cannot clear {out} ({error.strerror or error}); choose another output folder"
        raise OutputError(msg) from error
