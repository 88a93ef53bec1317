"""Ray casting with Embree: exact depth of pixel centres, and supersampled linear-light pictures."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from fsinfer.scene import Camera
from training.synthesize.cameras.phone import Shot
from training.synthesize.forest.light import SUN_RADIUS_RAD, Light
from training.synthesize.forest.material import Material, sample
from training.synthesize.forest.mesh import Mesh
from training.synthesize.forest.wind import blown
from training.synthesize.forest.world import World

#: Transparent card texels a ray may pass before it is stopped by the next card as if that were
#: solid. Source: numerics.
CARD_LAYERS = 6
FloatT = TypeVar("FloatT", np.float32, np.float64)
#: Farther than anything, metres. Source: numerics.
FAR_M = 1e4


@dataclass(kw_only=True)
class Hits:
    """First hits of n rays: distance ``t`` along the unnormalised direction (inf = none), corner data."""

    t: NDArray[np.float32]
    face: NDArray[np.int32]
    u: NDArray[np.float32]
    v: NDArray[np.float32]
    card: NDArray[np.bool_]
    swaying: NDArray[np.bool_]


class _Tree:
    """A mesh in an Embree tree of its own."""

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh
        self.scene = EmbreeScene(robust=True)
        self._keep = TriangleMesh(self.scene, mesh.vertices, mesh.faces)


class Caster:
    """The scene's geometry in Embree trees (opaque surfaces; alpha-tested cards; thin stems that sway), lit.

    Without wind thin stems belong to ``opaque``, and there is no tree of ``swaying``.
    """

    def __init__(
        self,
        opaque: Mesh,
        cards: Mesh | None,
        materials: list[Material],
        light: Light,
        *,
        swaying: Mesh | None = None,
    ) -> None:
        """Build the trees."""
        self.materials, self.light, self.sunshine = materials, light, 1.0
        self._opaque = _Tree(opaque)
        self._cards = None if cards is None else _Tree(cards)
        self._swaying = None if swaying is None else _Tree(swaying)
        self._calm = (cards, swaying)

    @classmethod
    def of(cls, world: World) -> Caster:
        """The whole of a world, in the calm."""
        return cls(world.opaque, world.cards, world.materials, world.light, swaying=world.swaying)

    def blow(
        self,
        rng: np.random.Generator,
        strength_m: float,
        flutter: NDArray[np.float32],
        sway: NDArray[np.float32],
    ) -> None:
        """Move the cards and the thin stems from where they hang in the calm (:mod:`forest.wind`), shadows with them.

        ``flutter`` and ``sway`` are the weights of the vertices of the cards and of the thin stems.
        """
        cards, swaying = self._calm
        if cards is not None:
            self._cards = _Tree(replace(cards, vertices=blown(rng, cards.vertices, flutter, strength_m, own=4)))
        if swaying is not None:
            self._swaying = _Tree(replace(swaying, vertices=blown(rng, swaying.vertices, sway, strength_m, own=0)))

    def cast(self, origins: NDArray[np.float32], directions: NDArray[np.float32]) -> Hits:
        """First solid hit of each ray (n, 3)."""
        found = self._opaque.scene.run(origins, directions, query="INTERSECT", output=True)
        missed = found["primID"] < 0
        t = np.where(missed, np.float32(np.inf), found["tfar"])
        none = np.zeros(len(t), bool)
        hits = Hits(t=t, face=found["primID"], u=found["u"], v=found["v"], card=none, swaying=none.copy())
        if self._swaying is not None:
            found = self._swaying.scene.run(origins, directions, query="INTERSECT", output=True)
            near = (found["primID"] >= 0) & (found["tfar"] < hits.t)
            hits.t[near], hits.face[near] = found["tfar"][near], found["primID"][near]
            hits.u[near], hits.v[near], hits.swaying[near] = found["u"][near], found["v"][near], True
        if self._cards is None:
            return hits
        active = np.arange(len(t))
        start = np.zeros(len(t), np.float32)
        for layer in range(CARD_LAYERS):
            rays = directions[active]
            found = self._cards.scene.run(origins[active] + rays * start[:, None], rays, query="INTERSECT", output=True)
            at = np.where(found["primID"] < 0, np.float32(np.inf), found["tfar"] + start)
            near = at < hits.t[active]
            active, at = active[near], at[near]
            if len(active) == 0:
                break
            face, u, v = found["primID"][near], found["u"][near], found["v"][near]
            solid = self._alpha(face, u, v) >= 0.5 if layer < CARD_LAYERS - 1 else np.ones(len(active), bool)
            index = active[solid]
            hits.t[index], hits.face[index], hits.u[index], hits.v[index] = at[solid], face[solid], u[solid], v[solid]
            hits.card[index], hits.swaying[index] = True, False
            active = active[~solid]
            start = at[~solid] * np.float32(1 + 1e-5) + np.float32(1e-4)
        return hits

    def _alpha(self, face: NDArray[np.int32], u: NDArray[np.float32], v: NDArray[np.float32]) -> NDArray[np.float32]:
        if self._cards is None:
            return np.ones(len(face), np.float32)
        cards = self._cards.mesh
        uv = interpolate(cards.uv[face], u, v)
        # The finest level whatever the distance, so that all views see the same outline.
        return sample(self.materials, cards.material[face], uv, np.zeros(len(face), np.float32))[:, 3]

    def lit_by_sun(self, points: NDArray[np.float32], direction: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Whether the sun in ``direction`` (3,) is seen from ``points`` (n, 3)."""
        rays = np.broadcast_to(direction, points.shape).astype(np.float32)
        far = np.full(len(points), FAR_M, np.float32)
        free: NDArray[np.bool_] = self._opaque.scene.run(points, rays, dists=far, query="OCCLUDED") != 0
        if self._swaying is not None:
            free &= self._swaying.scene.run(points, rays, dists=far, query="OCCLUDED") != 0
        if self._cards is None:
            return free
        active = np.flatnonzero(free)
        start = points[active]
        for _ in range(4):
            if len(active) == 0:
                break
            found = self._cards.scene.run(start, rays[active], query="INTERSECT", output=True)
            hit = found["primID"] >= 0
            active, start, t = active[hit], start[hit], found["tfar"][hit]
            solid = self._alpha(found["primID"][hit], found["u"][hit], found["v"][hit]) >= 0.5
            free[active[solid]] = False
            start = (start + rays[active] * (t[:, None] + np.float32(1e-3)))[~solid]
            active = active[~solid]
        return free

    def depth(self, camera: Camera, width: int, height: int) -> NDArray[np.float32]:
        """Exact z depth (height, width) of the pixel centres, 0 where nothing is hit."""
        origins, directions = pixel_rays(camera, width, height, (0.0, 0.0))
        hits = self.cast(origins, directions)
        return np.where(np.isfinite(hits.t), hits.t, 0).astype(np.float32).reshape(height, width)

    def picture(
        self,
        camera: Camera,
        width: int,
        height: int,
        supersample: int = 2,
        *,
        distortion: float = 0.0,
        shot: Shot | None = None,
    ) -> NDArray[np.float32]:
        """Linear RGB (height, width, 3): the mean of ``supersample``^2 rays set symmetrically in each pixel.

        The mean is taken of gamma-encoded values, as in a phone's photograph that was made smaller; a mean of
        light would move the edges between black and white by a third of a pixel towards the black.
        ``distortion`` is the radial k1 of the picture (depth maps and cameras stay pinhole). With a ``shot`` the
        phone moves while it reads the rows out and while each is exposed, and its own lens and sunshine count.
        """
        self.sunshine = 1.0 if shot is None else shot.sunshine
        offsets = (np.arange(supersample) + 0.5) / supersample - 0.5
        total = np.zeros((height * width, 3), np.float32)
        number = 0
        for dy in offsets:
            for dx in offsets:
                offset = (float(dx), float(dy))
                if shot is None:
                    origins, directions = pixel_rays(camera, width, height, offset, distortion)
                else:
                    origins, directions = moving_rays(shot, width, height, offset, (number, supersample**2))
                angle = 2 * np.pi * number / supersample**2 + 0.4
                light = self._shade(origins, directions, float(camera.intrinsic[0, 0]) * supersample, angle)
                total += np.sqrt(light)
                number += 1
        return np.asarray((total / number) ** 2, np.float32).reshape(height, width, 3)

    def _shade(
        self, origins: NDArray[np.float32], directions: NDArray[np.float32], focal_px: float, sun_angle: float
    ) -> NDArray[np.float32]:
        hits = self.cast(origins, directions)
        colour = np.empty_like(directions)
        sky = ~np.isfinite(hits.t)
        if sky.any():
            colour[sky] = self.light.sky_colour(directions[sky])
        solid = ~sky & ~hits.card & ~hits.swaying
        for tree, chosen in ((self._opaque, solid), (self._swaying, hits.swaying), (self._cards, ~sky & hits.card)):
            index = np.flatnonzero(chosen)
            if tree is None or len(index) == 0:
                continue
            mesh = tree.mesh
            t, face, u, v = hits.t[index], hits.face[index], hits.u[index], hits.v[index]
            rays = directions[index]
            points = origins[index] + rays * t[:, None]
            corners = mesh.faces[face]
            normals = interpolate(mesh.normals[corners], u, v)
            is_card = tree is self._cards
            facing = (normals * rays).sum(1)
            if is_card:
                normals = np.where(facing[:, None] > 0, -normals, normals)
            materials = mesh.material[face]
            slant = np.clip(np.abs(facing) / np.linalg.norm(rays, axis=1), 0.15, 1.0)
            texel = sample(self.materials, materials, interpolate(mesh.uv[face], u, v), t / focal_px / np.sqrt(slant))
            albedo = texel[:, :3] * interpolate(mesh.tint[corners], u, v)
            colour[index] = albedo * self._irradiance(points, normals, rays, is_card, sun_angle)
        return colour

    def _irradiance(
        self,
        points: NDArray[np.float32],
        normals: NDArray[np.float32],
        rays: NDArray[np.float32],
        is_card: bool,
        sun_angle: float,
    ) -> NDArray[np.float32]:
        light = self.light
        upward = (0.5 + 0.5 * normals[:, 2:]).astype(np.float32)
        # Clouds before the sun brighten the rest of the sky a little.
        total = (light.sky * upward + light.bounce * (1 - upward)) * np.float32(1 + 0.3 * (1 - self.sunshine))
        if light.sun.any() and self.sunshine > 0:
            side = np.cross(light.sun_direction, [0.0, 0.0, 1.0])
            side /= np.linalg.norm(side)
            rise = np.cross(side, light.sun_direction)
            shift = SUN_RADIUS_RAD * (np.cos(sun_angle) * side + np.sin(sun_angle) * rise)
            direction = (light.sun_direction + shift).astype(np.float32)
            incidence = normals @ light.sun_direction
            incidence = 0.35 + 0.45 * np.abs(incidence) if is_card else np.maximum(incidence, 0)
            index = np.flatnonzero(incidence > 0)
            lift = normals[index] * np.float32(0.003) if not is_card else np.float32(0.003) * direction
            lit = self.lit_by_sun((points[index] + lift).astype(np.float32), direction)
            index = index[lit]
            total[index] += incidence[index, None] * light.sun * np.float32(self.sunshine)
        return total


