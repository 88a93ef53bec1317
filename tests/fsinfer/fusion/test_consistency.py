"""Two views of one surface, whose disagreement is known in pixels and in metres, and what is made of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.depth.maps import DepthMap, DepthMaps, PixelGrid
from fsinfer.fusion.consistency import NO_LEVEL, PairEvidence, Tolerances, check_pair, check_pixel
from fsinfer.fusion.fuse import FusionSettings, find_neighbours, fuse, fuse_view
from fsinfer.io.pfm import read_pfm, write_pfm
from fsinfer.scene import Scene
from tests.fsinfer.fusion.test_fuse import HEIGHT, WIDTH, make_scene

FOCAL, SIZE, DEPTH = 140.0, 81, 2.0
MIDDLE = SIZE // 2
#: The tolerances of level i, as in D2HC-RMVSNet: i / 2 pixels and i times the step of depth.
HALF_PIXEL = 0.5


def depth_map(
    center: tuple[float, float, float], turn: NDArray[np.float64], depth: float | NDArray[np.float64]
) -> DepthMap:
    """A map of SIZE x SIZE pixels, principal point in the middle."""
    pose = np.eye(4)
    pose[:3, :3] = turn
    pose[:3, 3] = -turn @ np.array(center)
    inverse = 1 / np.broadcast_to(np.asarray(depth, np.float32), (SIZE, SIZE))
    return DepthMap(
        inverse_depth=np.ascontiguousarray(inverse, np.float32),
        confidence=np.ones((SIZE, SIZE), np.float32),
        intrinsic=np.array([[FOCAL, 0, MIDDLE], [0, FOCAL, MIDDLE], [0, 0, 1.0]]),
        cam_from_world=pose,
        grid=PixelGrid(step_x=1.0, step_y=1.0),
    )


def both(
    reference: DepthMap, source: DepthMap, *, depth: float = DEPTH, u: float = MIDDLE, min_confidence: float = 0.5
) -> tuple[PairEvidence, int]:
    """The evidence on one pixel in the middle row, and the level that the plain form finds."""
    arrays = (np.array([value], np.float32) for value in (u, MIDDLE, depth))
    tolerances = Tolerances()
    found = check_pair(reference, source, *arrays, tolerances=tolerances, min_confidence=min_confidence)
    plain, _ = check_pixel(reference, source, u, MIDDLE, depth, tolerances=tolerances)
    return found, plain


FACING = np.eye(3)
#: Looks along -x: what it has in front, the reference has to its side.
FROM_THE_SIDE = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])


@pytest.mark.parametrize("pixels", [0.2, 0.8, 1.3, 2.7, 4.9, 5.2, 9.0])
def test_a_view_from_the_side_is_judged_by_where_its_point_falls(pixels: float) -> None:
    # A depth error of a view at right angles moves the point across the ray: same depth, another pixel.
    away = DEPTH + pixels * DEPTH / FOCAL
    found, plain = both(depth_map((0, 0, 0), FACING, DEPTH), depth_map((DEPTH, 0, DEPTH), FROM_THE_SIDE, away))
    assert found.depth[0] == pytest.approx(DEPTH, rel=1e-4)
    expected = int(np.ceil(pixels / HALF_PIXEL)) if pixels < 5 else NO_LEVEL
    assert (int(found.level[0]), plain) == (expected, expected)


@pytest.mark.parametrize(
    ("baseline", "step"),
    [
        (0.1, 4e-3),  # a narrow pair tells little, but never less than this
        (0.4, 0.06 * DEPTH / (FOCAL * 0.4)),  # 0.06 px of disparity
        (1.0, 1e-3),
    ],
)
@pytest.mark.parametrize("share", [0.6, 2.4, 7.5, 9.7, 10.4])
@pytest.mark.parametrize("sign", [-1, 1])
def test_a_view_beside_is_judged_by_its_depth(baseline: float, step: float, share: float, sign: int) -> None:
    off = DEPTH * (1 + sign * share * step)
    source = depth_map((baseline, 0, 0), FACING, off)
    # At a pixel whose partner is in the picture too.
    found, plain = both(depth_map((0, 0, 0), FACING, DEPTH), source, u=MIDDLE + FOCAL * baseline / DEPTH / 2)
    assert found.depth[0] == pytest.approx(off, rel=1e-5)
    expected = int(np.ceil(share)) if share < 10 else NO_LEVEL
    assert (int(found.level[0]), plain) == (expected, expected)


def test_what_a_view_does_not_show_or_is_not_sure_of_it_says_nothing_about() -> None:
    reference = depth_map((0, 0, 0), FACING, DEPTH)
    source = depth_map((0.3, 0, 0), FACING, DEPTH)
    holes = source.inverse_depth.copy()
    holes[:, : MIDDLE - 10] = 0
    unsure = source.confidence.copy()
    unsure[:] = 0.45
    silent = {
        "outside": both(reference, depth_map((3.0, 0, 0), FACING, DEPTH)),
        "behind": both(reference, depth_map((0, 0, 2.5), FACING, DEPTH)),
        "no depth": both(reference, replace(source, inverse_depth=holes)),
        "facing away": both(reference, depth_map((0, 0, -3.0), np.diag([-1.0, 1, -1]), DEPTH)),
    }
    for name, (found, plain) in silent.items():
        told = (int(found.level[0]), plain, float(found.depth[0]), float(found.confidence[0]))
        assert told == (NO_LEVEL, NO_LEVEL, 0.0, 0.0), name
        assert not found.seen_through[0], name
    found, _ = both(reference, replace(source, confidence=unsure))
    assert (int(found.level[0]), float(found.confidence[0])) == (NO_LEVEL, 0.0)
    found, _ = both(reference, replace(source, confidence=unsure), min_confidence=0.4)
    assert int(found.level[0]) == 1
    assert float(found.confidence[0]) == pytest.approx(0.45)


def test_between_two_surfaces_the_nearer_pixel_counts_and_on_one_the_mixture() -> None:
    reference = depth_map((0, 0, 0), FACING, DEPTH)
    # The partner lies at column MIDDLE - 21 + 0.3.
    baseline = 20.7 * DEPTH / FOCAL
    columns = np.arange(SIZE)
    for behind, expected in ((2 * DEPTH, DEPTH), (DEPTH * 1.006, 1 / (0.7 / DEPTH + 0.3 / (DEPTH * 1.006)))):
        surface = np.where(columns <= MIDDLE - 21, DEPTH, behind)
        found, _ = both(reference, depth_map((baseline, 0, 0), FACING, np.tile(surface, (SIZE, 1))))
        assert found.depth[0] == pytest.approx(expected, rel=2e-5)


@pytest.mark.parametrize(("share", "through"), [(1.03, False), (1.055, False), (1.065, True), (3.0, True)])
def test_a_point_is_seen_through_where_all_around_lies_clearly_behind(share: float, through: bool) -> None:
    reference = depth_map((0, 0, 0), FACING, DEPTH)
    source = depth_map((0.1, 0, 0), FACING, DEPTH * share)
    # Level 10 of a step of 0.4 %, and half as much again: 6 %.
    assert bool(both(reference, source)[0].seen_through[0]) is through
    column = round(MIDDLE - FOCAL * 0.1 / DEPTH)
    for row, beside in ((MIDDLE - 1, column + 1), (MIDDLE + 1, column), (MIDDLE, column)):
        for value in (1 / DEPTH, 0.0):  # one pixel at the point itself, or one without depth, is enough to doubt it
            spoilt = source.inverse_depth.copy()
            spoilt[row, beside] = value
            assert not both(reference, replace(source, inverse_depth=spoilt))[0].seen_through[0]
    unsure = np.full_like(source.confidence, 0.4)
    assert not both(reference, replace(source, confidence=unsure))[0].seen_through[0]


@pytest.mark.parametrize("unit", [0.05, 1.0, 300.0])
def test_the_unit_of_the_scene_does_not_matter(unit: float) -> None:
    source = depth_map((0.4 * unit, 0.0, 0.1 * unit), FACING, 1.9 * unit * 1.004)
    found, plain = both(depth_map((0, 0, 0), FACING, DEPTH * unit), source, depth=DEPTH * unit, u=MIDDLE + 12)
    assert found.depth[0] == pytest.approx(DEPTH * unit, rel=0.01)
    assert (int(found.level[0]), plain) == (2, 2)


@pytest.mark.parametrize("column", [0.0, 0.5, SIZE - 1.5, SIZE - 1.0])
def test_the_last_pixels_of_a_view_still_count(column: float) -> None:
    baseline = 0.2
    u = column + FOCAL * baseline / DEPTH
    reference = depth_map((0, 0, 0), FACING, DEPTH)
    found, plain = both(reference, depth_map((baseline, 0, 0), FACING, DEPTH), u=u)
    assert (int(found.level[0]), plain) == (1, 1)
    for beyond in (-1.0, SIZE + 0.0):
        found, plain = both(reference, depth_map((baseline, 0, 0), FACING, DEPTH), u=beyond + FOCAL * baseline / DEPTH)
        assert (int(found.level[0]), plain) == (NO_LEVEL, NO_LEVEL)


BALL, BALL_RADIUS = np.array([0.9, 0.5, 0.4]), 0.15


def add_ball(scene: Scene, folder: Path, shown_in: list[int]) -> Scene:
    """A ball in the air that some depth maps show and the others look through; all views ask all others."""
    for index in shown_in:
        camera = scene.views[index].camera
        intrinsic = np.diag([0.5, 0.5, 1]) @ camera.intrinsic
        u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
        rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(intrinsic).T @ camera.cam_from_world[:3, :3]
        offset = camera.center - BALL
        a, b = (rays**2).sum(-1), (rays * offset).sum(-1)
        inside = b * b - a * (offset @ offset - BALL_RADIUS**2)
        near = np.where(inside > 0, (-b - np.sqrt(np.maximum(inside, 0))) / a, np.inf)
        path = folder / "depth" / f"{index:03d}.pfm"
        depth = read_pfm(path)
        write_pfm(path, np.minimum(np.where(depth > 0, depth, np.inf), near).astype(np.float32))
    others = [tuple(j for j in range(len(scene.views)) if j != i) for i in range(len(scene.views))]
    return replace(
        scene, views=tuple(replace(view, sources=those) for view, those in zip(scene.views, others, strict=True))
    )


def ball_points(scene: Scene, folder: Path, settings: FusionSettings) -> int:
    distance = np.linalg.norm(fuse(scene, folder, settings=settings).xyz - BALL, axis=1)
    return int((distance < 1.2 * BALL_RADIUS).sum())


def test_what_most_views_look_through_goes_though_some_agree_on_it(tmp_path: Path) -> None:
    scene = add_ball(make_scene(tmp_path / "scene", tmp_path), tmp_path, [0, 1, 2])
    few = FusionSettings(max_sources=11)
    kept, believed = (ball_points(scene, tmp_path, replace(few, min_seen_through=least)) for least in (2, 99))
    assert believed > 100
    assert kept < 0.1 * believed


def test_what_two_views_miss_stays_where_more_agree_on_it(tmp_path: Path) -> None:
    scene = add_ball(make_scene(tmp_path / "scene", tmp_path), tmp_path, [0, 1, 2, 10, 11])
    # View 3 and 9 look through; view 0 and its neighbours agree.
    near = {0, 1, 2, 10, 11, 3, 9}
    views = tuple(
        replace(view, sources=tuple(s for s in view.sources if s in near) if i in near else ())
        for i, view in enumerate(scene.views)
    )
    maps = DepthMaps(replace(scene, views=views), tmp_path)
    neighbours = find_neighbours(maps.scene, maps.available, 12)[0]
    settings = FusionSettings(max_sources=11)
    points = fuse_view(maps.scene, maps, 0, neighbours, min_confidence=0.5, settings=settings).xyz
    assert (np.linalg.norm(points - BALL, axis=1) < 1.2 * BALL_RADIUS).sum() > 100


def test_near_sure_and_often_seen_points_weigh_more(tmp_path: Path) -> None:
    def confidence(wrong: NDArray[np.bool_], rng: np.random.Generator) -> NDArray[np.float64]:
        return np.where(np.arange(wrong.shape[1]) % 40 < 20, 0.9, 0.6) * np.ones(wrong.shape)

    scene = make_scene(tmp_path / "scene", tmp_path, confidence=confidence)
    maps = DepthMaps(scene, tmp_path)
    neighbours = find_neighbours(scene, maps.available, 12)[0]
    found = fuse_view(scene, maps, 0, neighbours, min_confidence=0.5, settings=FusionSettings())
    depth = ((found.xyz - scene.views[0].camera.center) @ scene.views[0].camera.cam_from_world[2, :3]).astype(float)
    assert len(set(found.views.tolist())) > 1
    assert depth.max() > 1.5 * depth.min()
    # The inverse variance of a triangulated depth: its fourth power, the views, and how sure the network is.
    np.testing.assert_allclose(found.weight * depth**4 / (found.views * found.confidence), 1.0, rtol=1e-5)


def test_a_depth_is_the_mean_of_the_views_weighted_by_how_sure_they_are(tmp_path: Path) -> None:
    scene = make_scene(tmp_path / "scene", tmp_path, cameras=3)
    shares, sure = (1.0, 1.004, 0.998), (0.9, 0.5, 0.8)
    for index in range(3):
        path = tmp_path / "depth" / f"{index:03d}.pfm"
        write_pfm(path, read_pfm(path) * np.float32(shares[index]))
        write_pfm(tmp_path / "confidence" / path.name, np.full((HEIGHT, WIDTH), sure[index], np.float32))
    maps = DepthMaps(scene, tmp_path)
    settings = FusionSettings(tolerances=Tolerances(relative_depth_step=0.01, relative_depth_step_max=0.01))
    found = fuse_view(scene, maps, 0, (1, 2), min_confidence=0.4, settings=settings)
    ground = found.xyz[(found.views == 3) & (np.abs(found.xyz[:, 2]) < 0.05)]
    camera = scene.views[0].camera
    exact = -camera.center[2] / (ground - camera.center)[:, 2]  # of the ray to where it meets the plane z = 0
    # Each view's own ground lies deeper or higher by its share of its height above the plane: all look from one height.
    weights = np.array(sure)
    expected = float((weights * shares).sum() / weights.sum())
    assert np.median(1 / exact) == pytest.approx(expected, abs=4e-4)
