"""Least-squares matching: to a few hundredths of a pixel, as a plain fit finds it, and honest about itself."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.optimize import least_squares

from fsinfer.poses.adjustment.patches import PATCH_SIDE, Matches, align, patches_at, smoothed
from fsinfer.poses.adjustment.projection import Floats
from tests.support.painted_corner import paint

SIZE = 400
HALF = (PATCH_SIDE - 3) // 2


def picture(seed: int = 0) -> NDArray[np.float32]:
    return paint(np.random.default_rng(seed), SIZE)


def warped(
    grey: NDArray[np.float32], affine: Floats, shift: Floats, *, gain: float = 1.0, offset: float = 0.0
) -> NDArray[np.float32]:
    """What lies at x lies at ``affine`` x + ``shift``; pixel centres at halves."""
    middle = np.array([0.5, 0.5])
    matrix = np.column_stack([affine, affine @ middle + shift - middle])
    return gain * cv2.warpAffine(grey, matrix, (SIZE, SIZE), flags=cv2.INTER_LANCZOS4) + offset


def noisy(grey: NDArray[np.float32], std: float, seed: int) -> NDArray[np.uint8]:
    noise = np.random.default_rng(seed).normal(0, std, grey.shape)
    return np.clip(grey + noise, 0, 255).astype(np.uint8)


AFFINE, SHIFT = np.array([[1.1, 0.08], [-0.05, 0.95]]), np.array([3.3, -2.7])


def laid(noise: float = 2.0, *, step: float = 1.0, off: float = 1.0, gain: float = 0.8) -> tuple[Matches, Floats]:
    """Patches laid over a picture that is turned, stretched and darker, from ``off`` pixels away on; where they lie."""
    grey = picture()
    other = warped(grey, AFFINE, SHIFT, gain=gain, offset=12)
    xy = np.stack(np.meshgrid(np.arange(60, 330, 17.3), np.arange(60, 330, 17.3)), axis=-1).reshape(-1, 2)
    true = xy @ AFFINE.T + SHIFT
    start = true + np.random.default_rng(5).uniform(-off, off, true.shape)
    patches = patches_at(smoothed(noisy(grey, noise, 1), step), xy, step)
    image = smoothed(noisy(other, noise, 2), step)
    return align(patches, image, start, np.broadcast_to(np.eye(2), (len(xy), 2, 2)), step), true


@pytest.mark.parametrize("step", [1.0, 1.6])
def test_patches_are_found_to_hundredths_of_a_pixel(step: float) -> None:
    found, true = laid(step=step)
    off = found.xy - true
    assert found.at_rest.mean() > 0.98
    assert np.abs(np.median(off, axis=0)).max() < 0.01
    assert np.sqrt((off[found.at_rest] ** 2).mean()) < 0.04
    assert np.median(found.correlation) > 0.95
    np.testing.assert_allclose(np.median(found.affine, axis=0), AFFINE, atol=0.01)


def test_in_larger_photos_patches_are_found_from_as_many_more_pixels_away() -> None:
    share = []
    for step in (1.0, 3.0):
        found, true = laid(step=step, off=2.0 * step)
        share.append(np.mean(found.at_rest & (np.linalg.norm(found.xy - true, axis=1) < 0.1)))
    assert share[0] > 0.9
    assert share[1] > 0.9


def test_it_is_where_a_plain_fit_finds_the_least_differences() -> None:
    grey = picture(3)
    first = smoothed(noisy(grey, 2, 1), 1.0)
    second = smoothed(noisy(warped(grey, AFFINE, SHIFT), 2, 2), 1.0)
    xy = np.random.default_rng(0).uniform(60, 330, (30, 2))
    start = xy @ AFFINE.T + SHIFT + 0.4
    patches = patches_at(first, xy, 1.0)
    found = align(patches, second, start, np.broadcast_to(np.eye(2), (30, 2, 2)), 1.0)
    along = np.arange(-HALF, HALF + 1)
    grid = np.stack(np.meshgrid(along, along), axis=-1).reshape(-1, 2)
    weights = np.exp(-0.5 * (grid**2).sum(1) / 16)
    weights /= weights.sum()

    def normalised(values: Floats) -> Floats:
        values = values - weights @ values
        return np.asarray(np.sqrt(weights) * values / np.sqrt(weights @ values**2))

    off = []
    for patch, begin, place in zip(patches, start, found.xy, strict=True):
        inner = normalised(patch[1:-1, 1:-1].ravel().astype(np.float64))

        def differences(numbers: Floats, inner: Floats = inner) -> Floats:
            places = numbers[:2] + grid @ numbers[2:].reshape(2, 2).T - 0.5
            return normalised(map_coordinates(second.astype(np.float64), places.T[::-1], order=1)) - inner

        best = least_squares(differences, np.array([*begin, 1, 0, 0, 1]), x_scale="jac", diff_step=1e-4).x
        off.append(place - best[:2])
    # Both are off the truth by 0.03 pixels, as the photos' noise has it.
    assert np.sqrt((np.array(off) ** 2).mean()) < 0.02


def test_brightness_and_contrast_do_not_matter() -> None:
    (plain, _), (dark, _) = laid(0.0, gain=1.0), laid(0.0, gain=0.6)
    np.testing.assert_allclose(plain.xy, dark.xy, atol=0.05)


def test_what_it_says_of_itself_follows_the_noise() -> None:
    std, off = [], []
    for noise in (1.0, 4.0):
        found, true = laid(noise)
        good = found.at_rest
        std.append(np.median(found.std[good]))
        off.append(np.sqrt(((found.xy - true)[good] ** 2).mean()))
    assert 2 < std[1] / std[0] < 5
    assert all(0.3 < told / seen < 2 for told, seen in zip(std, off, strict=True))


def test_what_shows_something_else_is_no_match() -> None:
    xy = np.full((40, 2), 200.0) + np.random.default_rng(0).uniform(-100, 100, (40, 2))
    patches = patches_at(smoothed(noisy(picture(1), 1, 1), 1.0), xy, 1.0)
    other = smoothed(noisy(picture(2), 1, 2), 1.0)
    found = align(patches, other, xy, np.broadcast_to(np.eye(2), (40, 2, 2)), 1.0)
    assert not (found.at_rest & (found.correlation > 0.85)).any()


def test_patches_without_structure_go_nowhere() -> None:
    flat = np.full((SIZE, SIZE), 90, np.uint8)
    xy = np.array([[200.0, 200.0], [1.0, 399.0]])
    patches = patches_at(smoothed(flat, 1.0), xy, 1.0)
    found = align(patches, smoothed(flat, 1.0), xy, np.broadcast_to(np.eye(2), (2, 2, 2)), 1.0)
    assert np.isfinite(found.xy).all()
    assert (found.correlation < 0.5).all()
    assert (found.std > 1).all()
