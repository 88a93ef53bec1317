"""Edges of stems in the photographs: strips across each stem about breast height, and where they end.

For every photograph that shows a stem unhidden (its depth map agrees), a strip is cut out along the stem's axis, in the
plane through the axis that faces the camera. In bands along the axis the colour gradient across it is averaged: a
stem's edge is straight and adds up, bark and leaves do not.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from fsinfer.depth.maps import DepthMap, DepthMaps, seen_and_hidden
from fsinfer.geometry.similarity import scale_of, scaling
from fsinfer.progress import Progress, silent
from fsinfer.scene import Camera, Scene, project, read_view_image
from fsinfer.threads import in_order, photo_threads
from fsinfer.trees.diameter.edge_problem import Edges

Floats = NDArray[np.float64]


#: Samples of a strip across the stem for each pixel, and for each radius at most; and least metres between its rows,
#: and their least number. Source: numerics.
SAMPLES_PER_PX, MOST_SAMPLES_OF_RADIUS, LEAST_ROW_M, LEAST_ROWS = 2.0, 60.0, 0.004, 8
#: Points of the near side by which it is told whether it is hidden: along the stem and across it, the latter up to
#: this share of the radius. Source: numerics.
SIDE_POINTS, SIDE_OF_RADIUS = (9, 5), 0.6
#: A camera nearer than this to a stem, in radii and metres, or of which it is less deep, sees it too slanted.
#: Source: numerics.
NEAREST_RADII, NEAREST_M, LEAST_DEPTH_M = 2.5, 0.5, 0.3
#: Both edges must lie inside the photograph with this much room, in radii and pixels, and above and below in pixels.
#: Source: not recorded.
ROOM_RADII, ROOM_PX, ROOM_ABOVE_PX = 1.3, 3.0, 5
#: Left and right of the axis. Source: convention.
BOTH_SIDES = (-1.0, 1.0)
#: Of a half that is looked at by itself: points across it, from and to this share of the radius, how far the depth map
#: may be off, in radii, and where its strip begins beside the axis. Source: judgement, what lies before the other half
#: ends at the axis at the nearest.
HALF_POINTS, HALF_RANGE, HALF_TOLERANCE, HALF_FROM = 6, (0.2, 0.9), 0.5, 0.15
#: The greatest grey value. Source: format.
WHITE = np.float32(255.0)
#: Share of its rows that must lie inside the photograph, or a strip is not used. Source: not recorded.
LEAST_INSIDE = 0.7


@dataclass(frozen=True, kw_only=True)
class EdgeSettings:
    """Constants of :func:`find_edges`; lengths in metres. "Two renders" are the open and the sloped plot.

    Attributes
    ----------
    light_power: edges are looked for in grey values, 0 to 1, to this power. Blur of lens and motion mixes light, which
        is their power of 2.2; making smaller, sharpening and tone mapping mix the values themselves. In the values a
        dark stem before a bright wood comes out too thin, in light too thick. Source: renders only, 1.5 makes stems of
        two plots without blur too thick; on undergrown ones with a phone's it made up for their ground, which was too
        high (docs/trials-accuracy.md).
    half_length_m: of the strip: long enough to average, short enough for a straight axis. Source: renders only, strips
        of 30 to 80 cm are all the same (docs/accuracy.md).
    band_m: in which gradients are averaged, a sixth of the strip. Source: renders only, two renders.
    margin: the strip reaches this many radii ... Source: renders only, two renders.
    margin_m: ... and this much to either side. Source: renders only, two renders.
    max_distance_m: beyond, a pixel of a phone is 2 cm. Source: renders only, a blind plot afterwards (955019): at 16 a
        stem of 24 cm that stands beside the path has no DBH, since the fifteen photographs of its other half were
        taken from 16.1 to 16.5 m.
    min_radius_px: of a stem in the photograph. Source: renders only, five plots (docs/trials-accuracy.md): at 3 a stem
        of 8 cm lacks its second pair of sides.
    blur_px: of the derivative. Source: renders only, two renders.
    clip: standard deviations of the bark, beyond which an edge is not surer. Source: renders only, two renders.
    inner: of the radius: surely bark. Source: renders only, two renders.
    floor: grey values per pixel that count as noise of the camera. Source: renders only, two renders.
    min_strength: of an edge, standard deviations of the bark. Source: renders only, two renders.
    min_seen: share of the near side at which the depth map shows the stem. Source: renders only, two renders.
    max_hidden: share behind something nearer. Source: renders only, two renders.
    half_seen: as ``min_seen``, of the half of the near side that belongs to an edge, where the photograph does not show
        both edges. Source: renders only, 74 stems of six plots (docs/trials-accuracy.md, "Sharp faces").
    tolerance_of_depth: of the depth map, share of the depth. Source: renders only, two renders.
    """

    light_power: float = 1.0
    half_length_m: float = 0.25
    band_m: float = 0.0834
    margin: float = 1.6
    margin_m: float = 0.04
    max_distance_m: float = 20.0
    min_radius_px: float = 2.5
    blur_px: float = 1.2
    clip: float = 20.0
    inner: float = 0.7
    floor: float = 0.5
    min_strength: float = 1.2
    min_seen: float = 0.5
    max_hidden: float = 0.2
    half_seen: float = 0.6
    tolerance_of_depth: float = 0.05


@dataclass(frozen=True, kw_only=True)
class StemAxis:
    """A stem about breast height in the frame of the cloud, metres.

    ``breast`` (3,) lies on the axis, ``along`` (3,) is its unit vector upwards, ``radius_m`` and ``taper`` (dr/dh) are
    what is known of it so far.
    """

    breast: Floats
    along: Floats
    radius_m: float
    taper: float

    @property
    def across(self) -> tuple[Floats, Floats]:
        """Two unit vectors (3,) across the axis; edges' angles are counted from the first to the second.

        The first is the leaning x axis, as in :func:`fsinfer.trees.cylinder.axis.axis_coordinates`.
        """
        first = np.array([1.0, 0.0, 0.0]) - self.along[0] * self.along
        first /= np.linalg.norm(first)
        return first, np.cross(self.along, first)


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
    (:func:`fsinfer.trees.diameter.edge_problem.two_sided`).

    ``cloud_from_scene`` (4, 4) is the similarity that made the cloud of the scene. ``on_strip`` is given every strip
    with its stem's number, for those who want to look at them. Raises :class:`~fsinfer.errors.FsinferError` where a
    photograph or a depth map cannot be read.
    """
    s = settings or EdgeSettings()
    found: list[list[Floats]] = [[] for _ in stems]

    def look(index: int) -> list[tuple[int, Strip, Floats]]:
        strips = strips_of_photo(stems, index, scene, maps, cloud_from_scene, settings=s)
        return [(number, strip, _candidates(strip, stems[number], s)) for number, strip in strips]

    progress(0, len(maps.available), "edges of stems")
    for done, seen in enumerate(in_order(look, maps.available, photo_threads()), 1):
        for number, strip, candidates in seen:
            found[number].append(candidates)
            if on_strip is not None:
                on_strip(number, strip)
        progress(done, len(maps.available), "edges of stems")
    return [_edges(rows) for rows in found]


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
    near = [(n, stem) for n, stem in enumerate(stems) if _in_reach(stem, camera, s)]
    if not near:
        return []
    depth_map = maps.get(index)
    rows, columns = depth_map.inverse_depth.shape
    size = np.array([columns * depth_map.grid.step_x, rows * depth_map.grid.step_y])
    seen = [(n, stem, sides) for n, stem in near if (sides := _sides(stem, camera, size, depth_map, metres, s))]
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


