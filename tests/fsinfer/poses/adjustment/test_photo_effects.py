"""A photo's own effects undone: the pixel of a ray is where the photo shows the point on it."""

from __future__ import annotations

import numpy as np

from fsinfer.poses.adjustment.photo_effects import effects_of, smooth_inverse_depth
from tests.support.phone_walk import HEIGHT, PHONE, WIDTH, phone_walk


def test_rays_lead_to_where_the_photo_shows_their_points() -> None:
    seen, truth = phone_walk(effects=4 * PHONE, noise_px=0.0)
    inside = truth.in_cameras(seen)
    for photo in (0, 7):
        rows = seen.photo == photo
        points = inside[rows]
        effects = effects_of(truth.own[photo], seen.xy[rows], points[:, 2], WIDTH, HEIGHT)
        np.testing.assert_allclose(effects.own, truth.own[photo], atol=1e-12)
        pixels = effects.pixels(points / points[:, 2:], 1 / points[:, 2], truth.lenses[0])
        np.testing.assert_allclose(pixels, seen.xy[rows], atol=1e-3)
        # Without the effects the photo would show them pixels elsewhere.
        still = effects_of(0 * truth.own[photo], seen.xy[rows], points[:, 2], WIDTH, HEIGHT)
        moved = still.pixels(points / points[:, 2:], 1 / points[:, 2], truth.lenses[0]) - seen.xy[rows]
        assert np.median(np.linalg.norm(moved, axis=1)) > 3


def test_a_photo_held_upright_is_read_out_from_side_to_side() -> None:
    own = np.zeros(9)
    own[5] = 0.01
    rays = np.array([[0.3, 0.0, 1.0], [0.0, 0.3, 1.0]])
    lens = np.array([1000.0, 1000.0, HEIGHT / 2, WIDTH / 2, *[0.0] * 8])
    upright = effects_of(own, np.empty((0, 2)), np.empty(0), HEIGHT, WIDTH)
    shift = upright.pixels(rays, np.zeros(2), lens) - (1000 * rays[:, :2] + lens[2:4])
    # A turn about the axis: what lies at the side, read late, has moved along the row; what lies below has not.
    np.testing.assert_allclose(shift, [[0.0, 0.01 * 300 * 300 / HEIGHT], [0.0, 0.0]], atol=1e-2)


def test_smooth_depth_follows_the_points_and_falls_back_on_their_middle() -> None:
    rng = np.random.default_rng(0)
    pixels = rng.uniform((0, 0), (WIDTH / 2, HEIGHT), (600, 2))
    depths = np.where(pixels[:, 1] < HEIGHT / 2, 8.0, 2.0)
    cells = smooth_inverse_depth(pixels, depths, WIDTH, HEIGHT)
    assert abs(cells[2, 4] - 1 / 8) < 0.01
    assert abs(cells[-3, 4] - 1 / 2) < 0.02
    middle = np.median(1 / depths)
    np.testing.assert_allclose(cells[:, -1], middle, atol=0.01)
    effects = effects_of(np.zeros(9), pixels, depths, WIDTH, HEIGHT)
    at = effects.inverse_depths(np.array([[WIDTH * 4.5 / 32, HEIGHT * 2.5 / 32], [-50.0, 0.0]]))
    np.testing.assert_allclose(at, [cells[2, 4], cells[0, 0]], atol=1e-6)
