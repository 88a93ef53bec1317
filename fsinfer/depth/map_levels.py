"""Feature maps as a graph in 8 bits gives them out: in levels, with the channels last.

The 32 bits that the cost volume wants are a table of 256 numbers away. A graph that gave them itself would compute its
last convolutions in 32 bits, and put what they give into another order twice.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fsinfer.depth.cost_volume import Features

Float32 = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class MapLevels:
    """Levels of 8 bits of a feature map.

    Attributes
    ----------
    scale: from one level to the next. zero_point: level of zero, 0 to 255.
    """

    scale: float
    zero_point: int

    @classmethod
    def noted(cls, notes: Mapping[str, str], output: str) -> MapLevels | None:
        """Those noted in an ONNX file of one of its outputs, or ``None``; raises ValueError where they cannot be."""
        names = _notes_of(output)
        if not any(name in notes for name in names):
            return None
        scale, zero_point = (float(notes.get(name, "nan")) for name in names)
        if not (0 < scale < np.inf and 0 <= zero_point <= 255 and zero_point == int(zero_point)):
            msg = f"its levels of {output} are {[notes.get(name) for name in names]}"
            raise ValueError(msg)
        return cls(scale=scale, zero_point=int(zero_point))

    def notes(self, output: str) -> dict[str, str]:
        """What :meth:`noted` reads."""
        return dict(zip(_notes_of(output), (repr(self.scale), str(self.zero_point)), strict=True))

    def features(self, levels: NDArray[np.uint8], width: int) -> Features:
        """The feature map, ``width`` pixels wide, of levels (H, W, C); of rows that are longer their beginnings.

        Raises
        ------
        ValueError
            They are less wide, or C is no multiple of four.
        """
        _, columns, channels = levels.shape
        if channels % 4 or not levels.size or columns < width:
            msg = f"{levels.shape} levels are not rows of {width} pixels with a multiple of four channels"
            raise ValueError(msg)
        # Four channels at a time are one number.
        fours = np.ascontiguousarray(levels).view(np.uint32)[:, :width]
        return Features(
            groups=tuple(
                np.asarray(cv2.LUT(np.ascontiguousarray(fours[..., i : i + 1]).view(np.uint8), self._table), np.float32)
                for i in range(channels // 4)
            )
        )

    @property
    def _table(self) -> Float32:
        """(1, 256): the number of each level."""
        return ((np.arange(256, dtype=np.float32) - self.zero_point) * np.float32(self.scale))[None]


def features_of(output: NDArray[np.generic], levels: MapLevels | None, width: int) -> Features:
    """The feature map, ``width`` pixels wide, of what a graph gives out: levels, or (1, C, H, W) in 32 bits.

    Raises
    ------
    ValueError
        It is of another shape, or C is no multiple of four.
    """
    if levels is not None and output.ndim == 4 and len(output) == 1 and output.dtype == np.uint8:
        return levels.features(output[0], width)
    if levels is not None or output.dtype != np.float32 or output.ndim != 4 or output.shape[1] % 4 or not output.size:
        msg = f"{output.dtype} of {output.shape} are not (1, C, h, w) with C a multiple of 4"
        raise ValueError(msg)
    return Features.from_chw(np.asarray(output[0], np.float32))


def _notes_of(output: str) -> tuple[str, str]:
    """Names of the attributes among what is noted in an ONNX file."""
    return f"{output}_scale", f"{output}_zero_point"
