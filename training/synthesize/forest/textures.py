"""Procedural surface textures, and photographs cut, turned and recoloured into periodic ones."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from training.synthesize.forest.material import Material, pyramid
from training.synthesize.forest.noise import cells, fractal, warp

Rng = np.random.Generator
Field = NDArray[np.float32]

BARK = ((92, 80, 68), (120, 104, 88), (74, 62, 52), (140, 130, 116), (104, 84, 64), (128, 92, 66), (150, 146, 138))
GROUND = ((92, 72, 50), (120, 92, 60), (74, 60, 44), (130, 110, 78), (84, 84, 56), (104, 78, 58))
LEAVES = ((150, 104, 56), (176, 132, 76), (120, 78, 44), (190, 160, 104), (132, 116, 60), (98, 70, 50), (164, 88, 48))
ROCK = ((128, 126, 122), (150, 142, 130), (104, 100, 96), (164, 158, 150), (134, 118, 102), (96, 102, 104))
GREEN = ((74, 104, 44), (96, 122, 58), (58, 84, 40), (112, 130, 60), (86, 112, 70))


def pick(rng: Rng, palette: Sequence[tuple[int, int, int]], jitter: float = 0.16) -> NDArray[np.float64]:
    """A palette colour with random hue and brightness, (3,) in 0..255."""
    colour = np.array(palette[int(rng.integers(len(palette)))], dtype=np.float64)
    varied: NDArray[np.float64] = colour * np.exp(rng.normal(0, jitter)) * np.exp(rng.normal(0, jitter / 4, 3))
    return varied.clip(4, 250)


def _mix(a: NDArray[np.floating], b: NDArray[np.floating], weight: NDArray[np.floating]) -> NDArray[np.float32]:
    w = np.clip(weight, 0, 1)[..., None].astype(np.float32)
    mixed: NDArray[np.float32] = (a * (1 - w) + b * w).astype(np.float32)
    return mixed


def _to_uint8(image: NDArray[np.floating]) -> NDArray[np.uint8]:
    return image.clip(0, 255).astype(np.uint8)


def _step(field: Field, threshold: float, softness: float) -> Field:
    ramp: Field = (field - threshold) / softness + 0.5
    return ramp.clip(0, 1)


def _grain(rng: Rng, size: int) -> Field:
    """Fine noise that keeps some contrast at every scale, for matching."""
    return 0.6 * fractal(rng, size, beta=rng.uniform(0.3, 0.8)) + 0.5 * fractal(rng, size, beta=1.1)


def _patches(
    rng: Rng, image: NDArray[np.floating], size: int, colours: Sequence[NDArray[np.float64]], amount: float
) -> NDArray[np.floating]:
    """Lichen, moss or stain patches with ragged edges."""
    for colour in colours:
        field = fractal(rng, size, beta=rng.uniform(1.1, 1.7), low=rng.uniform(2, 8))
        weight = _step(field, rng.uniform(0.9, 1.8) - amount, rng.uniform(0.1, 0.6)) * rng.uniform(0.4, 0.95)
        image = _mix(image, colour * (1 + 0.15 * fractal(rng, size, beta=0.6)[..., None]), weight)
    return image


def bark(rng: Rng, size: int = 1024) -> tuple[NDArray[np.uint8], Field]:
    """A bark tile (size, size, 3) and its relief (size, size) in 0..1; rows run up the stem."""
    style = rng.choice(["plates", "ridges", "smooth", "flaky"], p=[0.35, 0.35, 0.15, 0.15])
    shift = [rng.uniform(4, 22) * fractal(rng, size, beta=1.6, low=2) for _ in range(2)]
    if style == "plates":
        distance, value = cells(rng, size, int(rng.integers(60, 420)), stretch=rng.uniform(1.5, 5))
        height = warp(np.clip(distance * rng.uniform(0.8, 2.0), 0, 1) * (0.75 + 0.25 * value), *shift)
    elif style == "ridges":
        ridge = fractal(rng, size, beta=rng.uniform(1.2, 1.9), low=rng.uniform(4, 14), stretch=rng.uniform(4, 12))
        height = warp(1 - np.exp(-np.abs(ridge) * rng.uniform(0.8, 2.2)), *shift)
    elif style == "flaky":
        distance, value = cells(rng, size, int(rng.integers(150, 900)), stretch=rng.uniform(0.6, 1.4))
        height = warp(0.5 * value + 0.5 * np.clip(distance * 3, 0, 1), *shift)
    else:
        height = 0.8 + 0.05 * fractal(rng, size, beta=1.5, low=3, stretch=rng.uniform(0.3, 1))
        lenticel = fractal(rng, size, beta=0.9, low=16, stretch=rng.uniform(0.08, 0.25))
        height = height - 0.5 * _step(lenticel, rng.uniform(1.3, 2.2), 0.3)
    height = np.clip(height + 0.06 * fractal(rng, size, beta=1.0), 0, 1).astype(np.float32)
    base = pick(rng, BARK)
    if style == "smooth":
        base = base * rng.uniform(1.1, 1.6)
    dark = base * rng.uniform(0.25, 0.55)
    image = _mix(dark[None, None], base[None, None], _step(height, rng.uniform(0.25, 0.45), rng.uniform(0.5, 0.9)))
    image = _mix(image, pick(rng, BARK) * np.ones_like(image), 0.5 * _step(fractal(rng, size, beta=1.4), 0.3, 1.5))
    image = image * np.exp(rng.uniform(0.08, 0.24) * _grain(rng, size))[..., None]
    lichen = [pick(rng, ((150, 160, 140), (176, 180, 164), (140, 150, 96), (90, 110, 60), (60, 54, 48)))]
    lichen += [pick(rng, GREEN)] if rng.random() < 0.5 else []
    return _to_uint8(_patches(rng, image, size, lichen, rng.uniform(-0.6, 0.5))), height


def litter(rng: Rng, size: int = 1024) -> NDArray[np.uint8]:
    """Forest floor: soil noise under a mosaic of leaves or needles and twigs."""
    image = pick(rng, GROUND)[None, None] * np.exp(0.3 * _grain(rng, size))[..., None]
    pad = 96
    canvas = np.pad(_to_uint8(image), ((0, pad), (0, pad), (0, 0)), mode="wrap")
    needles = rng.random() < 0.4
    count = int(rng.integers(1500, 4500)) if needles else int(rng.integers(300, 1800))
    palette = np.array([pick(rng, LEAVES if rng.random() < 0.8 else GREEN) for _ in range(24)])
    spot = rng.integers(0, size, (count, 2))
    angle = rng.uniform(0, 2 * np.pi, count)
    length = rng.uniform(8, 30, count) if needles else rng.uniform(6, rng.uniform(18, 44), count)
    colour = palette[rng.integers(0, 24, count)] * np.exp(rng.normal(0, 0.2, (count, 1)))
    outline = np.array([[-1, 0], [-0.4, 0.42], [0.3, 0.36], [1, 0], [0.3, -0.36], [-0.4, -0.42]])
    for at, a, half, rgb in zip(spot, angle, length, np.clip(colour, 0, 255), strict=True):
        along = np.array([np.cos(a), np.sin(a)])
        across = np.array([-along[1], along[0]])
        pen = tuple(float(c) for c in rgb)
        tip = along * half
        center = at + pad / 2
        if needles:
            cv2.line(canvas, (center - tip).astype(int).tolist(), (center + tip).astype(int).tolist(), pen, 1)
            continue
        shape = center + outline[:, :1] * tip + outline[:, 1:] * across * half
        cv2.fillPoly(canvas, [shape.astype(np.int32)], tuple(0.55 * c for c in pen))
        cv2.fillPoly(canvas, [(shape * 0.94 + center * 0.06 - 1).astype(np.int32)], pen)
        vein = tuple(0.75 * c for c in pen)
        cv2.line(canvas, (center - tip).astype(int).tolist(), (center + tip).astype(int).tolist(), vein, 1)
    half = pad // 2
    tile = canvas[half : half + size, half : half + size].astype(np.float32)
    tile = tile * np.exp(rng.uniform(0.08, 0.2) * _grain(rng, size))[..., None]
    moss = [pick(rng, GREEN)] if rng.random() < 0.5 else []
    return _to_uint8(_patches(rng, tile, size, moss, rng.uniform(-0.5, 0.8)))


def rock(rng: Rng, size: int = 1024) -> tuple[NDArray[np.uint8], Field]:
    """Stone: speckle, veins, cracks, lichen spots."""
    base, other = pick(rng, ROCK), pick(rng, ROCK)
    height = np.clip(0.5 + 0.2 * fractal(rng, size, beta=1.5), 0, 1).astype(np.float32)
    image: NDArray[np.floating] = _mix(
        base[None, None], other * np.ones((size, size, 3)), _step(fractal(rng, size, beta=1.5), 0.2, 1.5)
    )
    crack = np.abs(fractal(rng, size, beta=1.7, low=2, stretch=rng.uniform(0.4, 2.5)))
    image = image * (1 - rng.uniform(0.2, 0.6) * np.exp(-crack * rng.uniform(6, 20)))[..., None]
    image = image * np.exp(rng.uniform(0.1, 0.3) * _grain(rng, size))[..., None]
    spots = [pick(rng, ((190, 186, 150), (200, 160, 70), (60, 60, 58), (120, 130, 100))) for _ in range(2)]
    return _to_uint8(_patches(rng, image, size, spots, rng.uniform(-0.6, 0.4))), height


def generic(rng: Rng, size: int = 1024) -> tuple[NDArray[np.uint8], Field]:
    """Something made by people or of no known kind: plaster, bricks, planks, fabric, coloured cells."""
    style = rng.choice(["noise", "cells", "bricks", "planks", "stripes"])
    a, b = rng.uniform(30, 230, 3), rng.uniform(30, 230, 3)
    grey = a.mean()
    a, b = (grey + (c - grey) * rng.uniform(0.2, 1.0) for c in (a, b))
    grid = np.arange(size)
    if style == "noise":
        weight = _step(fractal(rng, size, beta=rng.uniform(0.8, 1.6)), 0, rng.uniform(0.3, 2.5))
    elif style == "cells":
        distance, value = cells(rng, size, int(rng.integers(40, 900)), stretch=rng.uniform(0.7, 2))
        weight = value * np.clip(distance * 4, 0.2, 1)
    elif style in ("bricks", "planks"):
        rows, columns = (int(rng.integers(6, 16)), int(rng.integers(2, 6)))
        y, x = np.meshgrid(grid * rows / size, grid * columns / size, indexing="ij")
        x = (x + 0.5 * (np.floor(y) % 2)) % columns if style == "bricks" else x
        row, column = np.floor(y).astype(int), np.floor(x).astype(int)
        value = rng.random((rows, columns))[row % rows, column % columns]
        gap = np.minimum(np.minimum(y % 1, 1 - y % 1) * size / rows, np.minimum(x % 1, 1 - x % 1) * size / columns)
        weight = (0.2 + 0.8 * value) * np.clip(gap / rng.uniform(2, 6), 0, 1)
    else:
        waves = int(rng.integers(4, 40))
        tilt = int(rng.integers(-3, 4))
        phase = 2 * np.pi * (grid[:, None] * waves + grid[None] * tilt) / size + fractal(rng, size, beta=1.8)
        weight = _step(np.sin(phase), 0, rng.uniform(0.2, 2.0))
    weight = weight.astype(np.float32)
    image = _mix(a[None, None], b * np.ones((size, size, 3)), weight)
    image = image * np.exp(rng.uniform(0.03, 0.25) * _grain(rng, size))[..., None]
    image = _patches(rng, image, size, [rng.uniform(30, 200, 3) for _ in range(2)], rng.uniform(-1.0, 0.3))
    return _to_uint8(image), weight


@lru_cache(maxsize=32)
def _photo(path: Path) -> NDArray[np.uint8]:
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image is None:
        msg = f"cannot read the texture {path}"
        raise FileNotFoundError(msg)
    code = cv2.COLOR_BGRA2RGBA if image.shape[2] == 4 else cv2.COLOR_BGR2RGB
    return np.asarray(cv2.cvtColor(image, code), np.uint8)


def from_photo(rng: Rng, path: Path, size: int = 1024, *, turn: bool) -> NDArray[np.uint8]:
    """A periodic (size, size, 3) tile out of a photograph: random cut, scale, turn, mirror, colour."""
    image = _photo(path)[..., :3]
    overlap = size // 6
    need = size + overlap
    scale = need / min(image.shape[:2]) * rng.uniform(1.0, 1.35)
    angle = rng.uniform(0, 360) if turn else rng.normal(0, 3)
    matrix = np.asarray(cv2.getRotationMatrix2D((image.shape[1] / 2, image.shape[0] / 2), angle, scale), np.float64)
    matrix[:, 2] += need / 2 - np.array([image.shape[1], image.shape[0]]) / 2
    matrix[:, 2] += rng.uniform(-0.1, 0.1, 2) * need
    cut = cv2.warpAffine(image, matrix, (need, need), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    cut = cut[:, ::-1] if rng.random() < 0.5 else cut
    tile = cut.astype(np.float32)
    ramp = np.linspace(0, 1, overlap, dtype=np.float32)
    for axis in (0, 1):  # cross-fade the far edge into the near one so that the tile wraps
        tile = np.moveaxis(tile, axis, 0)
        blend = tile[:overlap] * ramp[:, None, None] + tile[size : size + overlap] * (1 - ramp)[:, None, None]
        tile = np.concatenate([blend, tile[overlap:size]])
        tile = np.moveaxis(tile, 0, axis)
    gain = np.exp(rng.normal(0, 0.2) + rng.normal(0, 0.07, 3))
    gamma = np.exp(rng.normal(0, 0.15))
    return _to_uint8(255 * np.clip(tile / 255, 0, 1) ** gamma * gain)


def remix(rng: Rng, tile: NDArray[np.uint8], *, patches: int = 90, blend_px: float = 24.0) -> NDArray[np.uint8]:
    """A periodic tile like ``tile`` of which no part as large as a hand is found in another remix of it.

    Patches from anywhere in the tile, every other one mirrored, crossfaded and bent, under grain and lichen of its own:
    the bark of two trees of one kind is alike, and never the same.
    """
    size = tile.shape[0]
    spots = rng.uniform(0, size, (patches, 2))
    shift = rng.integers(0, size, (patches, 2))
    mirrored = rng.random(patches) < 0.5
    grid = np.stack(np.meshgrid(np.arange(size), np.arange(size), indexing="ij"), -1)
    ragged = 0.25 * size / np.sqrt(patches) * np.stack([fractal(rng, size, beta=1.2, low=6) for _ in range(2)], -1)
    distance, nearest = cKDTree(spots, boxsize=size).query((grid + ragged) % size, k=2)
    weight = 0.5 + 0.5 * np.clip((distance[..., 1] - distance[..., 0]) / blend_px, 0, 1)
    layers = []
    for rank in range(2):
        patch = nearest[..., rank]
        row = (grid[..., 0] + shift[patch, 0]) % size
        column = (np.where(mirrored[patch], -grid[..., 1], grid[..., 1]) + shift[patch, 1]) % size
        layers.append(tile[row, column].astype(np.float32))
    mixed = _mix(layers[1], layers[0], weight)
    bend = [rng.uniform(12, 24) * fractal(rng, size, beta=3.5, low=2) for _ in range(2)]
    mixed = np.stack([warp(np.ascontiguousarray(mixed[..., c]), *bend) for c in range(3)], -1)
    mixed = mixed * np.exp(rng.uniform(0.08, 0.16) * _grain(rng, size))[..., None]
    lichen = [pick(rng, ((150, 160, 140), (176, 180, 164), (140, 150, 96), (90, 110, 60), (60, 54, 48)))]
    return _to_uint8(_patches(rng, mixed, size, lichen, rng.uniform(-0.9, 0.1)))


def relief_of(image: NDArray[np.uint8]) -> NDArray[np.floating]:
    """Relief guessed from a photograph: bright is high (fissures are dark)."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32)
    smooth = np.asarray(cv2.GaussianBlur(grey, (0, 0), 2), np.float32)
    low, high = np.percentile(smooth, [3, 97])
    relief: NDArray[np.floating] = (smooth - low) / max(high - low, 1.0)
    return relief.clip(0, 1)


