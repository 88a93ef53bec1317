"""One picture per stem: strips cut from the photographs about breast height, with the edges that made its diameter."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fsinfer.io.images import write_image
from fsinfer.silhouettes.edges import Strip, normal_angles
from fsinfer.silhouettes.stem_axis import StemAxis
from fsinfer.trees.diameter.silhouette import SilhouetteFit

Floats = NDArray[np.float64]
#: Of the fitted edges. Source: layout.
EDGE_COLOUR = (60, 255, 60)
#: Strips of a stem, from directions at least so far apart, the nearest camera first. Source: layout.
MOST_STRIPS, APART_DEG = 8, 20.0
#: Width and height of a strip, strips in a row, and the gap between them. Source: layout.
TILE_PX, COLUMNS, GAP_PX = (320, 200), 4, 4


def keep_strip(kept: list[Strip], strip: Strip) -> None:
    """Keep a strip in ``kept`` if it looks from a new side, or from nearer than the one that looks from this side."""
    cosine = float(np.cos(np.radians(APART_DEG)))
    alike = next((i for i, other in enumerate(kept) if float(other.towards @ strip.towards) > cosine), None)
    if alike is None and len(kept) < MOST_STRIPS:
        kept.append(strip)
    elif alike is not None and strip.pixel_m < kept[alike].pixel_m:
        kept[alike] = strip


def draw_strips(
    path: Path,
    strips: Sequence[Strip],
    names: Sequence[str],
    stem: StemAxis,
    fit: SilhouetteFit,
) -> None:
    """Write the strips as a sheet: each with the fitted edges in green, the photograph's name and the distance."""
    width, height = TILE_PX
    rows = -(-len(strips) // COLUMNS)
    columns = min(COLUMNS, len(strips))
    gap = GAP_PX
    sheet = np.full((rows * (height + gap) + gap, columns * (width + gap) + gap, 3), 255, np.uint8)
    for number, (strip, name) in enumerate(zip(strips, names, strict=True)):
        upright = strip.image[::-1].clip(0, 255).astype(np.uint8)  # rows of a strip count upwards
        tile = np.ascontiguousarray(cv2.resize(upright, TILE_PX, interpolation=cv2.INTER_LINEAR))
        for side in (-1.0, 1.0):
            offsets = edge_offsets(strip, stem, fit, side)
            x = (offsets - strip.offsets_m[0]) / np.ptp(strip.offsets_m) * (width - 1)
            y = (strip.heights_m[-1] - strip.heights_m) / np.ptp(strip.heights_m) * (height - 1)
            line = np.rint(np.column_stack([x, y])).astype(np.int32)
            cv2.polylines(tile, [line], isClosed=False, color=EDGE_COLOUR, thickness=1, lineType=cv2.LINE_AA)
        label = f"{name}  {strip.distance_m:.1f} m"
        cv2.putText(tile, label, (5, height - 7), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (0, 0, 0), 3, cv2.LINE_AA)
        cv2.putText(tile, label, (5, height - 7), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (255, 255, 255), 1, cv2.LINE_AA)
        row, column = divmod(number, COLUMNS)
        top, left = gap + row * (height + gap), gap + column * (width + gap)
        sheet[top : top + height, left : left + width] = tile
    write_image(path, sheet)


def edge_offsets(strip: Strip, stem: StemAxis, fit: SilhouetteFit, side: float) -> Floats:
    """Offsets (H,) in the strip at which the fitted stem ends on one side (+1 or -1), at the strip's heights.

    The ray at offset s in the plane through the axis has its normal at angle atan(s / distance) from the plane; the
    support function there is distance * s / hypot(distance, s). Three rounds of substitution suffice.
    """
    offsets = np.full(len(strip.heights_m), side * fit.radius_m)
    for _ in range(3):
        slant = np.hypot(strip.distance_m, offsets)
        angle = normal_angles(strip, stem, offsets, side)
        offsets = side * fit.support(angle, strip.heights_m) * slant / strip.distance_m
    return np.asarray(offsets / (1.0 + stem.taper * strip.heights_m / stem.radius_m))
