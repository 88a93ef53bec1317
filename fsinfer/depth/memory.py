"""How much memory depth will take, told before it begins, and how it keeps within a limit.

The constants were measured as peak resident memory (docs/speed.md). It follows the size of the images, not the number
of photographs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fsinfer.errors import InputError

#: Source: format; decimal, as memory_gb is.
MEGABYTE, GIGABYTE = 1_000_000, 1_000_000_000

#: Python, NumPy, OpenCV, onnxruntime and the model before any work. Source: numerics; measured, docs/speed.md.
BASE_BYTES = 150 * MEGABYTE
#: Peak of a depth map over the cost volume itself: the volume, what the regularizer holds at once, the narrow volume.
#: Source: numerics; measured, 4.9 to 5.7 times in float32 and 2.4 to 2.9 in int8 at 640x352 to 1920x1088.
_PEAK_OVER_VOLUME, _INT8_PEAK_OVER_VOLUME = 6.2, 3.2
#: What a depth map holds while another one is in the regularizer, likewise: its volume and what that is made with, or
#: the narrow volume, and what onnxruntime keeps for it. Source: numerics; measured, two and four maps at a time take
#: less.
_BESIDE_OVER_VOLUME = 1.6
#: Depth maps worked on at a time to one regularizer. Source: numerics; of a map in one thread it takes a fifth of the
#: time in int8 and a third in float32, and two thirds of the memory.
_MAPS_TO_A_REGULARIZER, _INT8_MAPS_TO_A_REGULARIZER = 2, 3
#: The same in tiles, of which the volume is a copy, and bytes a pixel that the feature network leaves behind. Source:
#: numerics; measured, 1600x1200 and 2400x1800 in tiles of 128 take 2.13 and 3.06 GB.
_PEAK_OVER_TILE, _FEATURES_BYTES = 9.2, 105
#: The same of a 3D regularizer, in volumes of as many channels as the cost volume has, and as its first level has: the
#: volume, in tiles the copy of it, and what is held at once of the first level. Source: numerics; measured, ``paper``
#: as a whole takes 0.77 GB at 640x352, 1.57 at 960x512 and 3.16 at 1280x720, there in two tiles 2.59.
_VOLUMES_AT_PEAK, _LEVELS_AT_PEAK = 1.0, 4.6
#: The same of a volume at an eighth of the resolution, beside which what follows at a quarter and at half of it weighs
#: more: as a whole in float32 and in int8, and in tiles. Each map worked on at a time takes all of it. Source:
#: numerics; measured with ``cascade``, 10.9 to 13.7 and 5.6 to 6.5 times at 960x544 to 2400x1808 before the surface was
#: asked for; with it one map of five views at 1280x720 and 1920x1088 takes 0.75 and 1.46 GiB in float32, 0.51 and 0.99
#: in int8 where 0.79 and 1.60, 0.51 and 0.99 are planned. Before it 2560x1536 in tiles of 72 took 2.37 GB where 2.54
#: are planned.
_PEAK_OVER_EIGHTHS, _INT8_PEAK_OVER_EIGHTHS, _PEAK_OVER_TILE_OF_EIGHTHS = 14.2, 7.6, 14.2
#: Feature maps that a process keeps, per cent of those that one process for all would: it computes a run of neighbours.
#: Source: numerics.
_CACHE_OF_A_PROCESS = 65
#: glibc's malloc gives freed memory back to the system where a block is larger than the largest that it gave back
#: before, at most 32 MiB; what comes back later has to be cleared and mapped anew. Source: numerics; a view takes 4 %
#: less time with it, ninety by two processes too (docs/trials-speed.md).
_FREED_AND_KEPT_BYTES = 31 << 20
#: Sides of tiles that are tried, pixels of the volume. Source: numerics; multiples of the network's coarsest level.
_TILE_SIZES = range(512, 56, -8)
#: Sizes that a message proposes: multiples of the one, none below the other, pixels. Source: layout; the least that
#: --max-size takes.
_SIZE_STEP_PX, _LEAST_SIZE_PX = 32, 160


def keep_freed_memory() -> None:
    """Let the C library use freed volumes and feature maps again instead of giving them back to the system.

    A block of memory is asked for, never touched, and freed, from which glibc learns; other libraries decide otherwise
    and lose nothing.
    """
    block = np.empty(_FREED_AND_KEPT_BYTES, np.uint8)
    del block


@dataclass(frozen=True, kw_only=True)
class DepthPlan:
    """How depth keeps within the limit.

    Attributes
    ----------
    cached_views: feature maps kept for the neighbouring photos.
    peak_bytes: memory expected with them.
    at_once: depth maps computed at a time; regularizers: how many of them are in the regularizer at a time.
    processes: that compute them, each one at a time; with one, threads of this process do.
    tile_size: pixels of the volume of a tile (:mod:`fsinfer.depth.tiles`); 0 where a depth map is computed as a whole.
    keeps_volume: in tiles, whether the cost volume is kept as a whole.
    """

    cached_views: int
    peak_bytes: int
    at_once: int = 1
    regularizers: int = 1
    processes: int = 1
    tile_size: int = 0
    keeps_volume: bool = True


def plan_depth(
    memory_gb: float,
    *,
    width: int,
    height: int,
    planes: int,
    groups: int,
    views: int,
    most_cached: int,
    feature_channels: int,
    refine_channels: int,
    level_channels: int = 0,
    wide_stride: int = 4,
    int8: bool = False,
    tile_halo: int | None = None,
    most_at_once: int = 1,
    apart: bool = False,
) -> DepthPlan:
    """Cache as many feature maps as the limit allows, at least those of one depth map; in tiles where that is too much.

    As many maps are computed at a time as the limit allows, each with all the feature maps that it needs. Of a
    regularizer that takes the volume as it is one map takes nearly all of the time and the memory, so it is one.

    Parameters
    ----------
    memory_gb: limit, 1e9 bytes.
    width, height: of the image given to the network, pixels.
    planes, groups: of the cost volume; groups are values at each plane and pixel.
    wide_stride: pixels of the image to one of the volume, 4 or 8.
    level_channels: of the first level of a regularizer that takes the volume as it is (3D convolutions); 0 for one that
        takes slabs.
    feature_channels, refine_channels: of the feature maps at a quarter and at half resolution.
    views: photographs compared at a time, the reference among them.
    int8: the graphs are in 8-bit integers; in tiles they never are.
    tile_halo: of the model's tiles, pixels of the volume; None where it cannot be cut into tiles.
    most_at_once: depth maps that may be computed at a time.
    apart: by processes, where the limit allows two; each has the model, and feature maps of its own.

    Raises
    ------
    InputError
        Not even one depth map fits; says which ``--max-size`` would.
    """
    quarter = -(-width // 4) * -(-height // 4)
    # float32, at a quarter and at half resolution; grey values at full size in half as many bytes.
    of_view = 4 * quarter * (feature_channels + 4 * refine_channels) + 2 * width * height
    share = (4 / wide_stride) ** 2  # pixels of the volume to a quarter pixel
    of_volume = 4 * planes * groups * share
    maps_to_one = _INT8_MAPS_TO_A_REGULARIZER if int8 else _MAPS_TO_A_REGULARIZER
    if wide_stride > 4:
        whole_peak = (_INT8_PEAK_OVER_EIGHTHS if int8 else _PEAK_OVER_EIGHTHS) * of_volume
        tile_peak = _PEAK_OVER_TILE_OF_EIGHTHS * of_volume
        maps_to_one = 1
    elif level_channels:
        whole_peak = tile_peak = 4 * planes * (_VOLUMES_AT_PEAK * groups + _LEVELS_AT_PEAK * level_channels)
    else:
        whole_peak = (_INT8_PEAK_OVER_VOLUME if int8 else _PEAK_OVER_VOLUME) * of_volume
        tile_peak = _PEAK_OVER_TILE * of_volume
    fixed = BASE_BYTES + whole_peak * quarter
    limit = memory_gb * GIGABYTE
    least = fixed + views * of_view
    if least > limit and tile_halo is not None:
        tiles = _largest_tiles(
            limit - BASE_BYTES - views * of_view - _FEATURES_BYTES * width * height,
            shape=(-(-height // wide_stride), -(-width // wide_stride)),
            volume_bytes=of_volume / share,
            peak_bytes=tile_peak / share,
            halo=tile_halo,
        )
        if tiles is not None:
            size, keeps_volume, spare = tiles
            return DepthPlan(
                cached_views=views, peak_bytes=int(limit - spare), tile_size=size, keeps_volume=keeps_volume
            )
    if least > limit:
        fits = max(0.0, (limit - BASE_BYTES) / (least - BASE_BYTES))
        size = _SIZE_STEP_PX * int(max(width, height) * fits**0.5 / _SIZE_STEP_PX)
        way_out = "give a larger --memory-gb" + (f", or --max-size {size}" if size >= _LEAST_SIZE_PX else "")
        msg = (
            f"depth of {width}x{height} photos takes about {least / GIGABYTE:.1f} GB, more than the "
            f"{memory_gb:g} GB of --memory-gb; {way_out}"
        )
        raise InputError(msg)
    beside = _BESIDE_OVER_VOLUME * of_volume
    at_once = 1 if level_channels else most_at_once
    while True:
        regularizers = -(-at_once // maps_to_one)
        fixed = BASE_BYTES + (regularizers * whole_peak + (at_once - regularizers) * beside) * quarter
        needed = at_once * views
        if at_once == 1 or fixed + needed * of_view <= limit:
            break
        at_once -= 1
    own_cache = max(views, _CACHE_OF_A_PROCESS * most_cached // 100)
    of_process = BASE_BYTES + whole_peak * quarter + own_cache * of_view
    processes = min(at_once, int((limit - BASE_BYTES) / of_process))
    if apart and processes > 1:
        return DepthPlan(
            cached_views=own_cache,
            peak_bytes=int(BASE_BYTES + processes * of_process),
            at_once=processes,
            regularizers=processes,
            processes=processes,
        )
    cached = max(needed, min(most_cached, int((limit - fixed) / of_view)))
    return DepthPlan(
        cached_views=cached,
        peak_bytes=int(fixed + cached * of_view),
        at_once=at_once,
        regularizers=regularizers,
    )


def _largest_tiles(
    left: float, *, shape: tuple[int, int], volume_bytes: float, peak_bytes: float, halo: int
) -> tuple[int, bool, float] | None:
    """Size of the largest tiles that fit into what is left, whether the volume does too, and the bytes to spare.

    ``volume_bytes`` and ``peak_bytes`` are those of a pixel of the volume: its own, and of all that a tile takes.
    """
    for keeps_volume in (True, False):
        whole = volume_bytes * shape[0] * shape[1] if keeps_volume else 0
        for size in _TILE_SIZES:
            rows, columns = (min(length, size + 2 * halo) for length in shape)
            spare = left - whole - peak_bytes * rows * columns
            if spare >= 0:
                return size, keeps_volume, spare
    return None
