"""How a photograph is given to the network that finds its features.

The network looks at a photograph less the mean of each colour, over its standard deviation and a little more. A graph
in 32 bits does that itself, to each pixel. One in 8 bits would turn what comes out into levels of 8 bits next; and of a
value of 0 to 255 these can only be 256 others, which are looked up in a table of each photograph's own.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]

#: Names of :class:`Levels` among what is noted in an ONNX file. Source: format.
_NOTES = ("levels_scale", "levels_zero_point", "levels_added_deviation", "levels_side_by_side")


@dataclass(frozen=True, kw_only=True)
class Levels:
    """Levels of 8 bits of a photograph that is less its mean, over its standard deviation.

    Attributes
    ----------
    scale: of that to one level. zero_point: level of the mean, 0 to 255.
    added_deviation: grey values added to the standard deviation, so that an even picture stays even.
    side_by_side: pixels of a row that are given as one, their colours after each other, so that the graph fetches
        three colours less often.
    """

    scale: float
    zero_point: int
    added_deviation: float
    side_by_side: int

    @classmethod
    def noted(cls, notes: Mapping[str, str]) -> Levels | None:
        """Those noted in an ONNX file, or ``None``; raises ValueError where they are none that could be."""
        if not any(name in notes for name in _NOTES):
            return None
        scale, zero_point, added, pixels = (float(notes.get(name, "nan")) for name in _NOTES)
        positive = 0 < scale < np.inf and 0 < added < np.inf and 1 <= pixels < np.inf
        if not (positive and 0 <= zero_point <= 255 and zero_point % 1 == pixels % 1 == 0):
            msg = f"its levels are {[notes.get(name) for name in _NOTES]}"
            raise ValueError(msg)
        return cls(scale=scale, zero_point=int(zero_point), added_deviation=added, side_by_side=int(pixels))

    def notes(self) -> dict[str, str]:
        """What :meth:`noted` reads."""
        values = repr(self.scale), str(self.zero_point), repr(self.added_deviation), str(self.side_by_side)
        return dict(zip(_NOTES, values, strict=True))

    def of(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """(1, H, ceil(W / side_by_side), 3 * side_by_side) levels of an (H, W, 3) RGB image; behind it the mean."""
        mean, deviation = (values.ravel() for values in cv2.meanStdDev(image))
        values = (np.arange(256)[:, None] - mean) / (deviation + self.added_deviation)
        table = np.clip(np.rint(values / self.scale) + self.zero_point, 0, 255).astype(np.uint8)
        levels = np.asarray(cv2.LUT(image, table[None]), np.uint8)
        height, width, colours = levels.shape
        missing = -width % self.side_by_side
        if missing:
            levels = np.pad(levels, [(0, 0), (0, missing), (0, 0)], constant_values=self.zero_point)
        return levels.reshape(1, height, -1, self.side_by_side * colours)


def network_input(image: NDArray[np.uint8]) -> Float32:
    """(1, 3, H, W) float32, 0 to 255, of an (H, W, 3) RGB uint8 image."""
    return np.ascontiguousarray(image.transpose(2, 0, 1)[None], dtype=np.float32)
