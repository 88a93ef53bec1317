"""Frames of a video: often enough that each shares most of its view with the last, the sharpest near each time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import ImageError
from fsinfer.frame_quality import score_frame
from fsinfer.progress import Progress
from fsinfer.view_change import ViewChange

VIDEO_SUFFIXES = frozenset({".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm", ".3gp", ".mts", ".mpg", ".mpeg"})
#: Of a video of 30 frames a second every third is looked at.
_LOOK_S = 0.095
#: A frame may be taken once the picture has moved by this share of what it may move.
_READY = 0.6


@dataclass(frozen=True, kw_only=True)
class VideoSettings:
    """When the next frame is taken.

    Attributes
    ----------
    interval_s: after so many seconds at the latest (the paper: 2).
    window_s: then the sharpest frame within so many seconds is taken.
    max_shift: sooner where the picture has moved by this share of its width (or height) since the last frame, as it
        does when a person turns or passes a near stem: photos must share two thirds of their view. Of the frames
        that moved by 0.6 of it and more, the sharpest is taken.
    min_gap_s: never sooner than this: who waves the phone about wants no ten frames a second of it.
    """

    interval_s: float = 2.0
    window_s: float = 0.5
    max_shift: float = 0.3
    min_gap_s: float = 0.2


@dataclass(frozen=True, kw_only=True)
class VideoFrame:
    """``image`` is (H, W, 3) uint8 RGB, upright; ``time_s`` counts from the start of the video."""

    index: int
    time_s: float
    image: NDArray[np.uint8]


def sharpest_frames(path: Path, *, settings: VideoSettings, progress: Progress) -> Iterator[VideoFrame]:
    """Yield the frames that ``settings`` ask for, in order; the rotation that the phone noted in the file is applied.

    Raises
    ------
    ImageError
        The file is missing, is no video or holds no frame that can be decoded.
    """
    if not path.is_file():
        msg = f"{path} does not exist; give a folder of photos or a video file"
        raise ImageError(msg)
    if not (settings.interval_s > 0 and settings.window_s >= 0):
        msg = f"the interval between frames is {settings.interval_s} s; give a number above 0"
        raise ImageError(msg)
    capture = cv2.VideoCapture(str(path))
    try:
        if not capture.isOpened():
            msg = f"{path} is no video that can be read; save it as MP4 (H.264) or give a folder of photos"
            raise ImageError(msg)
        capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 1)
        found = False
        for frame in _choose(capture, settings, progress):
            found = True
            yield frame
        if not found:
            msg = f"{path} holds no frame that can be decoded; save it as MP4 (H.264) or give a folder of photos"
            raise ImageError(msg)
    finally:
        capture.release()


def _choose(capture: cv2.VideoCapture, settings: VideoSettings, progress: Progress) -> Iterator[VideoFrame]:
    total = max(0, int(capture.get(cv2.CAP_PROP_FRAME_COUNT)))
    half_s = min(settings.window_s, settings.interval_s) / 2 + 1e-6
    # The first window starts at the first frame.
    target_s, taken_s = half_s, -np.inf
    change = ViewChange()
    best, best_score, shift = None, -1.0, 0.0
    for frame in _looks(capture):
        if shift < settings.max_shift and taken_s > -np.inf:
            shift = change.shift(frame.image)
        early = shift >= settings.max_shift and frame.time_s >= taken_s + settings.min_gap_s
        late = frame.time_s > target_s + half_s
        if (early or late) and (best is not None or early):
            # Where the picture jumps there was no good moment before: then this one is taken.
            chosen = best or frame
            yield chosen
            progress(min(frame.index, total), max(total, frame.index), "reading the video")
            change.start(chosen.image)
            shift = 0.0 if chosen is frame else change.shift(frame.image)
            taken_s, best, best_score = chosen.time_s, None, -1.0
            if early:
                target_s = taken_s + settings.interval_s
            if chosen is frame:
                continue
        while frame.time_s > target_s + half_s:
            target_s += settings.interval_s
        moved = shift >= _READY * settings.max_shift and frame.time_s >= taken_s + settings.min_gap_s
        if moved or frame.time_s >= target_s - half_s:
            score = score_frame(frame.image).sharpness
            if score > best_score:
                best, best_score = frame, score
    if best is not None:
        yield best


def _looks(capture: cv2.VideoCapture) -> Iterator[VideoFrame]:
    """Frames about a tenth of a second apart, with their times; those that cannot be decoded are passed over."""
    rate = capture.get(cv2.CAP_PROP_FPS)
    rate = rate if np.isfinite(rate) and rate > 0 else 30.0
    index, last_s, looked_s = -1, -1.0, -np.inf
    while capture.grab():
        index += 1
        # Phones record at varying rates, so that the time stamp counts, where there is one.
        stamp_s = capture.get(cv2.CAP_PROP_POS_MSEC) / 1000
        time_s = stamp_s if stamp_s > last_s else max(index / rate, last_s + 1 / rate)
        last_s = time_s
        if time_s < looked_s + _LOOK_S:
            continue
        decoded, image = capture.retrieve()
        if decoded and image is not None:
            looked_s = time_s
            yield VideoFrame(index=index, time_s=time_s, image=np.ascontiguousarray(image[:, :, ::-1], dtype=np.uint8))
