"""Sun and sky: the light on surfaces and the panorama that rays see that hit nothing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from training.synthesize.material import TO_LINEAR, lookup
from training.synthesize.noise import fractal

#: Angular radius of the sun as drawn; wider than 0.27 degrees because haze and leaves widen the penumbra.
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


def random_light(rng: np.random.Generator, *, forest: bool) -> Light:
    """Draw sun height and strength (a third of the scenes are overcast) and paint the panorama."""
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
        panorama=_panorama(rng, overcast=overcast, forest=forest),
    )


def _panorama(rng: np.random.Generator, *, overcast: bool, forest: bool) -> NDArray[np.uint8]:
    """Clouds on a gradient above rows of far trees, the farther the paler; (1024, 4096, 3) gamma-encoded."""
    height, width = 1024, 4096
    rows = np.linspace(0, 1, height, dtype=np.float32)[:, None]
    clouds = np.tile(fractal(rng, 1024, beta=1.6, low=2, stretch=2.0), (1, 4))
    cover = np.clip(clouds - rng.uniform(-1, 1.5) + (2 if overcast else 0), 0, 1)[..., None]
    top, low = np.array([110, 150, 205], np.float32), np.array([200, 212, 226], np.float32)
    blue = top + (low - top) * np.clip(2 * rows[..., None], 0, 1)
    image = blue + (np.array([222, 226, 230], np.float32) + 12 * clouds[..., None] - blue) * cover
    detail = fractal(rng, 1024, beta=0.8, columns=2048)
    detail = np.concatenate([detail, detail[:, ::-1]], axis=1)
    trunks = fractal(rng, 1024, beta=0.3, stretch=60, columns=2048)
    trunks = np.concatenate([trunks[:, ::-1], trunks], axis=1)
    green = np.array([50, 64, 42]) * rng.uniform(0.6, 1.4) + rng.normal(0, 5, 3)
    haze = np.array([176, 186, 192]) if overcast else np.array([170, 186, 204])
    far = rng.uniform(0.2, 0.7)
    grey_row = np.arange(height, dtype=np.float32)[:, None]
    for layer, share in enumerate((far, 0.6 * far, 0.3 * far)):
        line = fractal(rng, 512, beta=0.9, columns=width)[0] * rng.uniform(10, 30)
        edge = height / 2 - rng.uniform(20, 140 if forest else 50) * (1 - 0.25 * layer) - line
        shift = 911 * layer
        texture = np.roll(detail, shift, axis=1)
        tone = np.exp(0.35 * texture + 0.3 * np.roll(trunks, shift, axis=1))[..., None]
        trees = ((1 - share) * green).astype(np.float32) * tone + (share * haze).astype(np.float32)
        cover = np.clip((grey_row - edge[None] + 14 * texture) / 2, 0, 1)[..., None]
        image = image + (trees - image) * cover
    return np.clip(image, 0, 255).astype(np.uint8)
