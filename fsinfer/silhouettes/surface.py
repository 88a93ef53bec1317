"""The points of a cloud round a stem, as the fit of its edges counts them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fsinfer.silhouettes.stem_axis import StemAxis
from fsinfer.trees.diameter.faces import FaceSettings

Floats = NDArray[np.float64]


def points_about(xyz: Floats, stem: StemAxis, *, settings: FaceSettings) -> tuple[Floats, Floats]:
    """Offsets (M, 2) along the stem's two directions across, and heights (M,) along it about breast height, metres.

    Taken are the points (N, 3) that :func:`fsinfer.trees.diameter.faces.sharp_faces` may use of it.
    """
    s = settings
    reach = stem.radius_m + s.window_m + s.half_length_m  # however it leans
    near = (np.abs(xyz[:, 0] - stem.breast[0]) <= reach) & (np.abs(xyz[:, 1] - stem.breast[1]) <= reach)
    away = xyz[near] - stem.breast
    height = away @ stem.along
    first, second = stem.across
    kept = np.abs(height) < s.half_length_m
    return np.column_stack([away @ first, away @ second])[kept], height[kept]
