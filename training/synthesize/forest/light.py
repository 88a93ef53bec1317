"""Sun and sky: the light on surfaces and the panorama that rays see that hit nothing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from training.synthesize.forest.material import TO_LINEAR, lookup
from training.synthesize.forest.noise import fractal

#: Angular radius of the sun as drawn; wider than 0.27 degrees because haze and leaves widen the penumbra.
#: Source: judgement.
SUN_RADIUS_RAD = 0.008


@dataclass(frozen=True, kw_only=True)
class Light:
    """Light of a scene; colours are linear RGB (3,) float32.

    ``panorama`` (h, w, 3) uint8 spans 360 by 90 degrees (+-45 degrees of elevation; its edge rows go on beyond).
    """

    sun_direction: NDArray[np.float32]
    sun: NDArray[np.float32]
    sky: NDArray[np.float32]
    bounce: NDArray[np.float32]
    panorama: NDArray[np.uint8]

    def sky_colour(self, directions: NDArray[np.float32]) -> NDArray[np.float32]:
        """Linear RGB (n, 3) of the sky and the far tree line in ``directions`` (n, 3), any length."""
        length = np.linalg.norm(directions, axis=1)
        u = np.arctan2(directions[:, 1], directions[:, 0]) / (2 * np.pi)
        v = np.clip(0.5 - 2 * np.arcsin(np.clip(directions[:, 2] / length, -1, 1)) / np.pi, 0.001, 0.999)
        return TO_LINEAR[lookup(self.panorama, np.stack([u, v], -1).astype(np.float32))]


def random_light(rng: np.random.Generator, *, forest: bool, panorama_px: int = 1024) -> Light:
    """Draw sun height and strength (a third of scenes are overcast) and paint a panorama ``panorama_px`` high."""
    overcast = rng.random() < 0.35
    elevation, azimuth = np.radians(rng.uniform(22, 65)), rng.uniform(0, 2 * np.pi)
    warm = rng.uniform(0, 0.25) * (1 - elevation)
    sun = np.array([1.0, 0.95 - 0.4 * warm, 0.88 - 1.0 * warm]) * (0.0 if overcast else rng.uniform(1.0, 2.4))
    sky = np.array([0.85, 0.95, 1.1]) * rng.uniform(0.45, 0.8) if not overcast else np.ones(3) * rng.uniform(0.8, 1.2)
    bounce = np.array([0.5, 0.45, 0.35]) * sky * rng.uniform(0.4, 0.8)
    direction = [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    return Light(
        sun_direction=np.array(direction, np.float32),
        sun=sun.astype(np.float32),
        sky=sky.astype(np.float32),
        bounce=bounce.astype(np.float32),
        panorama=_panorama(rng, panorama_px, overcast=overcast, forest=forest),
    )


def _panorama(rng: np.random.Generator, height: int, *, overcast: bool, forest: bool) -> NDArray[np.uint8]:
    """Clouds on a gradient above rows of far trees, the farther the paler; (height, 4 height, 3) gamma-encoded."""
    width, unit = 4 * height, height / 1024
    rows = np.linspace(0, 1, height, dtype=np.float32)[:, None, None]
    clouds = np.tile(fractal(rng, height, beta=1.6, low=2, stretch=2.0), (1, 4))[..., None]
    cover = np.clip(clouds - np.float32(rng.uniform(-1, 1.5) - (2 if overcast else 0)), 0, 1)
    blue = _rgb(110, 150, 205) + _rgb(90, 62, 21) * np.clip(2 * rows, 0, 1)
    image = blue + (_rgb(222, 226, 230) + 12 * clouds - blue) * cover
    detail = fractal(rng, height, beta=0.8, columns=width // 2)
    detail = np.concatenate([detail, detail[:, ::-1]], axis=1)
    trunks = fractal(rng, height, beta=0.3, stretch=60, columns=width // 2)
    # Far trees are pale and soft; a crisp backdrop would give matching more to hold on to than the plot itself.
    crisp = np.float32(rng.uniform(0.05, 0.2))
    tone = np.exp(crisp * detail + crisp * np.concatenate([trunks[:, ::-1], trunks], axis=1))
    green = _rgb(50, 64, 42) * np.float32(rng.uniform(0.6, 1.4)) + rng.normal(0, 5, 3).astype(np.float32)
    haze = _rgb(176, 186, 192) if overcast else _rgb(170, 186, 204)
    far = rng.uniform(0.35, 0.8)
    grey_row = np.arange(height, dtype=np.float32)[:, None]
    for layer, share in enumerate((far, 0.75 * far, 0.5 * far)):
        line = fractal(rng, 64, beta=0.9, columns=width)[0] * np.float32(rng.uniform(10, 30))
        edge = np.float32(512 - rng.uniform(20, 140 if forest else 50) * (1 - 0.25 * layer)) - line
        shift = int(911 * unit) * layer
        cover = np.clip((grey_row / np.float32(unit) - edge[None] + 14 * np.roll(detail, shift, axis=1)) / 2, 0, 1)
        top = max(int((cover > 0).any(1).argmax()), 0)
        trees = np.float32(1 - share) * green * np.roll(tone, shift, axis=1)[top:, :, None] + np.float32(share) * haze
        image[top:] += (trees - image[top:]) * cover[top:, :, None]
    panorama: NDArray[np.uint8] = np.clip(image, 0, 255).astype(np.uint8)
    return panorama


def _rgb(red: float, green: float, blue: float) -> NDArray[np.float32]:
    return np.array([red, green, blue], np.float32)