def modulation(rng: Rng, size: int = 256, strength: float = 0.18) -> NDArray[np.uint8]:
    """Slow colour and brightness variation around 128 for :class:`Material`."""
    brightness = strength * fractal(rng, size, beta=1.3, low=1)
    hue = strength * 0.12 * np.stack([fractal(rng, size, beta=1.5) for _ in range(3)], -1)
    return _to_uint8(128 * np.exp((brightness[..., None] + hue) / 2.2 * 1.6))


def make_material(
    rng: Rng, kind: str, photos: Sequence[Path], *, photo_share: float = 0.6, size: int = 1024, own: bool = False
) -> Material:
    """A material of ``kind`` bark, ground, rock or generic; from one of ``photos`` of that kind by chance.

    ``own``: nowhere the same as another one from the same photograph.
    """
    prefix = {"bark": "bark_", "ground": "ground_", "rock": "rock", "generic": ""}[kind]
    suitable = [p for p in photos if p.name.startswith(prefix) and p.suffix == ".jpg"]
    height: Field | None
    if suitable and rng.random() < photo_share:
        image = from_photo(rng, suitable[int(rng.integers(len(suitable)))], size, turn=kind != "bark")
        image = remix(rng, image) if own else image
        height = relief_of(image)
    elif kind == "ground":
        image, height = litter(rng, size), None
    else:
        image, height = {"bark": bark, "rock": rock, "generic": generic}[kind](rng, size)
    size_m = {"bark": (0.8, 1.5), "ground": (1.4, 2.6), "rock": (0.8, 1.8), "generic": (0.7, 1.8)}[kind]
    return Material(
        levels=pyramid(image),
        tile_m=float(rng.uniform(*size_m)),
        height=() if height is None else pyramid(height),
        modulation=modulation(rng, strength=float(rng.uniform(0.1, 0.3))),
        patched=kind in ("ground", "bark"),
        upright=kind == "bark",
    )
