"""How far the picture of a walking phone has moved since a frame: corners are followed from look to look."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fsinfer.frames.small import small_copy

#: Longer side at which corners are followed, pixels: a blur of 20 pixels of full HD is 3 there. Source: numerics.
LOOK_SIZE_PX = 320
#: Corners followed at most; how good the worst of them is beside the best, and how far apart they are, pixels. Source:
#: numerics.
_MOST_CORNERS, _WORST_CORNER, _CORNERS_APART_PX = 200, 0.01, 7
#: With fewer corners nothing can be told. Source: judgement.
_FEWEST_CORNERS = 25
#: A corner followed there and back ends so near to where it began, in pixels of the small picture. Source: judgement.
_RETURN_PX = 1.0
#: Window and levels of the pyramid: 15 pixels at a sixteenth. Source: numerics.
_FLOW = {"winSize": (15, 15), "maxLevel": 4}


class ViewChange:
    """Follows the corners of one frame through the frames after it (Lucas and Kanade in a pyramid).

    Corners near and far are followed alike, so that turning and walking sideways both count, while a shaking hand comes
    back to where it was. Pictures are (H, W, 3) uint8 RGB, all of one size.
    """

    def __init__(self) -> None:
        self._last: NDArray[np.uint8] | None = None
        self._first_px = self._now_px = np.zeros((0, 2), np.float32)
        self._corners = 0

    def start(self, image: NDArray[np.uint8]) -> None:
        """Take ``image`` as the frame from which the change is counted."""
        small = _small(image)
        # None on a picture without any.
        found: Any = cv2.goodFeaturesToTrack(small, _MOST_CORNERS, _WORST_CORNER, _CORNERS_APART_PX)
        corners = np.zeros((0, 2), np.float32) if found is None else np.asarray(found, np.float32).reshape(-1, 2)
        self._last, self._first_px, self._now_px, self._corners = small, corners, corners, len(corners)

    def shift(self, image: NDArray[np.uint8]) -> float:
        """Median way of the corners since the start, as a share of the picture's width (height, where that is more).

        1 where half of them are out of sight; 0 where there never were enough to tell, as on a black frame.
        """
        if self._last is None or self._corners < _FEWEST_CORNERS:
            return 0.0
        small = _small(image)
        if len(self._now_px):
            there, ok, _ = cv2.calcOpticalFlowPyrLK(self._last, small, self._now_px, None, **_FLOW)  # type: ignore[call-overload]
            back, ok_back, _ = cv2.calcOpticalFlowPyrLK(small, self._last, there, None, **_FLOW)  # type: ignore[call-overload]
            size = np.array([small.shape[1], small.shape[0]], np.float32)
            alive = (ok.ravel() == 1) & (ok_back.ravel() == 1)
            alive &= np.linalg.norm(back - self._now_px, axis=1) < _RETURN_PX
            alive &= ((there >= 0) & (there < size)).all(axis=1)
            self._first_px, self._now_px = self._first_px[alive], np.asarray(there[alive], np.float32)
        self._last = small
        # The median of all corners: one out of sight has moved farther than any other.
        ways = np.ones(self._corners)
        moved = np.abs(self._now_px - self._first_px) / np.array([small.shape[1], small.shape[0]])
        ways[: len(moved)] = moved.max(axis=1)
        return float(np.median(ways))


def _small(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return small_copy(np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), dtype=np.uint8), LOOK_SIZE_PX)
