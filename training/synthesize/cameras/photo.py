"""From linear light to a phone's JPEG: exposure, white balance, vignetting, blur, noise, tone curve."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True)
class Sensor:
    """What stays the same within one scene's photographs.

    ``tone`` takes that share of the large-scale contrast out (local tone mapping); ``glare`` spreads that share of
    the light beyond white over the picture.
    """

    exposure: float
    white_balance: NDArray[np.float64]
    gamma: float
    contrast: float
    saturation: float
    vignetting: float
    noise: float
    blur_px: float
    quality: int
    drift: float
    sharpening: float
    tone: float = 0.0
    glare: float = 0.0


def random_sensor(rng: np.random.Generator, linear: NDArray[np.float32]) -> Sensor:
    """Draw a sensor whose exposure suits ``linear`` (a picture of the scene)."""
    key = float(np.percentile(linear.mean(-1), 60))
    return Sensor(
        exposure=0.22 * float(np.exp(rng.normal(0, 0.2))) / max(key, 1e-4),
        white_balance=np.exp(rng.normal(0, 0.04, 3)),
        gamma=rng.uniform(2.0, 2.4),
        contrast=rng.uniform(0.0, 0.7),
        saturation=rng.uniform(0.8, 1.25),
        vignetting=rng.uniform(0.0, 0.3),
        noise=float(np.exp(rng.uniform(np.log(0.002), np.log(0.014)))),
        blur_px=rng.uniform(0.15, 0.6),
        quality=int(rng.integers(80, 96)),
        drift=rng.uniform(0.02, 0.12),
        sharpening=rng.uniform(0.0, 0.7),
    )


def expose(rng: np.random.Generator, sensor: Sensor, linear: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Turn linear RGB (h, w, 3) into an 8-bit photograph with this frame's own exposure, blur and noise."""
    height, width = linear.shape[:2]
    gain = sensor.exposure * np.exp(rng.normal(0, sensor.drift))
    image = linear * (gain * sensor.white_balance * np.exp(rng.normal(0, 0.015, 3))).astype(np.float32)
    y, x = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
    image = image * (1 - sensor.vignetting * (x**2 + y**2) / 2)[..., None].astype(np.float32)
    if sensor.glare:
        image = image + np.float32(sensor.glare) * _veil(image)
    noise = rng.standard_normal(image.shape, dtype=np.float32)
    noise *= np.sqrt(sensor.noise**2 * np.clip(image, 0.02, 1) * 4 + 1e-6)
    image = image / (1 + np.maximum(image - 0.7, 0) * 0.7)  # soft shoulder of highlights
    gamma = np.float32(1 / sensor.gamma)
    encoded = np.clip(image, 0, 1) ** gamma
    grain = (np.clip(image + noise, 0, 1) ** gamma) - encoded
    if sensor.tone:
        lift = _tone_gain(encoded, sensor.tone)
        encoded, grain = encoded * lift, grain * lift  # lifted shadows show their noise
    # Blur after the tone curve, like most of what a phone does to a picture, so that edges stay where they are.
    image = cv2.GaussianBlur(encoded, (0, 0), max(0.1, sensor.blur_px * np.exp(rng.normal(0, 0.2))))
    if rng.random() < 0.25:  # a hand that moved a little during the exposure
        image = cv2.filter2D(image, -1, _motion_kernel(rng, rng.uniform(0.4, 1.4)))
    image = image + grain
    image = image + sensor.sharpening * (image - cv2.GaussianBlur(image, (0, 0), 1.2))
    image = image + sensor.contrast * image * (1 - image) * (image - 0.5)
    grey = image.mean(-1, keepdims=True)
    photograph: NDArray[np.uint8] = np.clip((grey + sensor.saturation * (image - grey)) * 255 + 0.5, 0, 255).astype(
        np.uint8
    )
    return photograph


def _veil(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """Light (h, w, 3) that lens and cover glass scatter: a halo of a fiftieth of the width, and a haze over all."""
    bright = np.minimum(image, 4.0).astype(np.float32)
    small = cv2.resize(bright, None, fx=0.125, fy=0.125, interpolation=cv2.INTER_AREA)
    halo = cv2.GaussianBlur(small, (0, 0), image.shape[1] / 8 / 50)
    halo = cv2.resize(halo, (image.shape[1], image.shape[0]), interpolation=cv2.INTER_LINEAR)
    veil: NDArray[np.float32] = (halo + bright.mean((0, 1))).astype(np.float32)
    return veil


def _tone_gain(encoded: NDArray[np.float32], share: float) -> NDArray[np.float32]:
    """Gain (h, w, 1) that brings the neighbourhood of each pixel that share of the way to a middle grey."""
    luma = cv2.resize(encoded.mean(-1), None, fx=0.125, fy=0.125, interpolation=cv2.INTER_AREA)
    base = cv2.GaussianBlur(luma, (0, 0), max(1.0, encoded.shape[1] / 8 / 30))
    base = cv2.resize(base, (encoded.shape[1], encoded.shape[0]), interpolation=cv2.INTER_LINEAR)
    gain: NDArray[np.float32] = ((0.45 / np.maximum(base, 0.05)) ** share)[..., None].astype(np.float32)
    return gain


def _motion_kernel(rng: np.random.Generator, length_px: float) -> NDArray[np.float32]:
    size = 2 * int(np.ceil(length_px / 2)) + 3
    direction = rng.uniform(0, np.pi)
    kernel = np.zeros((size, size), np.float32)
    for t in np.linspace(-0.5, 0.5, 15) * length_px:  # symmetric, so that it moves nothing
        x, y = size // 2 + t * np.cos(direction), size // 2 + t * np.sin(direction)
        x0, y0 = int(np.floor(x)), int(np.floor(y))
        for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)):
            kernel[y0 + j, x0 + i] += (1 - abs(x - x0 - i)) * (1 - abs(y - y0 - j))
    kernel /= kernel.sum()
    return kernel
