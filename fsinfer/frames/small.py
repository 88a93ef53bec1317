"""Small copies of photographs and frames, as they are judged, compared and shown."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray


def small_copy(picture: NDArray[np.uint8], longest_px: int) -> NDArray[np.uint8]:
    """A uint8 picture (H, W) or (H, W, 3) whose longer side is ``longest_px``; one that is smaller as it is.

    A strip keeps a pixel of its width, and is as much longer.
    """
    height, width = picture.shape[:2]
    scale = max(longest_px / max(height, width), 1 / min(height, width))
    if scale >= 1:
        return picture
    return np.asarray(cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), dtype=np.uint8)
