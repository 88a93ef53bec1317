import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.depth.maps import DepthMaps
from fsinfer.errors import CloudError, SceneError
from fsinfer.fusion.consistency import LEVELS, Tolerances, check_pair, check_pixel
from fsinfer.fusion.fuse import FusionSettings, adapt_tolerances, find_neighbours, fuse, fuse_view, passing_level
from fsinfer.fusion.surfaces import pixel_normals, smooth_pixels
from fsinfer.io.pfm import read_pfm, write_pfm
from fsinfer.scene import Camera, Scene, read_scene, write_camera, write_pairs

RADIUS = 0.15
WIDTH, HEIGHT, FOCAL = 160, 120, 140.0
STEP = 2
GROUND_RGB, STEM_RGB = (90, 160, 40), (150, 90, 30)


def look_at(center: NDArray[np.float64], target: tuple[float, float, float]) -> NDArray[np.float64]:
    forward = np.asarray(target, float) - center
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = [right, np.cross(forward, right), forward]
    pose[:3, 3] = -pose[:3, :3] @ center
    return pose


def exact_depth(
    camera: Camera, width: int, height: int, intrinsic: NDArray[np.float64]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """z depth of a plane z = 0 and a cylinder of RADIUS round the z axis, 3 high; 0 = sky. And which it is."""
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(intrinsic).T @ camera.cam_from_world[:3, :3]
    c = camera.center
    with np.errstate(all="ignore"):
        plane = np.where(rays[..., 2] < -1e-9, -c[2] / rays[..., 2], np.inf)
        a = (rays[..., :2] ** 2).sum(-1)
        b = (rays[..., :2] * c[:2]).sum(-1)
        stem = (-b - np.sqrt(b * b - a * ((c[:2] ** 2).sum() - RADIUS**2))) / a
        z = c[2] + stem * rays[..., 2]
        stem = np.where(np.isfinite(stem) & (z > 0) & (z < 3), stem, np.inf)
    depth = np.minimum(plane, stem)
    return np.where(depth < 8, depth, 0).astype(np.float32), stem < plane


def make_scene(
    folder: Path,
    out: Path,
    *,
    noise: float = 0.0,
    outliers: float = 0.0,
    cameras: int = 12,
    offset: NDArray[np.float64] | tuple[float, float, float] = (0.0, 0.0, 0.0),
    seed: int = 0,
    confidence: Callable[[NDArray[np.bool_], np.random.Generator], NDArray[np.float64]] | None = None,
) -> Scene:
    """A ring of cameras round a stem; returns the scene. ``noise`` is relative, smooth over a few pixels."""
    rng = np.random.default_rng(seed)
    image_intrinsic = np.diag([STEP, STEP, 1.0]) @ [[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]]
    pairs = {}
    (folder / "images").mkdir(parents=True)
    (out / "depth").mkdir(parents=True)
    for i in range(cameras):
        angle = 2 * np.pi * i / 12
        center = np.array([2.5 * np.cos(angle), 2.5 * np.sin(angle), 1.4])
        camera = Camera(
            intrinsic=image_intrinsic, cam_from_world=look_at(center, (0, 0, 0.9)), depth_min=0.5, depth_max=9.0
        )
        depth, is_stem = exact_depth(camera, WIDTH, HEIGHT, np.diag([1 / STEP, 1 / STEP, 1]) @ image_intrinsic)
        image = np.where(is_stem[..., None], STEM_RGB, GROUND_RGB).astype(np.uint8)
        larger = cv2.resize(image, (WIDTH * STEP, HEIGHT * STEP), interpolation=cv2.INTER_NEAREST)
        cv2.imwrite(str(folder / "images" / f"{i:03d}.png"), larger[..., ::-1])
        smooth = cv2.GaussianBlur(rng.normal(size=depth.shape), (0, 0), 2)
        depth = depth * (1 + noise * smooth / smooth.std())
        # Outliers in blobs of a few pixels that look smooth inside, as those of a network do.
        blobs = cv2.GaussianBlur(rng.normal(size=depth.shape), (0, 0), 3)
        wrong = blobs > np.quantile(blobs, 1 - outliers)
        depth = np.where(wrong & (depth > 0), depth * rng.uniform(0.5, 0.9), depth)
        write_pfm(out / "depth" / f"{i:03d}.pfm", depth.astype(np.float32))
        sure = np.ones(depth.shape) if confidence is None else confidence(wrong, rng)
        write_pfm(out / "confidence" / f"{i:03d}.pfm", sure.astype(np.float32))
        pose = camera.cam_from_world.copy()
        pose[:3, 3] -= pose[:3, :3] @ offset
        write_camera(folder / "cams" / f"{i:03d}_cam.txt", replace(camera, cam_from_world=pose))
        near = [(i + d) % 12 for d in (1, -1, 2, -2)]
        pairs[i] = [(j, 1.0) for j in near if j < cameras]
    write_pairs(folder / "pair.txt", pairs)
    (out / "depth" / "depth.json").write_text(json.dumps({"pixel_step_x": STEP, "pixel_step_y": STEP}))
    return read_scene(folder)


def surface_distance(xyz: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Signed distance to the nearer of plane and stem, and which."""
    stem = np.hypot(xyz[:, 0], xyz[:, 1]) - RADIUS
    is_stem = np.abs(stem) < np.abs(xyz[:, 2])
    return np.where(is_stem, stem, xyz[:, 2]), is_stem


def test_clean_maps_give_the_surface_with_normals_and_colours(tmp_path: Path) -> None:
    scene = make_scene(tmp_path / "scene", tmp_path)
    steps = []
    cloud = fuse(scene, tmp_path, progress=lambda done, total, what: steps.append((done, total)))
    distance, is_stem = surface_distance(cloud.xyz)
    assert steps[-1] == (12, 12)
    assert np.percentile(np.abs(distance), 99) < 0.004
    assert abs(np.median(distance[is_stem])) < 0.001
    expected = np.where(is_stem[:, None], cloud.xyz * [1, 1, 0] / RADIUS, [0, 0, 1.0])
    clear = (np.abs(cloud.xyz[:, 2]) > 0.1) | ~is_stem
    cosine = (cloud.normals * expected).sum(axis=1)[clear]
    assert np.mean(cosine > 0.97) > 0.9
    far = np.abs(cloud.xyz[:, 2]) > 0.15
    # Colours mix over one depth pixel at the silhouettes; the stem is 17 depth pixels wide.
    assert cloud.rgb is not None
    assert np.mean(np.all(cloud.rgb[far & is_stem] == STEM_RGB, axis=1)) > 0.7
    assert np.mean(np.abs(cloud.rgb[far & is_stem].astype(int) - STEM_RGB).max(axis=1) < 40) > 0.95
    assert cloud.extra["views"].min() >= 3
    assert cloud.extra["views"].max() <= 5
    assert cloud.extra["confidence"].dtype == np.float32


def test_noise_is_averaged_outliers_vanish_and_the_stem_is_complete(tmp_path: Path) -> None:
    scene = make_scene(tmp_path / "scene", tmp_path, noise=0.003, outliers=0.1)
    cloud = fuse(scene, tmp_path)
    distance, is_stem = surface_distance(cloud.xyz)
    # Each map is off by 0.003 * 2.5 m = 7.5 mm, and a tenth of its pixels by 25 cm and more.
    assert np.mean(np.abs(distance) > 0.03) < 0.002
    assert np.std(distance[is_stem & (np.abs(distance) < 0.03)]) < 0.006
    assert abs(np.mean(distance[is_stem & (np.abs(distance) < 0.03)])) < 0.002
    stem = cloud.xyz[is_stem & (cloud.xyz[:, 2] > 0.2) & (cloud.xyz[:, 2] < 1.6)]
    sectors = np.floor((np.arctan2(stem[:, 1], stem[:, 0]) + np.pi) / (2 * np.pi) * 24).astype(int) % 24
    heights = np.floor((stem[:, 2] - 0.2) / 0.2).astype(int)
    filled = np.zeros((24, 7), bool)
    filled[sectors, heights.clip(0, 6)] = True
    assert filled.mean() > 0.95


def test_one_point_a_place_and_bounded_size(tmp_path: Path) -> None:
    scene = make_scene(tmp_path / "scene", tmp_path)
    coarse = fuse(scene, tmp_path, settings=FusionSettings(voxel=0.05))
    keys = np.unique(np.floor(coarse.xyz / 0.05), axis=0)
    assert len(keys) == len(coarse)
    small = fuse(scene, tmp_path, settings=FusionSettings(max_points=2000))
    assert 1000 < len(small) <= 2000
    # Bigger voxels do not move the surface: the chord of 5 cm on a radius of 15 cm is at most 2 mm inside.
    distance, is_stem = surface_distance(coarse.xyz)
    stem = is_stem & (coarse.xyz[:, 2] > 0.1)
    assert -0.0025 < np.median(distance[stem]) <= 0.0005


def test_the_cloud_is_the_same_on_any_number_of_cores(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = make_scene(tmp_path / "scene", tmp_path, noise=0.003, cameras=6)
    clouds = []
    for count in (1, 3):
        monkeypatch.setattr("fsinfer.fusion.fuse.cores", lambda count=count: count)
        clouds.append(fuse(scene, tmp_path, settings=FusionSettings(batch_points=2000)))
    one, several = clouds
    assert np.array_equal(one.xyz, several.xyz)
    assert one.rgb is not None
    assert several.rgb is not None
    assert np.array_equal(one.rgb, several.rgb)
    assert all(np.array_equal(one.extra[name], several.extra[name]) for name in one.extra)


def test_unsure_pixels_are_left_out_by_themselves(tmp_path: Path) -> None:
    def confidence(wrong: NDArray[np.bool_], rng: np.random.Generator) -> NDArray[np.float64]:
        return np.where(wrong, rng.uniform(0, 0.2, wrong.shape), rng.uniform(0.4, 1, wrong.shape))

    # Nothing but the confidence can tell here: every view's neighbours are wrong alike (strict settings off).
    scene = make_scene(tmp_path / "scene", tmp_path, outliers=0.2, confidence=confidence)
    settings = FusionSettings(
        tolerances=Tolerances(relative_depth_step=0.1, relative_depth_step_max=0.1, reprojection_step_px=50.0),
        average_level=1,
        extra_views=0,
        min_seen_through=99,
    )
    with_default = surface_distance(fuse(scene, tmp_path, settings=settings).xyz)[0]
    without = surface_distance(fuse(scene, tmp_path, settings=replace(settings, min_confidence=0.0)).xyz)[0]
    assert np.mean(np.abs(with_default) > 0.05) < 0.5 * np.mean(np.abs(without) > 0.05)


@pytest.mark.parametrize("unsure", [1.0, 0.6])
def test_surer_maps_count_more(tmp_path: Path, unsure: float) -> None:
    """Every other map is 0.4 % too deep; the mean of a view and its four neighbours is weighted by their confidence."""
    scene = make_scene(tmp_path / "scene", tmp_path)
    for number in range(1, 12, 2):
        depth = read_pfm(tmp_path / "depth" / f"{number:03d}.pfm")
        write_pfm(tmp_path / "depth" / f"{number:03d}.pfm", (1.004 * depth).astype(np.float32))
        write_pfm(tmp_path / "confidence" / f"{number:03d}.pfm", np.full(depth.shape, unsure, np.float32))
    maps = DepthMaps(scene, tmp_path)
    samples = fuse_view(scene, maps, 0, (1, 2, 10, 11), min_confidence=0.0, settings=FusionSettings())
    ground = samples.xyz[samples.views == 5]
    ground = ground[(np.abs(ground[:, 2]) < 0.02) & (np.hypot(ground[:, 0], ground[:, 1]) > 2 * RADIUS)]
    assert len(ground) > 500
    center = scene.views[0].camera.center
    # Where the ray meets the ground z = 0 against where the point lies on it.
    deeper = (center[2] - ground[:, 2]) / center[2] - 1
    assert np.median(deeper) == pytest.approx(0.004 * 2 * unsure / (3 + 2 * unsure), rel=0.15)


def test_scene_far_from_its_origin_loses_no_precision(tmp_path: Path) -> None:
    offset = np.array([512_000.0, 5_400_000.0, 300.0])
    near = fuse(make_scene(tmp_path / "a" / "scene", tmp_path / "a", cameras=4), tmp_path / "a")
    far = fuse(make_scene(tmp_path / "b" / "scene", tmp_path / "b", cameras=4, offset=offset), tmp_path / "b")
    # The voxel grid lies elsewhere on the surfaces, so the numbers are alike, not equal.
    assert len(far) == pytest.approx(len(near), rel=0.2)
    distance, _ = surface_distance(far.xyz - offset)
    assert np.percentile(np.abs(distance), 99) < 0.005


def test_stereo_pair_gives_a_cloud(tmp_path: Path) -> None:
    scene = make_scene(tmp_path / "scene", tmp_path, cameras=2)
    cloud = fuse(scene, tmp_path)
    assert len(cloud) > 1000
    assert np.percentile(np.abs(surface_distance(cloud.xyz)[0]), 99) < 0.01


def test_grid_offset_and_steps_of_each_view_are_respected(tmp_path: Path) -> None:
    scene = make_scene(tmp_path / "scene", tmp_path, cameras=4)
    maps = DepthMaps(scene, tmp_path)
    entry = {"pixel_step_x": 2, "pixel_step_y": 2, "offset_x_px": 0.5, "offset_y_px": 0.5}
    (tmp_path / "depth" / "depth.json").write_text(json.dumps({"views": {"000": entry, "002": entry}}))
    other = DepthMaps(scene, tmp_path)
    assert maps.available == (0, 1, 2, 3)
    assert other.available == (0, 2)
    # Map pixel (10, 20) lies at image pixel (20.5, 40.5): the same ray either way.
    ray = np.linalg.inv(other.get(0).intrinsic) @ [10, 20, 1]
    np.testing.assert_allclose(ray, np.linalg.inv(scene.views[0].camera.intrinsic) @ [20.5, 40.5, 1])


def test_fast_check_equals_the_plain_one(tmp_path: Path) -> None:
    scene = make_scene(tmp_path / "scene", tmp_path, noise=0.006, outliers=0.2, cameras=3)
    maps = DepthMaps(scene, tmp_path)
    reference, source = maps.get(0), maps.get(1)
    rows, columns = np.nonzero(reference.inverse_depth)
    chosen = np.random.default_rng(1).choice(len(rows), 800, replace=False)
    u, v = columns[chosen].astype(np.float32), rows[chosen].astype(np.float32)
    depth = np.float32(1) / reference.inverse_depth[rows[chosen], columns[chosen]]
    tolerances = Tolerances()
    fast = check_pair(reference, source, u, v, depth, tolerances=tolerances, min_confidence=0.0)
    plain = [
        check_pixel(reference, source, float(a), float(b), float(c), tolerances=tolerances)
        for a, b, c in zip(u, v, depth, strict=True)
    ]
    levels = np.array([level for level, _ in plain])
    # float32 against float64 may fall on either side of a tolerance, or of the half pixel, in rare cases.
    assert np.mean(levels == fast.level) > 0.99
    assert len(set(levels.tolist())) > 5
    same = levels == fast.level
    np.testing.assert_allclose(fast.depth[same], np.array([d for _, d in plain])[same], rtol=1e-4)


def test_points_that_others_look_through_are_found(tmp_path: Path) -> None:
    scene = make_scene(tmp_path / "scene", tmp_path, cameras=3)
    maps = DepthMaps(scene, tmp_path)
    reference, source = maps.get(0), maps.get(1)
    rows, columns = np.mgrid[80:110:3, 100:150:3].reshape(2, -1)
    depth = np.float32(1) / reference.inverse_depth[rows, columns]
    u, v = columns.astype(np.float32), rows.astype(np.float32)
    floating, true, behind = (
        check_pair(reference, source, u, v, np.float32(share) * depth, tolerances=Tolerances(), min_confidence=0.5)
        for share in (0.7, 1.0, 1.4)
    )
    inside = floating.depth > 0
    assert inside.mean() > 0.5
    assert floating.seen_through[inside].all()
    assert not true.seen_through.any()
    assert not behind.seen_through.any()
    assert (true.level[true.depth > 0] <= 2).mean() > 0.95


@pytest.mark.parametrize(
    ("levels", "expected"),
    [
        ([1, 255, 255, 255], 255),
        ([1, 1, 255, 255], 1),
        ([1, 2, 2, 255], 2),
        ([1, 3, 3, 255], 255),
        ([1, 3, 3, 3], 3),
        ([4, 4, 4, 4], 255),
        ([1], 1),
        ([2], 2),
        ([3], 255),
    ],
)
def test_looser_levels_need_more_views(levels: list[int], expected: int) -> None:
    assert passing_level(np.array(levels, np.uint8)[:, None], extra_views=1)[0] == expected


def test_flying_pixels_at_a_silhouette_are_dropped(tmp_path: Path) -> None:
    scene = make_scene(tmp_path / "scene", tmp_path, cameras=3)
    depth = read_pfm(tmp_path / "depth" / "000.pfm")
    row = 80
    edge = np.flatnonzero(np.diff(depth[row]) < -0.5)[0]
    # A column of mixed depths between the ground and the stem, as smoothing makes them.
    depth[row - 4 : row + 5, edge] = 0.5 * (depth[row - 4 : row + 5, edge - 1] + depth[row, edge + 2])
    write_pfm(tmp_path / "depth" / "000.pfm", depth)
    keep = smooth_pixels(DepthMaps(scene, tmp_path).get(0), min_neighbours=5, noise=1e-3)
    assert not keep[row - 3 : row + 4, edge].any()
    assert keep[row - 3 : row + 4, edge + 2].all()
    assert keep[100, 10:150].all()


def test_normals_of_a_slanted_plane_are_exact(tmp_path: Path) -> None:
    scene = make_scene(tmp_path / "scene", tmp_path, cameras=3)
    reference = DepthMaps(scene, tmp_path).get(0)
    rows, columns = np.mgrid[100:119:3, 3:60:5].reshape(2, -1)
    normals = pixel_normals(reference, rows, columns, noise=1e-3) @ reference.cam_from_world[:3, :3]
    np.testing.assert_allclose(normals, np.tile([0, 0, 1.0], (len(rows), 1)), atol=1e-3)


def test_neighbours_are_sources_and_views_that_list_the_view(tmp_path: Path) -> None:
    scene = make_scene(tmp_path / "scene", tmp_path, cameras=5)
    views = list(scene.views)
    views[0] = replace(views[0], sources=(1,))
    views[4] = replace(views[4], sources=(0, 3))
    found = find_neighbours(replace(scene, views=tuple(views)), (0, 1, 2, 4), 12)
    assert found[0] == (1, 2, 4)
    assert found[4] == (0, 2)
    assert find_neighbours(scene, (0, 1, 2, 4), 1)[0] == (1,)


def test_mistakes_are_user_errors(tmp_path: Path) -> None:
    scene = make_scene(tmp_path / "scene", tmp_path, cameras=3)
    with pytest.raises(SceneError, match="fsinfer depth"):
        fuse(scene, tmp_path / "elsewhere")
    for i in range(3):
        depth = read_pfm(tmp_path / "depth" / f"{i:03d}.pfm")
        write_pfm(tmp_path / "depth" / f"{i:03d}.pfm", depth * (1 + 0.3 * i))
    with pytest.raises(CloudError, match="seen alike"):
        fuse(scene, tmp_path)
    for i in range(3):
        write_pfm(tmp_path / "depth" / f"{i:03d}.pfm", np.full((HEIGHT, WIDTH), np.nan, np.float32))
    with pytest.raises(CloudError, match="empty"):
        fuse(scene, tmp_path)
    write_pfm(tmp_path / "confidence" / "000.pfm", np.ones((3, 3), np.float32))
    with pytest.raises(SceneError, match="differ in size"):
        fuse(scene, tmp_path)
    (tmp_path / "depth" / "depth.json").write_text('{"pixel_step_x": 0, "pixel_step_y": 2}')
    with pytest.raises(SceneError, match="positive"):
        fuse(scene, tmp_path)


def test_levels_fit_their_type() -> None:
    assert LEVELS < 255


def test_depth_tolerance_follows_the_noise_of_the_maps(tmp_path: Path) -> None:
    steps = {}
    for noise in (0.0, 0.006, 0.05):
        scene = make_scene(tmp_path / f"{noise}" / "scene", tmp_path / f"{noise}", noise=noise, cameras=4)
        maps = DepthMaps(scene, tmp_path / f"{noise}")
        neighbours = find_neighbours(scene, maps.available, 4)
        steps[noise] = adapt_tolerances(maps, neighbours, 0.5, FusionSettings()).relative_depth_step
        off = adapt_tolerances(maps, neighbours, 0.5, FusionSettings(noise_part=0))
        assert off == Tolerances()
    assert steps[0.0] == Tolerances().relative_depth_step
    assert 0.0015 < steps[0.006] <= 0.003
    assert steps[0.05] <= 0.003
