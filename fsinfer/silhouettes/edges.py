"""Edges of stems in the photographs: strips across each stem about breast height, and where they end.

For every photograph that shows a stem unhidden (its depth map agrees), a strip is cut out along the stem's axis, in the
plane through the axis that faces the camera. In bands along the axis the colour gradient across it is averaged: a
stem's edge is straight and adds up, bark and leaves do not. Which of them the depth map shows to be another's is told
with them (:mod:`fsinfer.silhouettes.edge_depths`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from fsinfer.depth.maps import DepthMaps
from fsinfer.geometry.similarity import scale_of, scaling
from fsinfer.processes import shared_out
from fsinfer.progress import Progress, silent
from fsinfer.scene import Camera, Scene, project, read_view_image
from fsinfer.silhouettes.edge_depths import may_be_edges
from fsinfer.silhouettes.edge_settings import EdgeSettings
from fsinfer.silhouettes.stem_axis import StemAxis, facing
from fsinfer.silhouettes.visibility import BOTH_SIDES, sides_shown, stems_in_reach
from fsinfer.trees.diameter.edge_set import Edges

Floats = NDArray[np.float64]


#: Samples of a strip across the stem for each pixel, and for each radius at most; and least metres between its rows,
#: and their least number. Source: numerics.
SAMPLES_PER_PX, MOST_SAMPLES_OF_RADIUS, LEAST_ROW_M, LEAST_ROWS = 2.0, 60.0, 0.004, 8
#: Where the strip of one half begins beside the axis, in radii. Source: judgement, what lies before the other half ends
#: at the axis at the nearest.
HALF_FROM = 0.15
#: Of the rows of candidates. Source: layout.
HEIGHT_COLUMN = 4
#: The greatest grey value. Source: format.
WHITE = np.float32(255.0)
#: Share of its rows that must lie inside the photograph, or a strip is not used. Source: not recorded.
LEAST_INSIDE = 0.7


@dataclass(frozen=True, kw_only=True)
class Strip:
    """One photograph's view of one stem.

    ``image`` (H, W, 3) float32 is sampled at ``heights_m`` (H,) along the axis and ``offsets_m`` (W,) across, where
    offsets are those of a cylinder with the stem's taper. ``sides`` are those whose edges it shows, -1 to the left and
    +1 to the right; with one of them it has that half of the stem only. ``right`` is the unit vector (3,) of growing
    offsets, to the right in the photograph, ``towards`` that from the axis to the camera, ``distance_m`` the camera's
    from the axis, ``pixel_m`` one pixel.
    """

    photo: int
    image: NDArray[np.float32]
    heights_m: Floats
    offsets_m: Floats
    right: Floats
    towards: Floats
    distance_m: float
    pixel_m: float
    sides: tuple[float, ...] = BOTH_SIDES


def find_edges(
    stems: Sequence[StemAxis],
    scene: Scene,
    maps: DepthMaps,
    cloud_from_scene: Floats,
    *,
    settings: EdgeSettings | None = None,
    on_strip: Callable[[int, Strip], None] | None = None,
    progress: Progress = silent,
) -> list[Edges]:
    """Find candidate edges of each stem in all photographs that show it; each photograph is read at most once.

    Photographs that show one edge have candidates on that side alone
    (:func:`fsinfer.trees.diameter.edge_set.two_sided`).

    ``cloud_from_scene`` (4, 4) is the similarity that made the cloud of the scene. ``on_strip`` is given every strip
    with its stem's number, for those who want to look at them. Raises :class:`~fsinfer.errors.FsinferError` where a
    photograph or a depth map cannot be read.
    """
    s = settings or EdgeSettings()
    found: list[list[Floats]] = [[] for _ in stems]

    look = partial(_look_at, tuple(stems), scene, maps, cloud_from_scene, s, with_strips=on_strip is not None)
    progress(0, len(maps.available), "edges of stems")
    for done, seen in enumerate(shared_out(look, maps.available), 1):
        for number, strip, candidates in seen:
            found[number].append(candidates)
            if on_strip is not None and strip is not None:
                on_strip(number, strip)
        progress(done, len(maps.available), "edges of stems")
    return [_edges(rows) for rows in found]


def _look_at(
    stems: Sequence[StemAxis],
    scene: Scene,
    maps: DepthMaps,
    cloud_from_scene: Floats,
    s: EdgeSettings,
    index: int,
    *,
    with_strips: bool,
) -> list[tuple[int, Strip | None, Floats]]:
    """Of photograph ``index`` the stems' numbers, their strips where those are wanted, and candidates.

    Their last column is 1 where they may be the stem's own.
    """
    seen: list[tuple[int, Strip | None, Floats]] = []
    camera, metres = _in_cloud(scene.views[index].camera, cloud_from_scene), scale_of(cloud_from_scene)
    for number, strip in strips_of_photo(stems, index, scene, maps, cloud_from_scene, settings=s):
        stem = stems[number]
        offsets, rows = _candidates(strip, stem, s)
        own = may_be_edges(
            offsets,
            rows[:, HEIGHT_COLUMN],
            strip.right,
            strip.pixel_m,
            stem=stem,
            camera=camera,
            depth_map=maps.get(index),
            metres=metres,
            settings=s,
        )
        seen.append((number, strip if with_strips else None, np.column_stack([rows, own])))
    return seen


def strips_of_photo(
    stems: Sequence[StemAxis],
    index: int,
    scene: Scene,
    maps: DepthMaps,
    cloud_from_scene: Floats,
    *,
    settings: EdgeSettings | None = None,
) -> list[tuple[int, Strip]]:
    """Cut out the strips of photograph ``index``: pairs of the stem's number and its strip."""
    s = settings or EdgeSettings()
    view = scene.views[index]
    camera = _in_cloud(view.camera, cloud_from_scene)
    metres = scale_of(cloud_from_scene)
    near = [(n, stems[n]) for n in stems_in_reach(stems, camera, s)]
    if not near:
        return []
    depth_map = maps.get(index)
    rows, columns = depth_map.inverse_depth.shape
    size = np.array([columns * depth_map.grid.step_x, rows * depth_map.grid.step_y])
    seen = [(n, stem, sides) for n, stem in near if (sides := sides_shown(stem, camera, size, depth_map, metres, s))]
    if not seen:
        return []
    image = read_view_image(view).astype(np.float32)
    strips = [(n, _cut(stem, camera, image, index, s, sides)) for n, stem, sides in seen]
    return [(n, strip) for n, strip in strips if strip is not None]


