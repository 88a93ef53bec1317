"""Edges of a stem in photographs: where a ray grazes it, by geometry."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from fsinfer.depth.maps import DepthMaps, seen_and_hidden
from fsinfer.io.images import read_image, write_image
from fsinfer.io.pfm import read_pfm, write_pfm
from fsinfer.scene import Camera, Scene, read_scene, write_camera, write_pairs
from fsinfer.silhouettes.edge_settings import EdgeSettings
from fsinfer.silhouettes.edges import Strip, find_edges, normal_angles, strips_of_photo
from fsinfer.silhouettes.stem_axis import StemAxis
from fsinfer.trees.diameter.edge_set import two_sided

WIDTH, HEIGHT, FOCAL, RADIUS, DISTANCE_M = 300, 200, 400.0, 0.15, 1.2
STEM = StemAxis(breast=np.array([0.0, 0.0, 1.3]), along=np.array([0.0, 0.0, 1.0]), radius_m=0.16, taper=0.0)


def looking_at_the_axis(angle: float) -> Camera:
    """A level camera 1.2 m from the stem at breast height."""
    toward = -np.array([np.cos(angle), np.sin(angle), 0.0])
    down = np.array([0.0, 0.0, -1.0])
    pose = np.eye(4)
    pose[:3, :3] = [np.cross(down, toward), down, toward]
    pose[:3, 3] = -pose[:3, :3] @ (np.array([0.0, 0.0, 1.3]) - DISTANCE_M * toward)
    intrinsic = np.array([[FOCAL, 0, 149.5], [0, FOCAL, 99.5], [0, 0, 1]])
    return Camera(intrinsic=intrinsic, cam_from_world=pose, depth_min=0.5, depth_max=50.0)


def write_plot(folder: Path, *, screen: float = 0.0, units_per_m: float = 1.0, step: int = 1) -> Scene:
    """Two photographs, a quarter turn apart, of a brown stem before green; ``screen``: share of rows hidden.

    ``step``: pixels of the photograph from one pixel of the depth map to the next.
    """
    fine = (np.arange(WIDTH * 8) + 0.5) / 8 - 0.5
    half_px = FOCAL * np.tan(np.arcsin(RADIUS / DISTANCE_M))
    row = np.where((np.abs(fine - 149.5) <= half_px)[:, None], [110.0, 80.0, 60.0], [70.0, 130.0, 60.0])
    row = row.reshape(WIDTH, 8, 3).mean(axis=1)
    grain = np.random.default_rng(0).normal(0, 2, (HEIGHT, WIDTH, 1))
    depth = np.where(np.abs(np.arange(WIDTH) - 149.5) < half_px, DISTANCE_M - RADIUS, 30.0)
    for index in range(2):
        seen = looking_at_the_axis(0.3 + np.pi / 2 * index)
        pose = seen.cam_from_world.copy()
        pose[:3, 3] *= units_per_m
        camera = Camera(intrinsic=seen.intrinsic, cam_from_world=pose, depth_min=0.1, depth_max=100.0)
        write_image(folder / "images" / f"p{index}.png", (row[None] + grain).clip(0, 255).astype(np.uint8))
        write_camera(folder / "cams" / f"p{index}_cam.txt", camera)
        maps = np.broadcast_to(units_per_m * depth, (HEIGHT, WIDTH)).astype(np.float32)
        maps[: round(screen * HEIGHT)] = units_per_m * 0.6
        maps = maps[::step, ::step]
        write_pfm(folder / "depth" / f"p{index}.pfm", maps)
        write_pfm(folder / "confidence" / f"p{index}.pfm", np.ones_like(maps))
    (folder / "depth" / "depth.json").write_text(json.dumps({"pixel_step_x": step, "pixel_step_y": step}))
    write_pairs(folder / "pair.txt", {0: [(1, 1.0)], 1: [(0, 1.0)]})
    return read_scene(folder)


@pytest.mark.parametrize(("units_per_m", "step"), [(1.0, 1), (0.25, 1), (1.0, 2)])
def test_the_strongest_edges_are_where_rays_graze_the_stem(tmp_path: Path, units_per_m: float, step: int) -> None:
    scene = write_plot(tmp_path, units_per_m=units_per_m, step=step)
    metres = np.diag([1 / units_per_m] * 3 + [1.0])
    strips: list[tuple[int, Strip]] = []
    (edges,) = find_edges(
        [STEM], scene, DepthMaps(scene, tmp_path), metres, on_strip=lambda n, strip: strips.append((n, strip))
    )
    assert [(number, strip.photo) for number, strip in strips] == [(0, 0), (0, 1)]
    for _, strip in strips:
        assert strip.distance_m == pytest.approx(DISTANCE_M)
        assert strip.pixel_m == pytest.approx(DISTANCE_M / FOCAL)
    best = [np.flatnonzero(edges.ray == ray)[np.argmax(edges.strength[edges.ray == ray])] for ray in set(edges.ray)]
    assert len(best) == 2 * 2 * 6  # photographs, sides, bands
    assert len(edges.strength) == len(best)  # the grain of bark and background is no edge
    # A pixel is 3 mm here; the place where the ray crosses the strip is 1.2 mm farther out than the stem reaches.
    np.testing.assert_allclose(edges.support_m[best], RADIUS, atol=0.0007)
    # The normal of a grazed edge is square to the ray: by the half angle under which the stem is seen less than 90
    # degrees away from the direction to the camera.
    spread = np.pi / 2 - np.arcsin(RADIUS / DISTANCE_M)
    for photo, towards in ((0, 0.3), (1, 0.3 + np.pi / 2)):
        own = [b for b in best if edges.photo[b] == photo]
        away = np.angle(np.exp(1j * (edges.angle_rad[own] - towards)))
        assert (away > 0).sum() == (away < 0).sum()
        np.testing.assert_allclose(np.abs(away), spread, atol=0.001)


def test_a_blur_of_light_moves_edges_into_a_dark_stem_where_grey_values_are_looked_at(tmp_path: Path) -> None:
    """A lens blurs light; in the photograph's grey values the middle of the edge lies on the dark side."""
    scene = write_plot(tmp_path)
    fine = (np.arange(WIDTH * 8) + 0.5) / 8 - 0.5
    half_px = FOCAL * np.tan(np.arcsin(RADIUS / DISTANCE_M))
    light = np.where(np.abs(fine - 149.5) <= half_px, 40.0, 200.0) ** 2.2
    light = gaussian_filter1d(light, 8 * 1.5, mode="nearest").reshape(WIDTH, 8).mean(axis=1)
    row = np.repeat(light[:, None] ** (1 / 2.2), 3, axis=1)
    for index in range(2):
        write_image(tmp_path / "images" / f"p{index}.png", np.rint(np.tile(row, (HEIGHT, 1, 1))).astype(np.uint8))
    reach = {}
    for power in (1.0, 1.5, 2.2):
        settings = EdgeSettings(light_power=power)
        (edges,) = find_edges([STEM], scene, DepthMaps(scene, tmp_path), np.eye(4), settings=settings)
        reach[power] = float(np.median(edges.support_m)) - RADIUS
    pixel = DISTANCE_M / FOCAL
    assert reach[2.2] == pytest.approx(0.0, abs=0.07 * pixel)
    assert reach[1.0] < -0.3 * pixel
    assert reach[1.0] < reach[1.5] < reach[2.2]


