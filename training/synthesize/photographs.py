"""Photographs of a world by the cameras of a walk or cluster, with what a phone does to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fsinfer.scene import Camera
from training.synthesize.cameras.phone import PhoneEffects, Shot, phone_sensor, scaled, shots_of
from training.synthesize.cameras.photo import Sensor, random_sensor
from training.synthesize.forest.world import World, WorldSettings
from training.synthesize.render import Caster


def for_training(effects: PhoneEffects | None, rng: np.random.Generator) -> PhoneEffects | None:
    """``effects`` at random strengths, without a distortion: the network is given straightened images."""
    return None if effects is None else replace(scaled(effects, rng), distortion=0.0)


def with_effects(settings: WorldSettings, effects: PhoneEffects | None) -> WorldSettings:
    """The settings of a world in which the wind blows and every tree has its own bark, as the effects ask."""
    if effects is None:
        return settings
    return replace(settings, windy=effects.wind_m > 0, own_bark=bool(effects.own_bark))


class Photographs:
    """What the cameras of one scene see.

    Attributes
    ----------
    cameras: true pinholes, of each photograph's own focal length and principal point where the phone changes them.
    shots: what happened at each; None without effects.
    """

    def __init__(
        self,
        caster: Caster,
        world: World,
        cameras: Sequence[Camera],
        effects: PhoneEffects | None,
        seed: Sequence[int],
        size: tuple[int, int],
        supersample: int,
    ) -> None:
        self._caster, self._world, self._effects = caster, world, effects
        self._seed, self._size, self._supersample = list(seed), size, supersample
        self.shots: list[Shot] | None = None
        self.cameras = list(cameras)
        if effects is not None:
            self.shots = shots_of(np.random.default_rng([*self._seed, 4]), cameras, effects)
            self.cameras = [shot.camera for shot in self.shots]

    def depth_and_picture(self, i: int, distortion: float = 0.0) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """True depth and linear picture of camera ``i``, in that photograph's gust of wind."""
        if self._effects is not None and self._effects.wind_m:
            gust = np.random.default_rng([*self._seed, 5, i])
            self._caster.blow(gust, self._effects.wind_m, self._world.flutter, self._world.sway)
        depth = self._caster.depth(self.cameras[i], *self._size)
        shot = None if self.shots is None else self.shots[i]
        picture = self._caster.picture(
            self.cameras[i], *self._size, self._supersample, distortion=distortion, shot=shot
        )
        return depth, picture

    def all(self, rng: np.random.Generator) -> tuple[list[NDArray[np.float32]], list[NDArray[np.float32]], Sensor]:
        """True depths and linear pictures of all cameras, and the sensor exposed for the middle one."""
        taken = [self.depth_and_picture(i) for i in range(len(self.cameras))]
        pictures = [picture for _, picture in taken]
        return [depth for depth, _ in taken], pictures, self.sensor(rng, pictures[len(pictures) // 2])

    def sensor(self, rng: np.random.Generator, picture: NDArray[np.float32]) -> Sensor:
        """The phone's sensor, exposed for ``picture``."""
        sensor = random_sensor(rng, picture)
        return sensor if self._effects is None else phone_sensor(sensor, self._effects)
