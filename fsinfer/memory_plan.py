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
#: 7.3 to 7.9 times at 960x540 to 1920x1080 in float32, 3.8 to 4.1 in int8 at 960x540 to 2400x1800.
_PEAK_OVER_VOLUME, _INT8_PEAK_OVER_VOLUME = 8.2, 4.4
#: The same in tiles, of which the volume is a copy, and bytes a pixel that the feature network leaves behind.
#: 1600x1200 and 2400x1800 in tiles of 128: 2.13 and 3.06 GB.
_PEAK_OVER_TILE, _FEATURES_BYTES = 9.2, 105
_TILE_SIZES = range(512, 56, -8)
#: A point while it is merged: itself (68 bytes), its joined, sorted and averaged copies. 312 bytes for 5.5 million.
_BYTES_PER_MERGED_POINT = 320
_LEAST_BATCH_POINTS = 250_000
_LEAST_POINTS = 250_000


@dataclass(frozen=True, kw_only=True)
class DepthPlan:
    """How depth keeps within the limit.

    Attributes
    ----------
    cached_views: feature maps kept for the neighbouring photos.
    peak_bytes: memory expected with them.
    tile_size: quarter pixels of a tile (:mod:`fsinfer.tiles`); 0 where a depth map is computed as a whole.
    keeps_volume: in tiles, whether the cost volume is kept as a whole.
    """

    cached_views: int
    peak_bytes: int
    tile_size: int = 0
    keeps_volume: bool = True


@dataclass(frozen=True, kw_only=True)
class FusionPlan:
    """Depth maps kept, points merged at a time and kept at most, and the peak memory expected, bytes."""

    cache_maps: int
    batch_points: int
    max_points: int
    peak_bytes: int


def plan_depth(
    memory_gb: float,
    *,
    width: int,
    height: int,
    planes: int,
    groups: int,
    views: int,
    most_cached: int,
    int8: bool = False,
    tile_halo: int | None = None,
) -> DepthPlan:
    """Cache as many feature maps as the limit allows, at least those of one depth map; in tiles where that is too much.

    Parameters
    ----------
    memory_gb: limit, 1e9 bytes.
    width, height: of the image given to the network, pixels.
    planes, groups: of the cost volume at a quarter of that.
    views: photographs compared at a time, the reference among them.
    int8: the regularizer is in 8-bit integers; in tiles it never is.
    tile_halo: of the model's tiles, quarter pixels; None where it cannot be cut into tiles.

    Raises
    ------
    InputError
        Not even one depth map fits; says which ``--max-size`` would.
    """
    quarter = -(-width // 4) * -(-height // 4)
    volume = 4 * planes * groups * quarter
    # 16 channels at a quarter, 8 at half resolution, float32.
    of_view = 4 * quarter * (16 + 4 * 8)
    fixed = _BASE_BYTES + (_INT8_PEAK_OVER_VOLUME if int8 else _PEAK_OVER_VOLUME) * volume
    limit = memory_gb * GIGABYTE
    least = fixed + views * of_view
    if least > limit and tile_halo is not None:
        tiles = _largest_tiles(
            limit - _BASE_BYTES - views * of_view - _FEATURES_BYTES * width * height,
            shape=(-(-height // 4), -(-width // 4)),
            bytes_per_pixel=4 * planes * groups,
            halo=tile_halo,
        )
        if tiles is not None:
            size, keeps_volume, spare = tiles
            return DepthPlan(
                cached_views=views, peak_bytes=int(limit - spare), tile_size=size, keeps_volume=keeps_volume
            )
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


def _largest_tiles(
    left: float, *, shape: tuple[int, int], bytes_per_pixel: int, halo: int
) -> tuple[int, bool, float] | None:
    """Size of the largest tiles that fit into what is left, whether the volume does too, and the bytes to spare."""
    for keeps_volume in (True, False):
        whole = bytes_per_pixel * shape[0] * shape[1] if keeps_volume else 0
        for size in _TILE_SIZES:
            rows, columns = (min(length, size + 2 * halo) for length in shape)
            spare = left - whole - _PEAK_OVER_TILE * bytes_per_pixel * rows * columns
            if spare >= 0:
                return size, keeps_volume, spare
    return None


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