@pytest.mark.parametrize(("screen", "seen"), [(0.1, True), (0.4, False), (1.0, False)])
def test_a_stem_behind_something_nearer_gives_no_edges(tmp_path: Path, screen: float, seen: bool) -> None:
    scene = write_plot(tmp_path, screen=screen)
    (edges,) = find_edges([STEM], scene, DepthMaps(scene, tmp_path), np.eye(4))
    assert (len(edges.support_m) > 0) == seen


def put(folder: Path, columns: NDArray[np.bool_], colour: tuple[int, int, int], depth_m: float) -> None:
    """Something of one colour and depth into the columns of the first photograph and its depth map."""
    photo, depth = folder / "images" / "p0.png", folder / "depth" / "p0.pfm"
    image, found = read_image(photo), read_pfm(depth).copy()
    image[:, columns], found[:, columns] = colour, depth_m
    write_image(photo, image)
    write_pfm(depth, found)


def strongest_beyond(scene: Scene, folder: Path, photo: int, side: float = 1.0) -> list[tuple[float, bool]]:
    """Of one photograph where the strong edges right of the axis lie across it, and whether each may be the stem's.

    Those left of it where ``side`` is -1.
    """
    (edges,) = find_edges([STEM], scene, DepthMaps(scene, folder), np.eye(4))
    right = (edges.photo == photo) & (side * np.cos(edges.angle_rad - (0.3 + np.pi / 2)) > 0.0) & (edges.strength > 15)
    return sorted(
        {(round(float(s), 2), bool(own)) for s, own in zip(edges.support_m[right], edges.own[right], strict=True)}
    )