def _in_cloud(camera: Camera, cloud_from_scene: Floats) -> Camera:
    """Return the camera with metres of the cloud instead of scene units: same rays, z depth in metres."""
    metres = scale_of(cloud_from_scene)
    pose = scaling(metres) @ camera.cam_from_world @ np.linalg.inv(cloud_from_scene)
    return Camera(
        intrinsic=camera.intrinsic,
        cam_from_world=pose,
        depth_min=camera.depth_min * metres,
        depth_max=camera.depth_max * metres,
    )


def _cut(
    stem: StemAxis, camera: Camera, image: NDArray[np.float32], index: int, s: EdgeSettings, sides: tuple[float, ...]
) -> Strip | None:
    right, towards, distance = facing(stem, camera)
    depth = float(project(stem.breast, camera)[1])
    pixel_m = depth / float(camera.intrinsic[0, 0])
    step = max(pixel_m / SAMPLES_PER_PX, stem.radius_m / MOST_SAMPLES_OF_RADIUS)
    count = int(np.ceil((s.margin * stem.radius_m + s.margin_m) / step))
    offsets = np.asarray(np.arange(-count, count + 1) * step, dtype=np.float64)
    if sides != BOTH_SIDES:
        offsets = offsets[sides[0] * offsets >= HALF_FROM * stem.radius_m]
    rows = max(int(np.ceil(2 * s.half_length_m / max(pixel_m, LEAST_ROW_M))), LEAST_ROWS)
    heights = np.linspace(-s.half_length_m, s.half_length_m, rows)
    widened = offsets[None] * (1.0 + stem.taper * heights[:, None] / stem.radius_m)
    points = stem.breast + heights[:, None, None] * stem.along + widened[:, :, None] * right
    pixels, _ = project(points, camera)
    size = np.array(image.shape[1::-1])
    inside = np.all((pixels >= 0) & (pixels <= size - 1), axis=2)
    whole = np.all(inside, axis=1)
    if whole.mean() < LEAST_INSIDE:
        return None
    x, y = pixels[whole, :, 0].astype(np.float32), pixels[whole, :, 1].astype(np.float32)
    return Strip(
        photo=index,
        image=np.asarray(cv2.remap(image, x, y, cv2.INTER_LINEAR), dtype=np.float32),
        heights_m=heights[whole],
        offsets_m=offsets,
        right=right,
        towards=towards,
        distance_m=distance,
        pixel_m=pixel_m,
        sides=sides,
    )


