"""Periodic random fields that textures, terrain and relief are made of."""

from __future__ import annotations

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray

#: Noise falling at least as fast as this has no visible content in its last octave. Source: numerics.
SMOOTH_BETA = 1.3


def fractal(
    rng: np.random.Generator,
    size: int,
    *,
    beta: float = 1.5,
    low: float = 1.0,
    stretch: float = 1.0,
    columns: int | None = None,
) -> NDArray[np.float32]:
    """(size, columns or size) periodic noise, zero mean and unit deviation, amplitude ~ frequency^-beta.

    Frequencies below ``low`` cycles a ``size`` are left out. ``stretch`` > 1 makes the features that many times
    longer along the rows' axis (vertically). Smooth noise is made at half size, where nothing is lost by it.
    """
    half = beta >= SMOOTH_BETA and size >= 512
    rows = size // 2 if half else size
    width = (columns or size) // 2 if half else (columns or size)
    white = rng.standard_normal((rows, width), dtype=np.float32)
    fy = scipy.fft.fftfreq(rows).astype(np.float32)[:, None] * np.float32(rows * stretch)
    fx = scipy.fft.rfftfreq(width).astype(np.float32)[None] * np.float32(rows)
    frequency = np.maximum(np.sqrt(fy * fy + fx * fx), np.float32(0.5))
    gain = np.exp(np.float32(-beta) * np.log(frequency))
    gain[frequency < low] = 0
    field = scipy.fft.irfft2(scipy.fft.rfft2(white) * gain, s=(rows, width))
    field = (field - field.mean()) / max(float(field.std()), 1e-9)
    if half:
        padded = np.pad(field, 4, mode="wrap")
        padded = cv2.resize(padded, (2 * width + 16, 2 * rows + 16), interpolation=cv2.INTER_CUBIC)
        field = padded[8:-8, 8:-8]
    return np.ascontiguousarray(field, np.float32)


def cells(
    rng: np.random.Generator, size: int, count: int, *, stretch: float = 1.0
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Periodic Voronoi cells: (distance to the border / mean cell radius, a random value in [0, 1] per cell)."""
    rows = max(64, int(size / stretch))
    pad = rows // 4
    columns = size
    seeds = np.ones((rows, columns), np.uint8)
    seeds[rng.integers(0, rows, count), rng.integers(0, columns, count)] = 0
    padded = np.pad(seeds, ((pad, pad), (pad, pad)), mode="wrap")
    _, labels = cv2.distanceTransformWithLabels(padded, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    seeds_seen = np.pad(np.arange(rows * columns).reshape(rows, columns), ((pad, pad), (pad, pad)), mode="wrap")
    value_of_label = np.zeros(int(labels.max()) + 1, np.float32)
    at = padded == 0
    values = rng.random(rows * columns, dtype=np.float32)
    value_of_label[labels[at]] = values[seeds_seen[at]]
    border = np.zeros_like(padded)
    border[:, 1:] |= labels[:, 1:] != labels[:, :-1]
    border[1:] |= labels[1:] != labels[:-1]
    distance = cv2.distanceTransform(1 - border, cv2.DIST_L2, 5)
    inner = (slice(pad, pad + rows), slice(pad, pad + columns))
    radius = np.sqrt(rows * columns / count) / 2
    distance = cv2.resize(distance[inner] / radius, (size, size), interpolation=cv2.INTER_LINEAR)
    value = cv2.resize(value_of_label[labels[inner]], (size, size), interpolation=cv2.INTER_NEAREST)
    return distance, value


def warp(field: NDArray[np.floating], dx: NDArray[np.float32], dy: NDArray[np.float32]) -> NDArray[np.floating]:
    """Shift a periodic image by (dx, dy) pixels a pixel."""
    size = field.shape[0]
    grid = np.arange(size, dtype=np.float32)
    map_x = (grid[None] + dx) % size
    map_y = (grid[:, None] + dy) % size
    return np.asarray(cv2.remap(field, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP), field.dtype)
