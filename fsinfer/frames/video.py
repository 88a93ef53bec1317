"""Frames of a video: often enough that each shares most of its view with the last, the sharpest near each time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import ImageError
from fsinfer.frames.quality import score_frame
from fsinfer.frames.settings import VideoSettings
from fsinfer.frames.view_shift import ViewChange
from fsinfer.progress import Progress

#: The way of the picture is looked up so often. Source: numerics; every third frame of 30 a second.
_LOOK_S = 0.095
#: A frame may be taken once the picture has moved by this share of what it may move. Source: judgement.
_READY = 0.5
#: A frame is sharp that has this share of the median sharpness of so many taken before. Source: one
#: rendered video of a walker; renders only.
_SHARP_ENOUGH, _REMEMBERED = 0.7, 20
#: Rate of a video that tells none, frames a second. Source: usual for phones.
_USUAL_RATE = 30.0
#: Time stamps nearer than this are the same, seconds. Source: numerics.
_SAME_S = 1e-6
#: A video that can be read for less of what it says it holds is cut short. Source: judgement; containers without an
#: index estimate the number of their frames.
_WHOLE = 0.9
#: A clip that a phone records round a photo lasts no longer, seconds. Source: format; Apple's Live Photos have 3 s.
_LIVE_S = 4.0


@dataclass(frozen=True, kw_only=True)
class VideoFrame:
    """``image`` is (H, W, 3) uint8 RGB, upright; ``time_s`` counts from the start of the video."""

    index: int
    time_s: float
    image: NDArray[np.uint8]


def sharpest_frames(
    path: Path,
    *,
    settings: VideoSettings,
    progress: Progress,
    cut_short: Callable[[float, float], None] = lambda _read_s, _length_s: None,
) -> Iterator[VideoFrame]:
    """Yield the frames that ``settings`` ask for, in order; the rotation that the phone noted in the file is applied.

    ``cut_short`` is called at the end of a video that says it lasts longer than it can be read: both in seconds.

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
        for frame in _readable(_choose(capture, settings, progress, cut_short), path):
            found = True
            yield frame
        if not found:
            msg = f"{path} holds no frame that can be decoded; save it as MP4 (H.264) or give a folder of photos"
            raise ImageError(msg)
    finally:
        capture.release()


def is_live_photo(path: Path) -> bool:
    """Whether a clip is as short as those that phones record by themselves round each photo."""
    capture = cv2.VideoCapture(str(path))
    try:
        return bool(0 < capture.get(cv2.CAP_PROP_FRAME_COUNT) <= _LIVE_S * _rate(capture))
    finally:
        capture.release()


def _readable(frames: Iterator[VideoFrame], path: Path) -> Iterator[VideoFrame]:
    """The same frames; what OpenCV cannot do with a damaged one is told as an error of the video."""
    try:
        yield from frames
    except cv2.error as error:
        msg = f"{path} is damaged ({error}); copy it again from the camera, or give a folder of photos"
        raise ImageError(msg) from error


def _choose(
    capture: cv2.VideoCapture,
    settings: VideoSettings,
    progress: Progress,
    cut_short: Callable[[float, float], None] = lambda _read_s, _length_s: None,
) -> Iterator[VideoFrame]:
    total = max(0, int(capture.get(cv2.CAP_PROP_FRAME_COUNT)))
    window_s = min(settings.window_s, settings.interval_s)
    change, shift, looked_s = ViewChange(), 0.0, -np.inf
    # The first window opens at the first frame.
    due_s, is_open = 0.0, False
    ripe_s: float | None = None
    best, best_score = None, -1.0
    taken: list[float] = []
    index, time_s = -1, 0.0
    for index, time_s in _times(capture):
        look = time_s >= looked_s + _LOOK_S
        if not look and not is_open:
            continue
        decoded, image = capture.retrieve()
        if not decoded or image is None:
            continue
        frame = VideoFrame(index=index, time_s=time_s, image=np.ascontiguousarray(image[:, :, ::-1], dtype=np.uint8))
        if look:
            shift, looked_s = change.shift(frame.image), time_s
        if best is not None and ripe_s is None and (shift >= settings.max_shift or time_s > due_s + window_s + _SAME_S):
            ripe_s = time_s
        # Where no frame was sharp, it stays open a little longer: a blurred frame joins nothing.
        sharp = not taken or best_score >= _SHARP_ENOUGH * float(np.median(taken))
        if best is not None and ripe_s is not None and (sharp or time_s > ripe_s + window_s):
            yield best
            progress(min(index, total), max(total, index), "reading the video")
            taken = [*taken[-_REMEMBERED:], best_score]
            on_time = ripe_s > due_s + window_s
            due_s = due_s + settings.interval_s if on_time else best.time_s + settings.interval_s - window_s / 2
            change.start(best.image)
            shift, looked_s = change.shift(frame.image), time_s
            is_open, ripe_s, best, best_score = False, None, None, -1.0
        is_open = is_open or shift >= _READY * settings.max_shift or time_s >= due_s - _SAME_S
        if is_open:
            score = score_frame(frame.image).sharpness
            if score > best_score:
                best, best_score = frame, score
    if best is not None:
        yield best
    length_s = total / _rate(capture)
    # Of a varying rate frames and seconds tell apart.
    if index + 1 < _WHOLE * total and time_s < _WHOLE * length_s:
        cut_short(time_s, length_s)


def _rate(capture: cv2.VideoCapture) -> float:
    """Frames a second."""
    rate = float(capture.get(cv2.CAP_PROP_FPS))
    return rate if np.isfinite(rate) and rate > 0 else _USUAL_RATE


def _times(capture: cv2.VideoCapture) -> Iterator[tuple[int, float]]:
    """Number and time of every frame, which is ready to be decoded when it is named."""
    rate = _rate(capture)
    index, last_s = -1, -1.0
    while capture.grab():
        index += 1
        # Phones record at varying rates, so that the time stamp counts, where there is one.
        stamp_s = capture.get(cv2.CAP_PROP_POS_MSEC) / 1000
        last_s = stamp_s if stamp_s > last_s else max(index / rate, last_s + 1 / rate)
        yield index, last_s
