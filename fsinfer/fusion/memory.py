"""How much memory fusion will take, told before it begins, and how it keeps within a limit.

It follows the number of points kept, which has a limit of its own. Measured as peak resident memory (docs/speed.md).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from fsinfer.depth.memory import BASE_BYTES, GIGABYTE
from fsinfer.errors import InputError

#: A point where all are merged anew in larger voxels: itself (68 bytes), room for more, its sorted and averaged copies.
#: Source: numerics; measured, 240 bytes for 3.2 million and a batch of 1.5.
_BYTES_PER_MERGED_POINT = 300
#: The point itself, and views a thread may be ahead of the merging, of which each pixel may be a point. Source: format;
#: numerics, a batch is merged in the time of two.
_BYTES_PER_POINT, _AHEAD = 68, 2
#: Points in a batch and of a cloud at least. Source: numerics.
_LEAST_BATCH_POINTS = _LEAST_POINTS = 250_000
#: A depth map, its confidence, and the nearest round each pixel, bytes a pixel. Source: format; float32.
_BYTES_PER_PIXEL = 12
#: Comparing two views takes about as much as so many maps. Source: numerics; measured.
_MAPS_OF_A_PAIR = 10
#: Reading a photograph and smoothing its colours, bytes a pixel of it: of one of a dozen megapixels or more that is the
#: most that a view takes. Source: numerics; measured, two of 39 megapixels at a time take 0.65 GB.
_BYTES_PER_PHOTO_PIXEL = 9
#: Share of the memory that maps and photographs may take, and maps kept at least. Source: numerics.
_SHARE_OF_MAPS, _LEAST_MAPS = 0.2, 4


@dataclass(frozen=True, kw_only=True)
class FusionPlan:
    """How fusion keeps within the limit.

    Attributes
    ----------
    cache_maps: depth maps kept.
    at_once: views worked on at a time; ahead: so many more may wait to be merged.
    batch_points, max_points: points merged at a time, and kept at most.
    peak_bytes: memory expected.
    """

    cache_maps: int
    at_once: int
    ahead: int
    batch_points: int
    max_points: int
    peak_bytes: int


def plan_fusion(
    memory_gb: float,
    *,
    map_pixels: int,
    photo_pixels: int,
    cache_maps: int,
    max_points: int,
    batch_points: int,
    at_once: int,
) -> FusionPlan:
    """Keep fewer depth maps, fewer views at a time and smaller batches where the limit asks for it, then fewer points.

    Parameters
    ----------
    map_pixels: pixels of one depth map; it, its confidence and what is nearest round each pixel are kept.
    photo_pixels: pixels of one photograph, of which a view takes the colours of its points.
    cache_maps, at_once, max_points, batch_points: what fusion would like.

    Raises
    ------
    InputError
        Less than the least that a cloud takes.
    """
    limit = memory_gb * GIGABYTE - BASE_BYTES
    of_map = _BYTES_PER_PIXEL * map_pixels
    # One after the other: a view is compared, and then coloured.
    of_view = max(_MAPS_OF_A_PAIR * of_map, _BYTES_PER_PHOTO_PIXEL * photo_pixels)
    room = int(_SHARE_OF_MAPS * limit)
    views = max(1, min(at_once, (room - _LEAST_MAPS * of_map) // of_view))
    maps = min(cache_maps, max(_LEAST_MAPS, (room - views * of_view) // of_map))
    of_maps = maps * of_map + views * of_view
    points = int((limit - of_maps) / _BYTES_PER_MERGED_POINT)
    if points < _LEAST_POINTS + _LEAST_BATCH_POINTS:
        # With the fewest maps and one view at a time, or with what their share has room for.
        beside = (_LEAST_POINTS + _LEAST_BATCH_POINTS) * _BYTES_PER_MERGED_POINT
        least = BASE_BYTES + max(_LEAST_MAPS * of_map + of_view + beside, beside / (1.0 - _SHARE_OF_MAPS))
        enough = max(1.0, math.ceil(10 * least / GIGABYTE) / 10)
        msg = f"{memory_gb:g} GB of --memory-gb are too few for a cloud; give {enough:g} or more"
        raise InputError(msg)
    batch = min(batch_points, max(_LEAST_BATCH_POINTS, points - max_points))
    kept = min(max_points, points - batch)
    peak = BASE_BYTES + of_maps + (kept + batch) * _BYTES_PER_MERGED_POINT
    # Only what nothing else asks for.
    of_waiting = _BYTES_PER_POINT * map_pixels
    ahead = min(_AHEAD * views, int((memory_gb * GIGABYTE - peak) / of_waiting))
    return FusionPlan(
        cache_maps=maps,
        at_once=views,
        ahead=ahead,
        batch_points=batch,
        max_points=kept,
        peak_bytes=int(peak + ahead * of_waiting),
    )