def _facing(stem: StemAxis, camera: Camera) -> tuple[Floats, Floats, float]:
    """Unit vectors (3,) across the axis, to the camera's right and towards it, and the camera's distance."""
    offset = camera.center - stem.breast
    level = offset - (offset @ stem.along) * stem.along
    distance = float(np.linalg.norm(level))
    towards = level / max(distance, 1e-9)
    return np.cross(stem.along, towards), towards, distance


def _in_reach(stem: StemAxis, camera: Camera, s: EdgeSettings) -> bool:
    _, _, distance = _facing(stem, camera)
    depth = float(project(stem.breast, camera)[1])
    nearest = max(NEAREST_RADII * stem.radius_m, NEAREST_M)
    if not nearest <= distance <= s.max_distance_m or depth < LEAST_DEPTH_M:
        return False
    return float(camera.intrinsic[0, 0]) * stem.radius_m / depth >= s.min_radius_px


def _sides(
    stem: StemAxis, camera: Camera, size: Floats, depth_map: DepthMap, metres: float, s: EdgeSettings
) -> tuple[float, ...]:
    """The sides of the stem whose edges the photograph shows: both, one, or none.

    Where both halves are seen and the stem is not, something stands before its middle.
    """
    if _inside(stem, camera, size) and _unhidden(stem, camera, depth_map, metres, s):
        return BOTH_SIDES
    halves = tuple(side for side in BOTH_SIDES if _shows_half(side, stem, camera, size, depth_map, metres, s))
    return () if halves == BOTH_SIDES else halves


