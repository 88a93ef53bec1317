"""Pictures inside the page: encoded as WebP and written as data, so that nothing refers to another file."""

from __future__ import annotations

import base64
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

# Bark and leaves still look natural; half the size of 90.
WEBP_QUALITY = 78


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A picture with its caption.

    Attributes
    ----------
    source: a ``data:`` address with the encoded picture.
    caption: plain text below it.
    alt: plain text that is read out in its place.
    """

    source: str
    caption: str
    alt: str


def picture_of(image: NDArray[np.uint8], caption: str, *, alt: str | None = None) -> Picture:
    """Encode an (H, W, 3) RGB image; without ``alt`` the caption is read out."""
    options = [cv2.IMWRITE_WEBP_QUALITY, WEBP_QUALITY]
    _, data = cv2.imencode(".webp", np.ascontiguousarray(image[..., ::-1]), options)
    source = f"data:image/webp;base64,{base64.b64encode(data.tobytes()).decode('ascii')}"
    return Picture(source=source, caption=caption, alt=alt or caption)


def shrink(image: NDArray[np.uint8], width_px: int) -> NDArray[np.uint8]:
    """An (H, W, 3) image that is at most ``width_px`` wide."""
    height, width = image.shape[:2]
    if width <= width_px:
        return image
    size = (width_px, max(1, round(height * width_px / width)))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
