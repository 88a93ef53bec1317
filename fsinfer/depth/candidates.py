"""Which surface a pixel between cells of a volume at an eighth of the resolution lies on: the candidates of each.

A pixel at a quarter of the resolution has as candidates the planes round what its own cell of the wide volume says, and
round the least and the greatest of the nine cells there, which at a silhouette hold different surfaces (the propagation
of PatchMatch, Barnes et al. 2009). Their correlations at a quarter of the resolution decide. The same in PyTorch is
``training/model/candidates.py``.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from fsinfer.depth.cost_volume import upsample_index, upsample_twice

Float32 = NDArray[np.float32]

#: Difference of two indices that counts as another surface for sure, planes. Source: the training.
_FAR_APART = np.float32(8.0)


def spread_indices(index_hw: Float32, height: int, width: int) -> Float32:
    """Own, least and greatest index (3, height, width) at twice the resolution of ``index_hw``: of a pixel's cell, and
    of the cell and its eight neighbours.
    """
    window = np.ones((3, 3), np.uint8)
    # Beyond the border OpenCV leaves cells out, as a repeated border would.
    least, greatest = (
        part.repeat(2, axis=0).repeat(2, axis=1)[:height, :width]
        for part in (cv2.erode(index_hw, window), cv2.dilate(index_hw, window))
    )
    return np.stack([upsample_index(index_hw, height, width), least, greatest])


def candidate_planes(centres_3hw: Float32, *, around: int, step: float) -> Float32:
    """(3 ``around``, h, w) plane indices: ``around`` of each of :func:`spread_indices`, ``step`` planes apart."""
    offsets = (np.arange(around, dtype=np.float32) - np.float32((around - 1) / 2)) * np.float32(step)
    planes: Float32 = centres_3hw[:, None] + offsets[:, None, None]
    return planes.reshape(3 * around, *centres_3hw.shape[1:])


def hints(planes_dhw: Float32, confidence_hw: Float32) -> Float32:
    """(3, H, W) in [0, 1]: how far the least and the greatest candidates lie from the own, and the confidence.

    ``confidence_hw`` (h, w) is that of the wide volume, at half the resolution of the (D, H, W) candidates.
    """
    own, least, greatest = planes_dhw[:: len(planes_dhw) // 3]
    steps = np.stack([own - least, greatest - own]) / _FAR_APART
    sure = upsample_twice(confidence_hw, *own.shape)
    return np.concatenate([np.clip(steps, 0, 1, out=steps), sure[None]])