def _shows_half(
    side: float, stem: StemAxis, camera: Camera, size: Floats, depth_map: DepthMap, metres: float, s: EdgeSettings
) -> bool:
    """Whether one edge lies well inside the photograph, and the depth map shows the half of the near side before it."""
    right, _, _ = _facing(stem, camera)
    height = np.linspace(-s.half_length_m, s.half_length_m, SIDE_POINTS[0])[:, None]
    edge = stem.breast + height * stem.along + ROOM_RADII * side * stem.radius_m * right
    pixel, depth = project(edge, camera)
    room = ROOM_ABOVE_PX
    if not (np.all(depth > LEAST_DEPTH_M) and np.all((pixel >= room) & (pixel <= size - room))):
        return False
    across = side * np.linspace(*HALF_RANGE, HALF_POINTS)
    seen, hidden = _seen_and_hidden(across, HALF_TOLERANCE * stem.radius_m, stem, camera, depth_map, metres, s)
    return seen >= s.half_seen and hidden <= s.max_hidden


def _inside(stem: StemAxis, camera: Camera, size: Floats) -> bool:
    """Whether both edges at breast height lie well inside the photograph of ``size`` (2,)."""
    pixel, depth = project(stem.breast, camera)
    reach = ROOM_RADII * float(camera.intrinsic[0, 0]) * stem.radius_m / float(depth) + ROOM_PX
    room = np.array([reach, ROOM_ABOVE_PX])
    return bool(np.all((pixel >= room) & (pixel <= size - room)))


def _unhidden(stem: StemAxis, camera: Camera, depth_map: DepthMap, metres: float, s: EdgeSettings) -> bool:
    """Whether the depth map shows the near side of the stem where it is, and little before it."""
    across = np.linspace(-SIDE_OF_RADIUS, SIDE_OF_RADIUS, SIDE_POINTS[1])
    seen, hidden = _seen_and_hidden(across, stem.radius_m, stem, camera, depth_map, metres, s)
    return seen >= s.min_seen and hidden <= s.max_hidden


def _seen_and_hidden(
    across: Floats,
    tolerance_m: float,
    stem: StemAxis,
    camera: Camera,
    depth_map: DepthMap,
    metres: float,
    s: EdgeSettings,
) -> tuple[float, float]:
    """Shares of the near side that the depth map shows where it is, and that something nearer hides.

    Looked at are points ``across`` the stem (shares of the radius, to the right) along the strip's length.
    """
    right, towards, _ = _facing(stem, camera)
    height, side = np.meshgrid(np.linspace(-s.half_length_m, s.half_length_m, SIDE_POINTS[0]), across)
    height, side = height.reshape(-1, 1), side.reshape(-1, 1)
    surface = stem.radius_m * (side * right + np.sqrt(1.0 - side**2) * towards)
    points = stem.breast + height * stem.along + surface
    tolerance = np.maximum(tolerance_m, s.tolerance_of_depth * project(points, camera)[1])
    return seen_and_hidden(points, tolerance, camera, depth_map, units_per_scene_unit=metres)


def _cut(
    stem: StemAxis, camera: Camera, image: NDArray[np.float32], index: int, s: EdgeSettings, sides: tuple[float, ...]
) -> Strip | None:
    right, towards, distance = _facing(stem, camera)
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


def _candidates(strip: Strip, stem: StemAxis, s: EdgeSettings) -> Floats:
    """Rows of support, angle, strength, side, height, pixel, photo and band for every edge of a strip."""
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
    rows = []
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
    return np.vstack(rows)


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
    rows = np.vstack(strips) if strips else np.zeros((0, 8))
    # Photograph, side and band
    ray = np.unique(rows[:, [6, 3, 7]], axis=0, return_inverse=True)[1] if len(rows) else np.zeros(0)
    return Edges(
        support_m=rows[:, 0],
        angle_rad=rows[:, 1],
        strength=rows[:, 2],
        height_m=rows[:, 4],
        pixel_m=rows[:, 5],
        photo=rows[:, 6].astype(np.int64),
        ray=np.asarray(ray, dtype=np.int64).reshape(-1),
    )
