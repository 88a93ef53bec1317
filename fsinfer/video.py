"""Frames of a video, one per interval, the sharpest near each time."""

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

VIDEO_SUFFIXES = frozenset({".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm", ".3gp", ".mts", ".mpg", ".mpeg"})


@dataclass(frozen=True, kw_only=True)
class VideoFrame:
    """``image`` is (H, W, 3) uint8 RGB, upright; ``time_s`` counts from the start of the video."""

    index: int
    time_s: float
    image: NDArray[np.uint8]


def sharpest_frames(path: Path, *, interval_s: float, window_s: float, progress: Progress) -> Iterator[VideoFrame]:
    """Yield about one frame every ``interval_s`` seconds: the sharpest within ``window_s`` round each time.

    The rotation that the phone noted in the file is applied.

    Raises
    ------
    ImageError
        The file is missing, is no video or holds no frame that can be decoded.
    """
    if not path.is_file():
        msg = f"{path} does not exist; give a folder of photos or a video file"
        raise ImageError(msg)
    if not (interval_s > 0 and window_s >= 0):
        msg = f"the interval between frames is {interval_s} s; give a number above 0"
        raise ImageError(msg)
    capture = cv2.VideoCapture(str(path))
    try:
        if not capture.isOpened():
            msg = f"{path} is no video that can be read; save it as MP4 (H.264) or give a folder of photos"
            raise ImageError(msg)
        capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 1)
        found = False
        for frame in _choose(capture, interval_s, min(window_s, interval_s), progress):
            found = True
            yield frame
        if not found:
            msg = f"{path} holds no frame that can be decoded; save it as MP4 (H.264) or give a folder of photos"
            raise ImageError(msg)
    finally:
        capture.release()


def _choose(capture: cv2.VideoCapture, interval_s: float, window_s: float, progress: Progress) -> Iterator[VideoFrame]:
    rate = capture.get(cv2.CAP_PROP_FPS)
    rate = rate if np.isfinite(rate) and rate > 0 else 30.0
    frames = max(0, int(capture.get(cv2.CAP_PROP_FRAME_COUNT)))
    half_s = window_s / 2
    # The first window starts at the first frame.
    target_s, best, best_score, index, last_s = half_s, None, -1.0, -1, -1.0
    while capture.grab():
        index += 1
        # Phones record at varying rates, so that the time stamp counts, where there is one.
        stamp_s = capture.get(cv2.CAP_PROP_POS_MSEC) / 1000
        time_s = stamp_s if stamp_s > last_s else max(index / rate, last_s + 1 / rate)
        last_s = time_s
        if time_s > target_s + half_s + 1e-6:
            if best is not None:
                yield best
                progress(min(index, frames), max(frames, index), "reading the video")
            best, best_score = None, -1.0
            while time_s > target_s + half_s + 1e-6:
                target_s += interval_s
        if time_s >= target_s - half_s - 1e-6:
            decoded, image = capture.retrieve()
            if not decoded or image is None:
                continue
            rgb = np.ascontiguousarray(image[:, :, ::-1], dtype=np.uint8)
            score = score_frame(rgb).sharpness
            if score > best_score:
                best, best_score = VideoFrame(index=index, time_s=time_s, image=rgb), score
    if best is not None:
        yield best