def interpolate(corners: NDArray[np.float32], u: NDArray[np.float32], v: NDArray[np.float32]) -> NDArray[np.float32]:
    """Barycentric mean of (n, 3, k) corner values; Embree's u and v weigh the second and third corner."""
    return corners[:, 0] + u[:, None] * (corners[:, 1] - corners[:, 0]) + v[:, None] * (corners[:, 2] - corners[:, 0])


def pixel_rays(
    camera: Camera, width: int, height: int, offset: tuple[float, float], distortion: float = 0.0
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Rays through (u + dx, v + dy) of every pixel, row by row; directions have z = 1 in the camera frame.

    So the distance along a ray is the z depth. Pixel centres lie at integers: ray = K^-1 (u, v, 1). With
    ``distortion`` k1 the ray (x, y, 1) is the one whose x (1 + k1 r^2), y (1 + k1 r^2) falls on the pixel.
    """
    columns = camera.cam_from_world[:3, :3].T @ np.linalg.inv(camera.intrinsic)
    across = (np.arange(width) + offset[0])[:, None] * columns[:, 0]
    along = (np.arange(height) + offset[1])[:, None] * columns[:, 1] + columns[:, 2]
    directions = (across[None] + along[:, None]).astype(np.float32).reshape(-1, 3)
    if distortion:
        rays = directions.astype(np.float64) @ camera.cam_from_world[:3, :3].T
        rays[:, :2] *= _undistorted_share((rays[:, :2] ** 2).sum(1), distortion)[:, None]
        directions = np.ascontiguousarray(rays @ camera.cam_from_world[:3, :3], dtype=np.float32)
    origins = np.empty_like(directions)
    origins[:] = camera.center
    return origins, directions


def moving_rays(
    shot: Shot, width: int, height: int, offset: tuple[float, float], sample_of: tuple[int, int]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """As :func:`pixel_rays`, each pixel at its own time; directions have z = 1 in the camera of that time.

    Row v is read at (v + 0.5) / height - 0.5 of ``readout_s``; within ``exposure_s`` the rays of a pixel, of which this
    is number ``sample_of[0]`` of ``sample_of[1]``, are spread evenly, another one first from pixel to pixel, so that
    the blur of motion is the mean and moves nothing.
    """
    camera = shot.camera
    inverse = np.linalg.inv(camera.intrinsic)
    x = inverse[0, 0] * (np.arange(width) + offset[0]) + inverse[0, 2]
    y = inverse[1, 1] * (np.arange(height) + offset[1]) + inverse[1, 2]
    rays = np.ones((height, width, 3), np.float32)
    rays[..., 0], rays[..., 1] = x[None], y[:, None]
    rays[..., :2] *= _undistorted_share(rays[..., 0] ** 2 + rays[..., 1] ** 2, shot.distortion)[..., None]
    number, count = sample_of
    turn = (np.arange(width)[None] * 3 + np.arange(height)[:, None] * 5 + number) % count
    row_time = ((np.arange(height) + 0.5) / height - 0.5)[:, None] * shot.readout_s
    exposed = ((turn + 0.5) / count - 0.5) * shot.exposure_s
    time = np.asarray(row_time + exposed, np.float32)[..., None]
    # The camera has turned by spin * time: its ray d looks where the middle row's camera sees d + time * spin x d (the
    # angles are some milliradians).
    spin = shot.spin_rad_s
    cross = np.array([[0, -spin[2], spin[1]], [spin[2], 0, -spin[0]], [-spin[1], spin[0], 0]])
    rays += time * (rays @ cross.T.astype(np.float32))
    directions = rays @ camera.cam_from_world[:3, :3].astype(np.float32)
    origins = camera.center.astype(np.float32) + time * shot.velocity_m_s.astype(np.float32)
    return origins.reshape(-1, 3), np.ascontiguousarray(directions.reshape(-1, 3))


def _undistorted_share(squared: NDArray[FloatT], k1: float) -> NDArray[FloatT]:
    """What a distorted radius with this square is to be multiplied by for the pinhole's, by fixed point.

    |k1| r^2 is small.
    """
    share = np.ones_like(squared)
    for _ in range(10 if k1 else 0):
        share = np.asarray(1 / (1 + k1 * squared * share**2), squared.dtype)
    return share
