"""Textures as mip pyramids and their vectorised lookup."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

#: Textures are stored gamma-encoded in 8 bits and lit in linear light. Source: about sRGB.
GAMMA = 2.2
#: Textures in 8 bits and reliefs in single precision are looked up and made smaller alike.
PixelT = TypeVar("PixelT", np.uint8, np.float32)
TO_LINEAR = ((np.arange(256) / 255.0) ** GAMMA).astype(np.float32)


@dataclass(frozen=True, kw_only=True)
class Material:
    """A periodic texture.

    Attributes
    ----------
    levels: (S, S, 3 or 4) uint8 arrays, each half the size of the one before; RGB(A), gamma-encoded.
    tile_m: length in metres that one tile covers. height: levels of the (S, S) float32 relief, about 0..1, or none.
    modulation: (T, T, 3) uint8 periodic map, read ``modulation_scale`` times slower and multiplied (128 = 1), so
    that the repetition of the tile does not show; or None.
    patched: laid in patches, each another part of the tile, mirrored and turned by chance: no place is like another.
        Matching takes a ground whose tile repeats for the same ground a tile farther on, and bark likewise.
    upright: patches are mirrored and not turned, as bark that has a direction.
    """

    levels: tuple[NDArray[np.uint8], ...]
    tile_m: float
    height: tuple[NDArray[np.float32], ...] = ()
    modulation: NDArray[np.uint8] | None = None
    modulation_scale: float = 0.2137
    translucency: float = 0.0
    patched: bool = False
    upright: bool = False


def pyramid(image: NDArray[PixelT]) -> tuple[NDArray[PixelT], ...]:
    """Halve ``image`` down to 4 pixels."""
    levels = [np.ascontiguousarray(image)]
    while min(levels[-1].shape[:2]) > 4:
        height, width = levels[-1].shape[:2]
        smaller = cv2.resize(levels[-1], (width // 2, height // 2), interpolation=cv2.INTER_AREA)
        levels.append(np.asarray(smaller, image.dtype))
    return tuple(levels)


def lookup(image: NDArray[PixelT], uv: NDArray[np.float32]) -> NDArray[PixelT]:
    """Bilinear periodic lookup: ``uv`` (n, 2) in tiles -> (n, channels)."""
    height, width = image.shape[:2]
    count = len(uv)
    columns = 512  # remap refuses more than 32767 rows or columns, so the points are laid out as a picture
    rows = -(-count // columns)
    maps = np.zeros((2, rows * columns), np.float32)
    wrapped = uv - np.floor(uv)
    maps[0, :count] = wrapped[:, 0] * np.float32(width) - np.float32(0.5)
    maps[1, :count] = wrapped[:, 1] * np.float32(height) - np.float32(0.5)
    map_x, map_y = maps.reshape(2, rows, columns)
    values = cv2.remap(image, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    return np.asarray(values, image.dtype).reshape(rows * columns, *image.shape[2:])[:count]


def in_patches(uv: NDArray[np.float32], *, upright: bool = False) -> NDArray[np.float32]:
    """Where in a periodic tile places ``uv`` (n, 2), in tiles, look, so that nothing repeats.

    Patches are two thirds of a tile wide with winding borders; each has its own shift, and one of the eight ways to lay
    a square (``upright``: of the four that leave it so), both from a hash of its number.
    """
    u, v = uv.astype(np.float64).T
    bent_u = 1.5 * u + 0.22 * np.sin(4.1 * v + 1.3 * u) + 0.09 * np.sin(13.7 * v)
    bent_v = 1.5 * v + 0.22 * np.sin(3.7 * u - 1.1 * v) + 0.09 * np.sin(12.1 * u)
    column, row = (np.floor(bent).astype(np.int64).astype(np.uint64) for bent in (bent_u, bent_v))
    mixed = column * np.uint64(0x9E3779B97F4A7C15) ^ row * np.uint64(0xC2B2AE3D27D4EB4F)
    mixed ^= mixed >> np.uint64(29)
    mixed *= np.uint64(0xBF58476D1CE4E5B9)
    mixed ^= mixed >> np.uint64(32)
    shift_u, shift_v = ((mixed >> np.uint64(bits) & np.uint64(0xFFFF)) / 65536.0 for bits in (0, 16))
    swapped, *mirrored = (mixed >> np.uint64(bit) & np.uint64(1) > 0 for bit in (32, 33, 34))
    if upright:
        swapped = np.zeros_like(swapped)
    across, along = np.where(swapped, v, u), np.where(swapped, u, v)
    across, along = (np.where(turned, -way, way) for turned, way in zip(mirrored, (across, along), strict=True))
    return np.stack([across + shift_u, along + shift_v], -1).astype(np.float32)


def laid(material: Material, uv: NDArray[np.float32]) -> NDArray[np.float32]:
    """Where in its tile a material shows places ``uv`` (n, 2), in tiles."""
    return in_patches(uv, upright=material.upright) if material.patched else uv


def sample(
    materials: list[Material], ids: NDArray[np.int32], uv: NDArray[np.float32], footprint_m: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Look up (n, 4) linear RGB and alpha (0..1) for material ``ids`` (n,) at ``uv`` (n, 2) tiles.

    ``footprint_m`` (n,) is the size of a ray's footprint on the surface; it chooses the mip level.
    """
    if len(ids) == 0:
        return np.ones((0, 4), np.float32)
    texel_m = np.array([m.tile_m / m.levels[0].shape[1] for m in materials], np.float32)
    top = np.array([len(m.levels) - 1 for m in materials])
    level = np.round(np.log2(np.maximum(footprint_m / texel_m[ids], 1.0))).astype(np.int64)
    key = ids.astype(np.int64) * 32 + np.minimum(level, top[ids])
    order = np.argsort(key, kind="stable")
    keys, starts = np.unique(key[order], return_index=True)
    ends = np.append(starts[1:], len(order))
    result = np.ones((len(ids), 4), np.float32)
    for k, start, end in zip(keys, starts, ends, strict=True):
        material = materials[k // 32]
        at = order[start:end]
        where = uv[at]
        values = lookup(material.levels[k % 32], laid(material, where))
        colour = TO_LINEAR[values[:, :3]]
        if material.modulation is not None:
            turned = np.stack([where[:, 0] + 0.31 * where[:, 1], where[:, 1] - 0.31 * where[:, 0]], -1)
            gain = lookup(material.modulation, (turned * material.modulation_scale).astype(np.float32))
            colour = colour * (TO_LINEAR[gain] / TO_LINEAR[128])
        result[at, :3] = colour
        if values.shape[1] == 4:
            result[at, 3] = values[:, 3] / np.float32(255)
    return result
