"""How much memory depth and fusion will take, told before they begin, and how they keep within a limit.

The constants were measured as peak resident memory (docs/speed.md). Depth follows the size of the images, not the
number of photographs; fusion follows the number of points kept, which has a limit of its own.
"""

from __future__ import annotations

from dataclasses import dataclass

from fsinfer.errors import InputError

MEGABYTE = 1_000_000
GIGABYTE = 1_000_000_000

#: Python, NumPy, OpenCV, onnxruntime and the model before any work.
_BASE_BYTES = 150 * MEGABYTE
#: Peak of a depth map over the cost volume itself: the volume, what the regularizer holds at once, the narrow volume.
#: 7.3 to 7.9 times at 960x540 to 1920x1080.
_PEAK_OVER_VOLUME = 8.2
#: A point while it is merged: itself (68 bytes), its joined, sorted and averaged copies. 312 bytes for 5.5 million.
_BYTES_PER_MERGED_POINT = 320
_LEAST_BATCH_POINTS = 250_000
_LEAST_POINTS = 250_000


@dataclass(frozen=True, kw_only=True)
class DepthPlan:
    """Feature maps kept for the neighbouring photos, and the peak memory expected with them, bytes."""

    cached_views: int
    peak_bytes: int


@dataclass(frozen=True, kw_only=True)
class FusionPlan:
    """Depth maps kept, points merged at a time and kept at most, and the peak memory expected, bytes."""

    cache_maps: int
    batch_points: int
    max_points: int
    peak_bytes: int


def plan_depth(
    memory_gb: float, *, width: int, height: int, planes: int, groups: int, views: int, most_cached: int
) -> DepthPlan:
    """Cache as many feature maps as the limit allows, at least those of one depth map.

    Parameters
    ----------
    memory_gb: limit, 1e9 bytes.
    width, height: of the image given to the network, pixels.
    planes, groups: of the cost volume at a quarter of that.
    views: photographs compared at a time, the reference among them.

    Raises
    ------
    InputError
        Not even one depth map fits; says which ``--max-size`` would.
    """
    quarter = -(-width // 4) * -(-height // 4)
    volume = 4 * planes * groups * quarter
    # 16 channels at a quarter, 8 at half resolution, float32.
    of_view = 4 * quarter * (16 + 4 * 8)
    fixed = _BASE_BYTES + _PEAK_OVER_VOLUME * volume
    limit = memory_gb * GIGABYTE
    least = fixed + views * of_view
    if least > limit:
        share = max(0.0, (limit - _BASE_BYTES) / (least - _BASE_BYTES))
        size = 32 * int(max(width, height) * share**0.5 / 32)
        way_out = f"give a larger --memory-gb, or --max-size {size}" if size >= 160 else "give a larger --memory-gb"
        msg = (
            f"depth of {width}x{height} photos takes about {least / GIGABYTE:.1f} GB, more than the "
            f"{memory_gb:g} GB of --memory-gb; {way_out}"
        )
        raise InputError(msg)
    cached = max(views, min(most_cached, int((limit - fixed) / of_view)))
    return DepthPlan(cached_views=cached, peak_bytes=int(fixed + cached * of_view))


def plan_fusion(
    memory_gb: float, *, map_pixels: int, cache_maps: int, max_points: int, batch_points: int
) -> FusionPlan:
    """Keep fewer depth maps and merge smaller batches where the limit asks for it, then fewer points.

    Parameters
    ----------
    map_pixels: pixels of one depth map; it and its confidence are kept.
    cache_maps, max_points, batch_points: what fusion would like.

    Raises
    ------
    InputError
        Less than the least that a cloud takes.
    """
    limit = memory_gb * GIGABYTE - _BASE_BYTES
    # Comparing two views takes about as much as ten maps.
    maps = min(cache_maps, max(4, int(0.2 * limit / (8 * map_pixels)) - 10))
    points = int((limit - (maps + 10) * 8 * map_pixels) / _BYTES_PER_MERGED_POINT)
    if points < _LEAST_POINTS + _LEAST_BATCH_POINTS:
        msg = f"{memory_gb:g} GB of --memory-gb are too few for a cloud; give 1 or more"
        raise InputError(msg)
    batch = min(batch_points, max(_LEAST_BATCH_POINTS, points - max_points))
    kept = min(max_points, points - batch)
    peak = _BASE_BYTES + (maps + 10) * 8 * map_pixels + (kept + batch) * _BYTES_PER_MERGED_POINT
    return FusionPlan(cache_maps=maps, batch_points=batch, max_points=kept, peak_bytes=int(peak))