def _candidates(strip: Strip, stem: StemAxis, s: EdgeSettings) -> tuple[Floats, Floats]:
    """Of every edge of a strip its offset, and a row of support, angle, strength, side, height, pixel, photo, band."""
    step = strip.offsets_m[1] - strip.offsets_m[0]
    samples_per_px = strip.pixel_m / step
    light = strip.image
    if s.light_power != 1.0:  # a power of every sample is dear
        light = WHITE * (light / WHITE) ** np.float32(s.light_power)
    gradient = samples_per_px * gaussian_filter1d(light, s.blur_px * samples_per_px, axis=1, order=1, mode="nearest")
    band = np.floor((strip.heights_m + s.half_length_m) / s.band_m).astype(np.int64)
    means, heights = [], []
    for number in np.unique(band):
        means.append(gradient[band == number].mean(axis=0))
        heights.append(strip.heights_m[band == number].mean())
    strengths = _whitened(np.array(means), np.abs(strip.offsets_m) <= s.inner * stem.radius_m, s)
    rows, offsets = [], []
    for number, (e, height) in enumerate(zip(strengths, heights, strict=True)):
        peak = np.flatnonzero((e[1:-1] >= e[:-2]) & (e[1:-1] > e[2:]) & (e[1:-1] >= s.min_strength)) + 1
        bend = np.minimum(e[peak - 1] - 2 * e[peak] + e[peak + 1], -1e-9)
        place = strip.offsets_m[peak] + step * np.clip(0.5 * (e[peak - 1] - e[peak + 1]) / bend, -0.5, 0.5)
        place *= 1.0 + stem.taper * height / stem.radius_m
        side = np.where(place > 0, 1.0, -1.0)
        slant = np.hypot(strip.distance_m, place)
        angle = normal_angles(strip, stem, place, side)
        support = strip.distance_m * np.abs(place) / slant
        fixed = np.array([height, strip.pixel_m, strip.photo, number])
        of_all = np.broadcast_to(fixed, (len(peak), 4))
        rows.append(np.column_stack([support, angle, np.minimum(e[peak], s.clip), side, of_all]))
        offsets.append(place)
    return np.concatenate(offsets), np.vstack(rows)


def normal_angles(strip: Strip, stem: StemAxis, offsets_m: Floats, side: Floats | float) -> Floats:
    """Outward normal's angle (N,) where the rays at ``offsets_m`` (N,) graze the stem on ``side`` (+1 or -1)."""
    first, second = stem.across
    across = np.broadcast_to(side * strip.distance_m, np.shape(offsets_m))
    normal = across[:, None] * strip.right + np.abs(offsets_m)[:, None] * strip.towards
    return np.asarray(np.arctan2(normal @ second, normal @ first))


def _whitened(gradients: Floats, inner: NDArray[np.bool_], s: EdgeSettings) -> Floats:
    """Strengths (B, W) of colour gradients (B, W, 3) in standard deviations of those on the bark itself.

    Bark is uneven in brightness more than in colour: what differs in colour is rather another thing.
    """
    bark = gradients[:, inner].reshape(-1, 3)
    covariance = bark.T @ bark / len(bark) + s.floor**2 * np.eye(3)
    lower = np.linalg.cholesky(covariance)
    white = np.linalg.solve(lower, gradients.reshape(-1, 3).T)
    return np.asarray(np.linalg.norm(white, axis=0).reshape(gradients.shape[:2]), dtype=np.float64)


def _edges(strips: list[Floats]) -> Edges:
    rows = np.vstack(strips) if strips else np.zeros((0, 9))
    # Photograph, side and band
    ray = np.unique(rows[:, [6, 3, 7]], axis=0, return_inverse=True)[1] if len(rows) else np.zeros(0)
    return Edges(
        support_m=rows[:, 0],
        angle_rad=rows[:, 1],
        strength=rows[:, 2],
        height_m=rows[:, HEIGHT_COLUMN],
        pixel_m=rows[:, 5],
        photo=rows[:, 6].astype(np.int64),
        ray=np.asarray(ray, dtype=np.int64).reshape(-1),
        own=rows[:, 8] > 0,
    )