@pytest.mark.parametrize(
    ("depth_m", "own"),
    [
        (2.4, [(0.15, True), (0.26, False)]),  # a stem of the same colour behind it
        (1.1, [(0.15, True), (0.26, True)]),  # the bark goes on
    ],
)
def test_the_far_edge_of_what_stands_behind_is_not_the_stems(
    tmp_path: Path, depth_m: float, own: list[tuple[float, bool]]
) -> None:
    scene = write_plot(tmp_path)
    column = np.arange(WIDTH) - 149.5
    half_px = FOCAL * np.tan(np.arcsin(RADIUS / DISTANCE_M))
    behind = (column > half_px) & (column <= FOCAL * np.tan(np.arcsin(0.26 / DISTANCE_M)))
    put(tmp_path, behind, (140, 40, 90), depth_m)
    assert strongest_beyond(scene, tmp_path, 0) == own


# The near side of the stem is 1.04 m away: half a radius nearer may be bark and the map's own error.
@pytest.mark.parametrize(("depth_m", "own"), [(0.6, False), (0.93, False), (1.0, True), (1.05, True), (30.0, True)])
@pytest.mark.parametrize("side", [1.0, -1.0], ids=["right", "left"])
def test_the_edge_of_what_stands_before_is_not_the_stems(
    tmp_path: Path, depth_m: float, own: bool, side: float
) -> None:
    scene = write_plot(tmp_path)
    column = side * (np.arange(WIDTH) - 149.5)
    before = (column > FOCAL * np.tan(np.arcsin(0.12 / DISTANCE_M))) & (column < 90)
    put(tmp_path, before, (60, 140, 50), depth_m)
    assert strongest_beyond(scene, tmp_path, 0, side) == [(0.12, own)]


