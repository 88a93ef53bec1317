"""What the synthetic phone does to a photograph is what its record says."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

pytest.importorskip("embreex")

from fsinfer.scene import read_camera
from training.synthesize.__main__ import main, parse
from training.synthesize.cameras.camera_path import intrinsics, look_at, make_camera
from training.synthesize.cameras.phone import PHONE, PHONE_VIDEO, PhoneEffects, Shot, shots_of, with_overrides
from training.synthesize.cameras.photo import expose, random_sensor
from training.synthesize.forest.light import random_light
from training.synthesize.forest.material import Material, pyramid
from training.synthesize.forest.mesh import Mesh, quads
from training.synthesize.forest.textures import bark, remix
from training.synthesize.forest.wind import blown
from training.synthesize.render import Caster, moving_rays, pixel_rays
from training.train_settings import parse_arguments

WIDTH, HEIGHT = 64, 48
CENTER = np.array([0.3, 0.1, 1.2])
CAMERA = make_camera(intrinsics(WIDTH, HEIGHT, 60.0), look_at(CENTER, np.array([1.0, 4.0, 0.4]), 0.1))
STILL = Shot(camera=CAMERA, velocity_m_s=np.zeros(3), spin_rad_s=np.zeros(3))


def wall() -> Mesh:
    """A card of 8 m, five metres ahead."""
    center = np.array([[0.0, 5.0, 1.0]])
    return quads(center, np.array([[4.0, 0.0, 0.0]]), np.array([[0.0, 0.0, 4.0]]), 0)


def caster(cards: Mesh, ground: Mesh) -> Caster:
    material = Material(levels=pyramid(np.full((16, 16, 4), 200, np.uint8)), tile_m=1.0)
    return Caster(ground, cards, [material], random_light(np.random.default_rng(0), forest=True, panorama_px=64))


def test_a_phone_held_still_sees_what_a_pinhole_sees() -> None:
    for k1 in (0.0, 0.03):
        shot = replace(STILL, distortion=k1)
        origins, rays = moving_rays(shot, WIDTH, HEIGHT, (0.2, -0.3), (0, 4))
        expected = pixel_rays(CAMERA, WIDTH, HEIGHT, (0.2, -0.3), k1)
        np.testing.assert_allclose(origins, expected[0], atol=1e-6)
        np.testing.assert_allclose(rays, expected[1], atol=2e-6)


@pytest.mark.parametrize("row", [0, 24, 47])
def test_each_row_is_seen_from_where_the_phone_was_then(row: int) -> None:
    velocity, spin, readout = np.array([0.4, -0.1, 0.05]), np.array([0.05, -0.1, 0.08]), 0.025
    shot = replace(STILL, velocity_m_s=velocity, spin_rad_s=spin, readout_s=readout)
    time = ((row + 0.5) / HEIGHT - 0.5) * readout
    # The camera of that moment: it has moved on, and turned about its own axes.
    turned = Rotation.from_rotvec(-time * spin).as_matrix() @ CAMERA.cam_from_world[:3, :3]
    pose = np.eye(4)
    pose[:3, :3] = turned
    pose[:3, 3] = -turned @ (CENTER + time * velocity)
    origins, rays = moving_rays(shot, WIDTH, HEIGHT, (0.0, 0.0), (0, 1))
    expected = pixel_rays(make_camera(CAMERA.intrinsic, pose), WIDTH, HEIGHT, (0.0, 0.0))
    chosen = slice(row * WIDTH, (row + 1) * WIDTH)
    np.testing.assert_allclose(origins[chosen], expected[0][chosen], atol=1e-6)
    ours, theirs = (r / np.linalg.norm(r, axis=1, keepdims=True) for r in (rays[chosen], expected[1][chosen]))
    np.testing.assert_allclose(ours, theirs, atol=5e-6)


def test_rays_of_a_pixel_are_spread_evenly_over_its_exposure() -> None:
    shot = replace(STILL, velocity_m_s=np.array([1.0, 0.0, 0.0]), exposure_s=0.01)
    moved = [moving_rays(shot, WIDTH, HEIGHT, (0.0, 0.0), (n, 4))[0][:, 0] - CENTER[0] for n in range(4)]
    expected = 0.01 * (np.array([0.5, 1.5, 2.5, 3.5]) / 4 - 0.5)
    np.testing.assert_allclose(
        np.sort(np.stack(moved), axis=0), np.repeat(expected[:, None], WIDTH * HEIGHT, 1), atol=1e-6
    )


def test_wind_moves_leaves_as_far_as_it_says_and_keeps_cards_whole() -> None:
    rng = np.random.default_rng(1)
    count = 4000
    half = np.full((count, 3), 0.1)
    cards = quads(rng.uniform(-8, 8, (count, 3)), half * [1, 0, 0], half * [0, 0, 1], 0)
    weights = np.repeat(np.where(np.arange(count) % 2, 1.0, 0.0), 4).astype(np.float32)
    moved = blown(np.random.default_rng(2), cards.vertices, weights, 0.02, own=4) - cards.vertices
    assert np.abs(moved[weights == 0]).max() == 0
    assert np.sqrt((moved[weights == 1] ** 2).sum(1).mean()) == pytest.approx(0.02, rel=0.15)
    # The corners of a card differ by the gust alone, which changes over metres.
    corners = moved.reshape(count, 4, 3)[1::2]
    assert np.linalg.norm(corners - corners.mean(axis=1, keepdims=True), axis=2).max() < 0.01


def test_what_the_wind_moves_is_seen_elsewhere_and_comes_back_in_a_lull() -> None:
    cards = wall()
    ground = quads(np.array([[0.0, 0.0, -5.0]]), np.array([[50.0, 0, 0]]), np.array([[0, 50.0, 0]]), 0)
    scene = caster(cards, ground)
    calm = scene.depth(CAMERA, WIDTH, HEIGHT)
    weights = np.ones(len(cards.vertices), np.float32)
    scene.blow(np.random.default_rng(3), 0.3, weights, np.zeros(0, np.float32))
    assert np.abs(scene.depth(CAMERA, WIDTH, HEIGHT) - calm).max() > 0.02
    scene.blow(np.random.default_rng(3), 0.0, weights, np.zeros(0, np.float32))
    np.testing.assert_array_equal(scene.depth(CAMERA, WIDTH, HEIGHT), calm)


def test_shots_have_the_spread_that_was_asked_for() -> None:
    cameras = [replace(CAMERA) for _ in range(400)]
    effects = PhoneEffects(breathing=0.002, principal_px=3.0, turn_rad_s=0.1, clouds=0.5)
    shots = shots_of(np.random.default_rng(4), cameras, effects)
    focal = np.array([shot.camera.intrinsic[0, 0] for shot in shots]) / CAMERA.intrinsic[0, 0] - 1
    center = np.array([shot.camera.intrinsic[:2, 2] for shot in shots]) - CAMERA.intrinsic[:2, 2]
    assert focal.std() == pytest.approx(0.002, rel=0.15)
    assert center.std() == pytest.approx(3.0, rel=0.15)
    assert np.array([shot.spin_rad_s for shot in shots]).std() == pytest.approx(0.1, rel=0.15)
    sunshine = [shot.sunshine for shot in shots]
    assert min(sunshine) == pytest.approx(0.5)
    assert max(sunshine) == 1


def test_tone_mapping_lifts_the_dark_and_its_noise() -> None:
    light = np.concatenate([np.full((64, 64, 3), 0.02), np.full((64, 64, 3), 0.5)], axis=1).astype(np.float32)
    sensor = replace(random_sensor(np.random.default_rng(0), light), vignetting=0.0, noise=0.01, sharpening=0.0)
    plain, mapped = (
        expose(np.random.default_rng(1), replace(sensor, tone=tone), light).astype(float) for tone in (0.0, 0.5)
    )
    dark = np.s_[8:56, 8:40]
    assert mapped[dark].mean() > 1.2 * plain[dark].mean()
    assert mapped[dark].std() > 1.2 * plain[dark].std()


def test_effects_by_name_and_a_wrong_one_is_told() -> None:
    assert with_overrides(PHONE, ["wind_m=0.03", "own_bark=0"]) == replace(PHONE, wind_m=0.03, own_bark=0)
    assert PHONE_VIDEO.walk_m_s == 1.0
    for wrong in ("storm=1", "wind_m=strong"):
        with pytest.raises(SystemExit, match="--effect"):
            with_overrides(PHONE, [wrong])


def test_options_that_take_several_may_be_given_more_than_once(tmp_path: Path) -> None:
    """The first of two was dropped without a word: a world was rendered without the effect that it was asked for."""
    effects = ["--effect", "wind_m=0.03", "--effect", "principal_px=12", "own_bark=0"]
    assert parse([str(tmp_path), *effects]).effect == ["wind_m=0.03", "principal_px=12", "own_bark=0"]
    assert parse([str(tmp_path), "--effect", "wind_m=0.01"]).effect == ["wind_m=0.01"]
    folders = ["--data", "a", "--data", "b", "c", "--validation", "d", "--validation", "e"]
    settings = parse_arguments(["--out", "run", *folders])
    assert [path.name for path in settings.data] == ["a", "b", "c"]
    assert [path.name for path in settings.validation] == ["d", "e"]


def test_a_plot_with_a_phone_records_what_it_did(tmp_path: Path) -> None:
    size = ["--width", "96", "--height", "54", "--supersample", "1", "--texture-px", "64"]
    plot = ["--kind", "plot", "--seed", "7", "--photos", "3", "--trees", "3", "--radius-m", "3", "--boards", "1"]
    main([str(tmp_path), *plot, *size, "--phone", "--double-faced"])
    shots = json.loads((tmp_path / "shots.json").read_text(encoding="utf-8"))
    focal = [read_camera(path).intrinsic[0, 0] for path in sorted((tmp_path / "cams").glob("*.txt"))]
    assert focal == pytest.approx([shot["focal_px"] for shot in shots], rel=1e-5)
    assert len(set(focal)) == 3
    assert all(shot["readout_s"] == PHONE.readout_s for shot in shots)
    boards = json.loads((tmp_path / "markers.json").read_text(encoding="utf-8"))["boards"]
    assert [board["id"] for board in boards] == [0, 0]


def test_of_one_photograph_each_tree_has_a_bark_of_its_own() -> None:
    tile = bark(np.random.default_rng(3), 512)[0]
    one, other = (remix(np.random.default_rng(seed), tile) for seed in (1, 2))
    assert one.shape == tile.shape
    # The same kind: as bright, as rough.
    assert abs(float(one.mean()) - float(tile.mean())) < 0.35 * tile.mean()
    # The cut of a stem is found again in the tile that it comes from, and in no other tree.
    assert alike(tile, tile) > 500
    assert alike(one, other) < 15
    # Periodic: it goes round the stem without a seam.
    step = np.abs(np.diff(one.astype(float), axis=1)).mean()
    assert np.abs(one[:, 0].astype(float) - one[:, -1]).mean() < 1.5 * step


def alike(one: NDArray[np.uint8], other: NDArray[np.uint8]) -> int:
    """Features of two pictures that match and fit one epipolar geometry."""
    sift = cv2.SIFT.create(4000)
    (at, first), (there, second) = (
        sift.detectAndCompute(cv2.cvtColor(x, cv2.COLOR_RGB2GRAY), None) for x in (one, other)
    )
    pairs = cv2.BFMatcher().knnMatch(first, second, k=2)
    good = [a for a, b in pairs if a.distance < 0.8 * b.distance]
    if len(good) < 8:
        return len(good)
    points = np.array([at[m.queryIdx].pt for m in good]), np.array([there[m.trainIdx].pt for m in good])
    return int(cv2.findFundamentalMat(*points, cv2.FM_RANSAC, 2.0)[1].sum())


def test_training_scenes_get_the_effects_at_random_strengths(tmp_path: Path) -> None:
    small = ["--width", "64", "--height", "48", "--texture-px", "64", "--views", "2", "--supersample", "1"]
    main([str(tmp_path), "--seed", "78", "--kind", "cluster", "--clusters-per-scene", "1", *small, "--phone"])
    record = json.loads((tmp_path / "s00078_0" / "synth.json").read_text(encoding="utf-8"))
    drawn = record["effects"]
    assert drawn["distortion"] == 0  # images are straightened before the network sees them
    for name in ("wind_m", "readout_s", "breathing", "tone"):
        assert 0 < drawn[name] <= 1.5 * getattr(PHONE, name)
    assert drawn["wind_m"] / PHONE.wind_m != pytest.approx(drawn["tone"] / PHONE.tone)
    cameras = [read_camera(path) for path in sorted((tmp_path / "s00078_0" / "cams").glob("*_cam.txt"))]
    assert cameras[0].intrinsic[0, 0] != cameras[1].intrinsic[0, 0]  # each has the focal length that it was taken with
