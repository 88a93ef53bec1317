"""Photos or a video to the frames worth using: sharp, well exposed, upright, with a reason for each that is not."""

from __future__ import annotations

import csv
import io
import json
import logging
import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from fsinfer.errors import ImageError, OutputError
from fsinfer.files import make_folder, write_text
from fsinfer.frame_quality import (
    EQUALIZERS,
    FrameScore,
    QualityLimits,
    equalize,
    reasons_to_drop,
    score_frame,
)
from fsinfer.images import camera_exif, is_upright_jpeg_or_png, list_images, read_image, write_image
from fsinfer.progress import Progress, silent
from fsinfer.stages import file_digest
from fsinfer.video import sharpest_frames

__all__ = ["FrameRow", "FrameSettings", "FramesResult", "select_frames"]

_log = logging.getLogger(__name__)
_JPEG_SUFFIXES = frozenset({".jpg", ".jpeg"})


@dataclass(frozen=True, kw_only=True)
class FrameSettings:
    """How frames are chosen.

    Attributes
    ----------
    interval_s: seconds of video between frames (the paper: 2).
    window_s: the sharpest frame within so many seconds round each time is taken.
    equalize: ``none``, ``clahe`` or ``hist`` (the paper's histogram equalization). None by default: SIFT and the depth
        network take out brightness and contrast themselves, upright photos are copied without coding them again,
        and the colours of the cloud stay those of the photos.
    limits: when a frame is dropped.
    jpeg_quality: of frames that are written anew; upright JPEG photos are copied as they are.
    """

    interval_s: float = 2.0
    window_s: float = 0.5
    equalize: str = "none"
    limits: QualityLimits = field(default_factory=QualityLimits)
    jpeg_quality: int = 97


@dataclass(frozen=True, kw_only=True)
class FrameRow:
    """One line of ``frames.csv``; scores as in :class:`fsinfer.frame_quality.FrameScore`, empty if unreadable.

    Attributes
    ----------
    name: of the frame in ``images``, without suffix.
    source: file that it comes from.
    time_s: in the video, None for photos.
    kept: whether it was chosen.
    reason: why not, empty where chosen.
    """

    name: str
    source: str
    time_s: float | None
    sharpness: float | None
    mean_luminance: float | None
    dark_share: float | None
    bright_share: float | None
    kept: bool
    reason: str


@dataclass(frozen=True, kw_only=True)
class FramesResult:
    """The chosen images in order, a row for every candidate, and sentences for the user."""

    images: tuple[Path, ...]
    rows: tuple[FrameRow, ...]
    warnings: tuple[str, ...] = ()


def select_frames(
    source: Path | str, out: Path | str, *, settings: FrameSettings | None = None, progress: Progress = silent
) -> FramesResult:
    """Choose frames and write ``out/images/NAME.jpg`` and ``out/frames.csv``.

    A photo that cannot be read is a row with a reason, not the end: it may be one of a hundred. Photos may differ in
    size. Called again with the same source and settings it returns what was chosen before.

    Parameters
    ----------
    source: folder of photos, or a video.
    out: folder for ``images`` and ``frames.csv``.

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
    paths = list_images(source) if source.is_dir() else [source]
    key = {"settings": asdict(settings), "source": {path.name: file_digest(path) for path in paths}}
    finished = _finished(out, key)
    if finished is not None:
        return finished
    _clear(out)
    write_text(out / "frames.json", json.dumps({"key": None}) + "\n")
    if source.is_dir():
        rows = _from_photos(paths, out / "images", settings, progress)
    else:
        rows = _from_video(source, out / "images", settings, progress)
    images = tuple(out / "images" / f"{row.name}.jpg" for row in rows if row.kept)
    warnings = _warnings(rows)
    write_text(out / "frames.csv", _as_csv(rows))
    write_text(out / "frames.json", json.dumps({"key": key, "warnings": warnings}, indent=1) + "\n")
    if not images:
        counts = "; ".join(sorted({row.reason for row in rows if row.reason}))
        msg = f"none of the {len(rows)} photos in {source} can be used ({counts}); see {out / 'frames.csv'}"
        raise ImageError(msg)
    for warning in warnings:
        _log.warning(warning)
    return FramesResult(images=images, rows=tuple(rows), warnings=tuple(warnings))


def _from_photos(paths: Sequence[Path], folder: Path, settings: FrameSettings, progress: Progress) -> list[FrameRow]:
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


def _from_video(path: Path, folder: Path, settings: FrameSettings, progress: Progress) -> list[FrameRow]:
    found: list[tuple[str, float, FrameScore]] = []
    frames = sharpest_frames(path, interval_s=settings.interval_s, window_s=settings.window_s, progress=progress)
    for frame in frames:
        name = f"{path.stem.replace(' ', '_')}_{frame.index:06d}"
        score = score_frame(frame.image)
        image = equalize(frame.image, settings.equalize)
        write_image(folder / f"{name}.jpg", image, quality=settings.jpeg_quality)
        found.append((name, frame.time_s, score))
    reasons = reasons_to_drop([score for _, _, score in found], settings.limits)
    rows = []
    for (name, time_s, score), reason in zip(found, reasons, strict=True):
        if reason:
            (folder / f"{name}.jpg").unlink(missing_ok=True)
        rows.append(_row(name, path.name, time_s, score, reason))
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


_DIGITS = {"time_s": 3, "sharpness": 6, "mean_luminance": 2, "dark_share": 5, "bright_share": 5}


def _as_csv(rows: Sequence[FrameRow]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    names = [entry.name for entry in fields(FrameRow)]
    writer.writerow(names)
    for row in rows:
        values = asdict(row)
        writer.writerow([_cell(name, values[name]) for name in names])
    return text.getvalue()


def _cell(name: str, value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(int(value))
    return f"{value:.{_DIGITS[name]}f}" if name in _DIGITS else str(value)


def _finished(out: Path, key: dict[str, Any]) -> FramesResult | None:
    """The result of an earlier run with the same source, if all of it is still there."""
    try:
        record = json.loads((out / "frames.json").read_text(encoding="utf-8"))
        if record["key"] != json.loads(json.dumps(key)):
            return None
        with (out / "frames.csv").open(encoding="utf-8", newline="") as stream:
            rows = tuple(_parse(row) for row in csv.DictReader(stream))
        warnings = tuple(record["warnings"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
    images = tuple(out / "images" / f"{row.name}.jpg" for row in rows if row.kept)
    if not images or not all(path.is_file() for path in images):
        return None
    return FramesResult(images=images, rows=rows, warnings=warnings)


def _parse(row: dict[str, str]) -> FrameRow:
    numbers = {name: float(row[name]) if row[name] else None for name in _DIGITS}
    return FrameRow(name=row["name"], source=row["source"], kept=row["kept"] == "1", reason=row["reason"], **numbers)


def _clear(out: Path) -> None:
    """Take away the frames of an earlier choice, so that two choices never mix."""
    if not (out / "frames.json").is_file():
        if any((out / "images").glob("*")):
            msg = f"{out / 'images'} holds files that this stage did not make; choose another output folder"
            raise OutputError(msg)
        return
    try:
        shutil.rmtree(out / "images", ignore_errors=True)
        for name in ("frames.json", "frames.csv"):
            (out / name).unlink(missing_ok=True)
    except OSError as error:
        msg = f"cannot clear {out} ({error.strerror or error}); choose another output folder"
        raise OutputError(msg) from error
