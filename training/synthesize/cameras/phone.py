"""What a phone that a walker holds does to a photograph, each effect with its strength, and two presets of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsinfer.scene import Camera
from training.synthesize.cameras.photo import Sensor


@dataclass(frozen=True, kw_only=True)
class PhoneEffects:
    """Strengths; 0 is none of an effect. The presets' values come from the issue of a field trial, see each.

    Attributes
    ----------
    readout_s: seconds from the first to the last row (rolling shutter). Source: phones' sensors read out in 10-30 ms.
    walk_m_s: speed of the phone along the walk while it takes a photograph. Source: who stops for each photograph still
        drifts; a slow walk is 0.4 m/s, a walk 1 m/s.
    turn_rad_s: standard deviation of the phone's rotation about each axis. Source: hand tremor and a walker's turning,
        3-6 degrees a second.
    exposure_s: the shutter's time; motion blur follows from the true motion. Source: 1/125 s in open shade.
    breathing: standard deviation of the focal length from photo to photo, relative (focus breathing). Source: 0.15 %.
    principal_px: standard deviation of the principal point on each axis, pixels (the stabiliser's shift). Source: 2 px.
    distortion: radial k1. Source: what phones leave after their own correction.
    exposure_spread: standard deviation of the log of the exposure from photo to photo. Source: automatic exposure,
        about 30 %.
    wind_m: root mean square displacement of a leaf from photo to photo, metres. Source: a breeze, 1-2 cm.
    clouds: share of the sun that clouds take at most, slowly coming and going. Source: judgement.
    tone: local tone mapping, the share of the large-scale contrast that is taken out. Source: judgement, on phone
        photographs with bright sky over a dark floor.
    noise: gain of the sensor's noise; with tone mapping it shows in the dark. Source: judgement.
    sharpening: unsharp mask added to the sensor's own. Source: judgement.
    glare: veil of the bright sky over what stands before it. Source: judgement.
    quality: JPEG quality, 0 = the sensor's own. Source: video frames are coded harder than photographs.
    own_bark: 1 = every tree of the plot has a bark of its own. Source: trees do.
    """

    readout_s: float = 0.0
    walk_m_s: float = 0.0
    turn_rad_s: float = 0.0
    exposure_s: float = 0.0
    breathing: float = 0.0
    principal_px: float = 0.0
    distortion: float = 0.0
    exposure_spread: float = 0.0
    wind_m: float = 0.0
    clouds: float = 0.0
    tone: float = 0.0
    noise: float = 1.0
    sharpening: float = 0.0
    glare: float = 0.0
    quality: int = 0
    own_bark: int = 0


PHONE = PhoneEffects(
    readout_s=0.025,
    walk_m_s=0.4,
    turn_rad_s=0.06,
    exposure_s=0.008,
    breathing=0.0015,
    principal_px=2.0,
    distortion=0.03,
    exposure_spread=0.26,
    wind_m=0.015,
    clouds=0.7,
    tone=0.35,
    noise=1.3,
    sharpening=0.3,
    glare=0.05,
    own_bark=1,
)
PHONE_VIDEO = replace(PHONE, walk_m_s=1.0, turn_rad_s=0.1, breathing=0.0005, quality=72)


def with_overrides(effects: PhoneEffects, pairs: Sequence[str]) -> PhoneEffects:
    """``effects`` with ``name=value`` pairs changed; a wrong name or value ends the program with a message."""
    names = [field.name for field in fields(PhoneEffects)]
    for pair in pairs:
        name, _, value = pair.partition("=")
        if name not in names:
            raise SystemExit(f"--effect: there is no {name!r}; choose from {', '.join(names)}")
        try:
            effects = replace(effects, **{name: type(getattr(effects, name))(value)})
        except ValueError:
            raise SystemExit(f"--effect {pair}: {value!r} is no number") from None
    return effects


def scaled(effects: PhoneEffects, rng: np.random.Generator) -> PhoneEffects:
    """The same effects, each at a random strength of 0 to 1.5 times its own (training data)."""
    drawn = {name: value * float(rng.uniform(0, 1.5)) for name, value in asdict(effects).items()}
    drawn |= {"noise": 1 + (effects.noise - 1) * float(rng.uniform(0, 1.5))}
    drawn |= {"quality": effects.quality, "own_bark": effects.own_bark}
    return PhoneEffects(**drawn)


@dataclass(frozen=True, kw_only=True)
class Shot:
    """One photograph's true circumstances.

    Attributes
    ----------
    camera: pinhole of the middle row's time, with this photograph's own focal length and principal point.
    velocity_m_s: (3,) in the world. spin_rad_s: (3,) rotation of the camera in its own axes: a direction d fixed in the
        world turns by ``-spin x d`` a second in the camera.
    readout_s, exposure_s: of :class:`PhoneEffects`.
    distortion: radial k1.
    sunshine: share of the sun that comes through, 0..1.
    """

    camera: Camera
    velocity_m_s: NDArray[np.float64]
    spin_rad_s: NDArray[np.float64]
    readout_s: float = 0.0
    exposure_s: float = 0.0
    distortion: float = 0.0
    sunshine: float = 1.0

    def record(self) -> dict[str, Any]:
        """For ``shots.json``."""
        intrinsic = self.camera.intrinsic
        return {
            "focal_px": float(intrinsic[0, 0]),
            "principal_px": [float(intrinsic[0, 2]), float(intrinsic[1, 2])],
            "velocity_m_s": self.velocity_m_s.tolist(),
            "spin_rad_s": self.spin_rad_s.tolist(),
            "readout_s": self.readout_s,
            "exposure_s": self.exposure_s,
            "distortion": self.distortion,
            "sunshine": self.sunshine,
        }


def shots_of(rng: np.random.Generator, cameras: Sequence[Camera], effects: PhoneEffects) -> list[Shot]:
    """Draw what happened at each camera of a walk; the phone moves on towards the next camera."""
    centers = np.array([camera.center for camera in cameras])
    along = np.gradient(centers, axis=0) if len(cameras) > 1 else np.zeros((1, 3))
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    # Clouds come and go over some dozens of photographs.
    phase = rng.uniform(0, 2 * np.pi) + np.cumsum(rng.uniform(0.0, 0.3, len(cameras)))
    cover = np.clip(0.5 + 0.9 * np.sin(phase), 0, 1)
    shots = []
    for camera, direction, cloud in zip(cameras, along, cover, strict=True):
        intrinsic = camera.intrinsic.copy()
        intrinsic[:2, :2] *= 1 + effects.breathing * rng.standard_normal()
        intrinsic[:2, 2] += effects.principal_px * rng.standard_normal(2)
        shots.append(
            Shot(
                camera=replace(camera, intrinsic=intrinsic),
                velocity_m_s=effects.walk_m_s * float(np.exp(0.2 * rng.standard_normal())) * direction,
                spin_rad_s=effects.turn_rad_s * rng.standard_normal(3),
                readout_s=effects.readout_s,
                exposure_s=effects.exposure_s,
                distortion=effects.distortion,
                sunshine=1 - effects.clouds * float(cloud),
            )
        )
    return shots


def phone_sensor(sensor: Sensor, effects: PhoneEffects) -> Sensor:
    """``sensor`` with what the phone's own processing adds."""
    return replace(
        sensor,
        drift=max(sensor.drift, effects.exposure_spread),
        noise=sensor.noise * effects.noise,
        sharpening=sensor.sharpening + effects.sharpening,
        tone=effects.tone,
        glare=effects.glare,
        quality=effects.quality or sensor.quality,
    )
