"""Alpha textures for cards: leaf sprays, needle twigs, ferns, grass tufts; procedural or from photographs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from training.synthesize.forest.material import Material, pyramid
from training.synthesize.forest.textures import GREEN, LEAVES, _grain, _photo, pick

KINDS = ("leaves", "needles", "fern", "grass")


def _leaf(
    canvas: NDArray[np.uint8],
    at: NDArray[np.float64],
    angle: float,
    length: float,
    width: float,
    rgb: NDArray[np.float64],
) -> None:
    t = np.linspace(0, 1, 9)
    half = width * np.sin(np.pi * t**0.8) * 0.5
    outline = np.concatenate([np.stack([t * length, half], -1), np.stack([t * length, -half], -1)[::-1]])
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    shape = (at + outline @ turn) * 16
    colour = (*(float(c) for c in np.clip(rgb, 0, 255)), 255.0)
    cv2.fillPoly(canvas, [shape.astype(np.int32)], colour, cv2.LINE_8, 4)
    tip = at + np.array([length, 0]) @ turn
    vein = (*(float(c) for c in np.clip(rgb * 1.25, 0, 255)), 255.0)
    cv2.line(canvas, at.astype(int).tolist(), tip.astype(int).tolist(), vein, 1)


def _finish(rng: np.random.Generator, canvas: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Grain, and the mean colour under the transparent part so that mips have no dark fringe."""
    rgb, alpha = canvas[..., :3].astype(np.float32), canvas[..., 3]
    solid = alpha > 127
    if solid.any():
        rgb[~solid] = rgb[solid].mean(0)
    rgb = rgb * np.exp(0.15 * _grain(rng, canvas.shape[0]))[..., None]
    return np.dstack([np.clip(rgb, 0, 255).astype(np.uint8), np.where(solid, 255, 0).astype(np.uint8)])


def procedural_card(rng: np.random.Generator, kind: str, size: int = 256) -> NDArray[np.uint8]:
    """An RGBA card (size, size, 4); the stalk's foot is at the middle of the lower edge."""
    canvas = np.zeros((size, size, 4), np.uint8)
    palette = GREEN if rng.random() < 0.75 else LEAVES
    base = pick(rng, palette)
    foot, up = np.array([size / 2, size * 0.98]), -np.pi / 2

    def tone() -> NDArray[np.float64]:
        varied: NDArray[np.float64] = base * np.exp(rng.normal(0, 0.2)) * np.exp(rng.normal(0, 0.05, 3))
        return varied

    if kind == "grass":
        for _ in range(int(rng.integers(14, 40))):
            start = foot + np.array([rng.normal(0, size * 0.13), 0])
            _leaf(canvas, start, up + rng.normal(0, 0.3), size * rng.uniform(0.4, 0.95), size * 0.018 + 2, tone())
    elif kind == "fern":
        for frond in range(int(rng.integers(1, 4))):
            lean = up + (rng.normal(0, 0.5) if frond else rng.normal(0, 0.1))
            for t in np.linspace(0.12, 0.95, 16):
                at = foot + size * 0.9 * t * np.array([np.cos(lean), np.sin(lean)])
                for side in (-1, 1):
                    _leaf(canvas, at, lean + side * 1.15, size * 0.3 * (1.02 - t), size * 0.045, tone())
    else:
        for _ in range(int(rng.integers(3, 7))):
            lean, reach = up + rng.normal(0, 0.6), size * rng.uniform(0.5, 0.95)
            twig = np.array([np.cos(lean), np.sin(lean)])
            pen = (70.0, 56.0, 42.0, 255.0)
            cv2.line(canvas, foot.astype(int).tolist(), (foot + reach * twig).astype(int).tolist(), pen, 2)
            count = 34 if kind == "needles" else int(rng.integers(6, 12))
            for t in rng.uniform(0.15, 1.0, count):
                side = rng.choice([-1, 1]) * rng.uniform(0.5, 1.2)
                length = size * (rng.uniform(0.08, 0.13) if kind == "needles" else rng.uniform(0.13, 0.24))
                width = 2.5 if kind == "needles" else length * rng.uniform(0.4, 0.6)
                _leaf(canvas, foot + t * reach * twig, lean + side, length, width, tone())
    return _finish(rng, canvas)


def card_material(rng: np.random.Generator, kind: str, photos: Sequence[Path], size_m: float = 0.4) -> Material:
    """A card material; sprays of leaves may come from ``photos`` (leafcard_*.png)."""
    suitable = [p for p in photos if p.name.startswith("leafcard") and p.suffix == ".png"]
    if kind == "leaves" and suitable and rng.random() < 0.6:
        image = _photo(suitable[int(rng.integers(len(suitable)))])
        image = np.asarray(cv2.resize(image, (256, 256), interpolation=cv2.INTER_AREA), np.uint8)
        gain = np.exp(rng.normal(0, 0.2) + rng.normal(0, 0.12, 3))
        image = np.dstack([np.clip(image[..., :3] * gain, 0, 255).astype(np.uint8), image[..., 3]])
        image = _finish(rng, image)
    else:
        image = procedural_card(rng, kind)
    # Coarser mips would melt the alpha into a blob, so the pyramid ends at 32 pixels.
    return Material(levels=pyramid(image)[:4], tile_m=size_m, translucency=float(rng.uniform(0.3, 0.6)))