def test_each_height_of_the_stem_is_asked_whether_something_stands_before_it(tmp_path: Path) -> None:
    scene = write_plot(tmp_path)
    column = np.arange(WIDTH) - 149.5
    before = (column > FOCAL * np.tan(np.arcsin(0.12 / DISTANCE_M))) & (column < 90)
    put(tmp_path, before, (60, 140, 50), 0.6)
    found = read_pfm(tmp_path / "depth" / "p0.pfm").copy()
    found[HEIGHT // 2 :, before] = 1.05  # a branch above breast height, and below it a stain on the bark
    write_pfm(tmp_path / "depth" / "p0.pfm", found)
    (edges,) = find_edges([STEM], scene, DepthMaps(scene, tmp_path), np.eye(4))
    there = (edges.photo == 0) & np.isclose(edges.support_m, 0.12, atol=0.006) & (edges.strength > 15.0)
    assert (edges.height_m[there] > 0.0).any()
    assert (edges.own == (edges.height_m < 0.0))[there].all()


@pytest.mark.parametrize("reduced", [1, 4])
def test_a_depth_map_goes_on_by_pixels_of_the_picture_that_it_was_computed_from(tmp_path: Path, reduced: int) -> None:
    """Something stands before a thin stem; the map has the stem's depth on for two pixels of its picture."""
    radius, distance, focal = 0.15, 9.6, 400.0
    fine = 8 * reduced
    column = ((np.arange(WIDTH * fine) + 0.5) / fine - 0.5) - 149.5  # pixels of the picture
    half_px = focal * np.tan(np.arcsin(radius / distance))
    before = (column > 0.7 * half_px) & (column < 60)
    row = np.where((np.abs(column) <= half_px)[:, None], [110.0, 80.0, 60.0], [70.0, 130.0, 60.0])
    row[before] = [60.0, 60.0, 160.0]
    row = row.reshape(WIDTH * reduced, 8, 3).mean(axis=1)
    seen = looking_at_the_axis(0.3)
    pose = seen.cam_from_world.copy()
    pose[2, 3] += distance - DISTANCE_M
    of_photo = np.array([[reduced, 0, (reduced - 1) / 2], [0, reduced, (reduced - 1) / 2], [0, 0, 1]])
    camera = Camera(intrinsic=of_photo @ seen.intrinsic, cam_from_world=pose, depth_min=0.1, depth_max=100.0)
    grain = np.random.default_rng(0).normal(0, 2, (HEIGHT * reduced, WIDTH * reduced, 1))
    coarse = np.arange(WIDTH) - 149.5
    depth = np.where(np.abs(coarse) < half_px, distance - radius, 30.0)
    depth[(coarse > 0.7 * half_px) & (coarse < 60)] = 5.0
    depth[(coarse > 0.7 * half_px) & (coarse < 0.7 * half_px + 1.5)] = distance - radius
    for index in range(2):
        write_image(tmp_path / "images" / f"p{index}.png", (row[None] + grain).clip(0, 255).astype(np.uint8))
        write_camera(tmp_path / "cams" / f"p{index}_cam.txt", camera)
        maps = np.broadcast_to(depth, (HEIGHT, WIDTH)).astype(np.float32)
        write_pfm(tmp_path / "depth" / f"p{index}.pfm", maps)
    grid = {"pixel_step": reduced, "offset_x_px": (reduced - 1) / 2, "offset_y_px": (reduced - 1) / 2}
    (tmp_path / "depth" / "depth.json").write_text(json.dumps(grid))
    write_pairs(tmp_path / "pair.txt", {0: [(1, 1.0)], 1: [(0, 1.0)]})
    scene = read_scene(tmp_path)
    (edges,) = find_edges([replace(STEM, radius_m=radius)], scene, DepthMaps(scene, tmp_path), np.eye(4))
    of_other = np.isclose(edges.support_m, 0.7 * radius, atol=0.006) & (edges.strength > 2.5)
    assert of_other.any()
    assert not edges.own[of_other].any()


def test_a_half_that_the_depth_map_does_not_show_has_no_edge(tmp_path: Path) -> None:
    """One half hidden, and behind where the other should be the map has what lies far beyond."""
    scene = write_plot(tmp_path)
    depth = read_pfm(tmp_path / "depth" / "p0.pfm").copy()
    depth[:, 150:] = 0.6
    depth[:, :150] = 30.0
    write_pfm(tmp_path / "depth" / "p0.pfm", depth)
    assert strips_of_photo([STEM], 0, scene, DepthMaps(scene, tmp_path), np.eye(4)) == []


@pytest.mark.parametrize("hidden", [-1.0, 1.0, 0.0])
def test_where_one_half_is_hidden_the_edge_of_the_other_is_found(tmp_path: Path, hidden: float) -> None:
    """Something green a metre nearer stands before one half of the stem, or before its middle."""
    scene = write_plot(tmp_path)
    column = np.arange(WIDTH) - 149.5
    screen = np.abs(column - 8.25) < 11.25 if hidden == 0.0 else hidden * column > 5
    put(tmp_path, screen, (60, 140, 50), 0.6)
    maps = DepthMaps(scene, tmp_path)
    strips = strips_of_photo([STEM], 0, scene, maps, np.eye(4))
    if hidden == 0.0:
        assert strips == []
        return
    ((_, strip),) = strips
    assert strip.sides == (-hidden,)
    assert np.all(-hidden * strip.offsets_m > 0)
    (edges,) = find_edges([STEM], scene, maps, np.eye(4))
    np.testing.assert_array_equal(two_sided(edges), edges.photo == 1)
    own = edges.photo == 0
    assert len(np.unique(edges.ray[own])) == 6
    best = [
        np.flatnonzero(edges.ray == ray)[np.argmax(edges.strength[edges.ray == ray])] for ray in set(edges.ray[own])
    ]
    np.testing.assert_allclose(edges.support_m[best], RADIUS, atol=0.0007)


@pytest.mark.parametrize(
    ("cut_px", "screen", "sides"),
    [
        (75, 0.0, ()),
        (125, 0.0, (-1.0,)),
        (125, 0.2, ()),  # a fifth of that half is hidden
        (230, 0.0, (-1.0, 1.0)),
    ],
)
def test_of_a_stem_at_the_border_of_the_picture_the_edge_within_counts(
    tmp_path: Path, cut_px: int, screen: float, sides: tuple[float, ...]
) -> None:
    """The photograph ends so many pixels to the right of where the stem's left edge can be looked for."""
    scene = write_plot(tmp_path, screen=screen)
    width = min(cut_px + 30, WIDTH)
    image = read_image(tmp_path / "images" / "p0.png")[:, :width]
    write_image(tmp_path / "images" / "p0.png", image)
    for kind in ("depth", "confidence"):
        write_pfm(tmp_path / kind / "p0.pfm", read_pfm(tmp_path / kind / "p0.pfm")[:, :width].copy())
    strips = strips_of_photo([STEM], 0, scene, DepthMaps(scene, tmp_path), np.eye(4))
    assert [strip.sides for _, strip in strips] == ([sides] if sides else [])


@pytest.mark.parametrize(("nearest", "shown"), [(0.5, 0), (1.15, 1)])
def test_a_stem_nearer_than_the_nearest_plane_of_the_depth_map_is_looked_at(
    tmp_path: Path, nearest: float, shown: int
) -> None:
    """A stem of 51 cm a metre before the camera was the background for its depth map, and no photograph of it."""
    scene = write_plot(tmp_path)
    background = np.full((HEIGHT, WIDTH), 30.0, dtype=np.float32)
    write_pfm(tmp_path / "depth" / "p0.pfm", background)
    views = tuple(replace(view, camera=replace(view.camera, depth_min=nearest)) for view in scene.views)
    ranged = replace(scene, views=views)
    assert len(strips_of_photo([STEM], 0, ranged, DepthMaps(ranged, tmp_path), np.eye(4))) == shown
    # Only what is nearer still could hide it.
    write_pfm(tmp_path / "depth" / "p0.pfm", 0.0 * background + 0.6)
    assert strips_of_photo([STEM], 0, ranged, DepthMaps(ranged, tmp_path), np.eye(4)) == []


def test_a_stem_too_far_or_too_thin_in_the_photograph_is_left_out(tmp_path: Path) -> None:
    scene = write_plot(tmp_path)
    maps = DepthMaps(scene, tmp_path)
    radius_px = FOCAL * STEM.radius_m / DISTANCE_M
    for limits, seen in (
        (EdgeSettings(max_distance_m=DISTANCE_M + 0.01, min_radius_px=radius_px - 1), 1),
        (EdgeSettings(max_distance_m=DISTANCE_M - 0.01), 0),
        (EdgeSettings(min_radius_px=radius_px + 1), 0),
    ):
        assert len(strips_of_photo([STEM], 0, scene, maps, np.eye(4), settings=limits)) == seen


@pytest.mark.parametrize(("distance_m", "seen"), [(18.0, 1), (21.0, 0)])
def test_a_stem_is_looked_at_from_as_far_as_it_is_large_in_a_photograph(
    tmp_path: Path, distance_m: float, seen: int
) -> None:
    """Fifteen photographs from 16.1 to 16.5 m, 17 pixels wide, were left out of a stem that no others showed."""
    scene = write_plot(tmp_path)
    times = distance_m / DISTANCE_M
    cloud = np.diag([times, times, times, 1.0])
    stem = StemAxis(breast=times * STEM.breast, along=STEM.along, radius_m=times * STEM.radius_m, taper=0.0)
    assert len(strips_of_photo([stem], 0, scene, DepthMaps(scene, tmp_path), cloud)) == seen


def test_a_stem_that_is_not_there_or_beside_the_picture_is_left_out(tmp_path: Path) -> None:
    scene = write_plot(tmp_path)
    maps = DepthMaps(scene, tmp_path)
    for place in ([0.4, 0.0], [-4.0, -1.0], [0.0, 3.0]):
        other = StemAxis(breast=np.array([*place, 1.3]), along=STEM.along, radius_m=0.16, taper=0.0)
        assert strips_of_photo([other], 0, scene, maps, np.eye(4)) == []
    assert [number for number, _ in strips_of_photo([other, STEM], 0, scene, maps, np.eye(4))] == [1]


def test_what_is_beside_the_picture_is_not_seen_however_near(tmp_path: Path) -> None:
    scene = write_plot(tmp_path)
    camera = replace(scene.views[0].camera, depth_min=1.15)
    rays = np.linalg.inv(camera.intrinsic) @ np.array([[150, -40.0, 150], [100, 100.0, 100], [1, 1, 1]]) * [1, 1, 1.18]
    points = (rays.T - camera.cam_from_world[:3, 3]) @ camera.cam_from_world[:3, :3]
    background = DepthMaps(scene, tmp_path).get(0)
    background = replace(background, inverse_depth=np.full_like(background.inverse_depth, 1 / 30))
    # Of three points a metre away one is in the picture and nearer than any plane, one beside it, one on a plane.
    assert seen_and_hidden(points, np.full(3, 0.1), camera, background) == pytest.approx((1 / 3, 0.0))


@given(lean_x=st.floats(-0.4, 0.4), lean_y=st.floats(-0.4, 0.4))
def test_the_axes_across_a_stem_are_square_to_it_and_to_each_other(lean_x: float, lean_y: float) -> None:
    along = np.array([lean_x, lean_y, 1.0]) / np.sqrt(lean_x**2 + lean_y**2 + 1)
    first, second = StemAxis(breast=np.zeros(3), along=along, radius_m=0.1, taper=0.0).across
    np.testing.assert_allclose(
        np.stack([first, second, along]) @ np.stack([first, second, along]).T, np.eye(3), atol=1e-12
    )
    assert np.linalg.det(np.stack([first, second, along])) > 0
    assert first[1] == pytest.approx(-along[0] * along[1] / np.sqrt(1 - along[0] ** 2))


def test_angles_of_normals_count_from_the_first_axis_to_the_second() -> None:
    # Seen from +x the right-hand side is +y: the normal of a thin stem's right edge points there.
    strip = Strip(
        photo=0, image=np.zeros((1, 1, 3), np.float32), heights_m=np.zeros(1), offsets_m=np.zeros(1),
        right=np.array([0.0, 1.0, 0.0]), towards=np.array([1.0, 0.0, 0.0]), distance_m=2.0, pixel_m=0.01,
    )  # fmt: skip
    angles = normal_angles(strip, STEM, np.array([1e-9, -1e-9]), np.array([1.0, -1.0]))
    np.testing.assert_allclose(angles, [np.pi / 2, -np.pi / 2], atol=1e-6)
