"""Homography warping: geometry against projected points, and the fast path against the plain reference."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.depth.cost_volume import (
    Features,
    correlation_volume_reference,
    mean_of_four,
    plane_inverse_depths,
    upsample_index,
    upsample_twice,
    variance_volume,
    weighted_correlation_volume,
)
from fsinfer.depth.warping import Projection, relative_projection, sample, sample_reference, source_coordinates


def rotation(axis: int, angle: float) -> NDArray[np.float64]:
    c, s = np.cos(angle), np.sin(angle)
    matrix = np.eye(3)
    i, j = [k for k in range(3) if k != axis]
    matrix[i, i], matrix[i, j], matrix[j, i], matrix[j, j] = c, -s, s, c
    return matrix


def two_views() -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    k0 = np.array([[400.0, 0, 160], [0, 410, 120], [0, 0, 1]])
    k1 = np.array([[380.0, 0, 150], [0, 385, 125], [0, 0, 1]])
    pose0, pose1 = np.eye(4), np.eye(4)
    pose0[:3, :3], pose0[:3, 3] = rotation(1, 0.2), [0.3, 0.1, -0.2]
    pose1[:3, :3], pose1[:3, 3] = rotation(0, -0.1) @ rotation(1, 0.35), [-0.2, 0.05, 0.1]
    return k0, pose0, k1, pose1


@pytest.mark.parametrize("stride", [1.0, 2.0, 4.0])
def test_coordinates_are_the_projections_of_the_points(stride: float) -> None:
    k0, pose0, k1, pose1 = two_views()
    projection = relative_projection(k0, pose0, k1, pose1, stride)
    inverse = np.array([0.1, 0.5, 0.9], np.float32)[:, None, None]
    x, y = source_coordinates(projection, inverse, row_start=3, width=7, height=5)
    for plane, row, column in [(0, 0, 0), (1, 4, 6), (2, 2, 3)]:
        depth = 1 / float(inverse[plane, 0, 0])
        pixel = stride * np.array([column, row + 3])
        camera = np.linalg.inv(k0) @ np.array([*pixel, 1.0]) * depth
        world = pose0[:3, :3].T @ (camera - pose0[:3, 3])
        image = k1 @ (pose1[:3, :3] @ world + pose1[:3, 3])
        expected = image[:2] / image[2] / stride
        np.testing.assert_allclose([x[plane, row, column], y[plane, row, column]], expected, atol=2e-4)


def test_hypotheses_behind_the_source_are_outside() -> None:
    projection = Projection(matrix=np.eye(3), offset=np.array([0.0, 0, -2.0]))
    x, _ = source_coordinates(projection, np.array([1.0], np.float32)[:, None, None], width=3, height=2)
    assert (x < -1000).all()


def test_fast_sampling_equals_the_reference() -> None:
    rng = np.random.default_rng(1)
    features = rng.normal(size=(40, 50, 4)).astype(np.float32)
    x = rng.uniform(-3, 53, (6, 20, 30)).astype(np.float32)
    y = rng.uniform(-3, 43, (6, 20, 30)).astype(np.float32)
    # The coordinates hold fractions finer than 1/32 pixel: a rounding remap would be off by over 0.05.
    assert np.abs(sample(features, x, y) - sample_reference(features, x, y)).max() < 5e-6


def test_tall_stacks_are_cut_below_the_limit_of_remap() -> None:
    features = np.random.default_rng(2).normal(size=(300, 8, 4)).astype(np.float32)
    y, x = (a.astype(np.float32) for a in np.mgrid[0:300, 0:8])
    planes = 200  # 60,000 rows
    stacked = sample(features, np.broadcast_to(x, (planes, 300, 8)).copy(), np.broadcast_to(y, (planes, 300, 8)).copy())
    np.testing.assert_array_equal(stacked[-1], features)


def small_scene() -> tuple[list[NDArray[np.float32]], list[Projection], NDArray[np.float32]]:
    rng = np.random.default_rng(3)
    k0, pose0, k1, pose1 = two_views()
    maps = [rng.normal(size=(8, 37, 41)).astype(np.float32) for _ in range(3)]
    pose2 = pose0.copy()
    pose2[0, 3] += 0.2
    projections = [relative_projection(k0, pose0, k1, pose1, 4), relative_projection(k0, pose0, k0, pose2, 4)]
    return maps, projections, plane_inverse_depths(1.0, 9.0, 16, inverse=True)[:, None, None]


def test_variance_volume_from_its_definition() -> None:
    maps, projections, inverse = small_scene()
    features = [Features.from_chw(m) for m in maps]
    volume = variance_volume(features[0], features[1:], projections, inverse, threads=2)
    hwc = [m.transpose(1, 2, 0) for m in maps]
    warped = [np.broadcast_to(hwc[0], (16, 37, 41, 8))]
    for source, projection in zip(hwc[1:], projections, strict=True):
        warped.append(sample_reference(source, *source_coordinates(projection, inverse, 0, 41, 37)))
    np.testing.assert_allclose(volume, np.var(np.stack(warped), axis=0).transpose(3, 0, 1, 2), atol=2e-5)


@pytest.mark.parametrize(("inverse", "middle"), [(True, 2 / (1 / 2 + 1 / 10)), (False, 6.0)])
def test_planes(inverse: bool, middle: float) -> None:
    planes = plane_inverse_depths(2.0, 10.0, 193, inverse=inverse)
    assert sorted([1 / planes[0], 1 / planes[-1]]) == pytest.approx([2, 10])
    assert 1 / planes[96] == pytest.approx(middle)


def test_upsampling_keeps_every_second_pixel() -> None:
    values = np.random.default_rng(0).uniform(0, 0.5, (5, 7)).astype(np.float32)
    up = upsample_twice(values, 9, 14)
    np.testing.assert_array_equal(up[::2, ::2], values)
    np.testing.assert_allclose(up[1, 0], (values[0, 0] + values[1, 0]) / 2)


def test_a_slanted_plane_stays_one_between_the_pixels() -> None:
    row, column = np.mgrid[0:5, 0:7].astype(np.float32)
    up = upsample_twice(2 * row + 3 * column, 10, 14)
    row, column = np.minimum(np.mgrid[0:10, 0:14] / 2, [[[4]], [[6]]])  # beyond the last pixel it repeats
    np.testing.assert_allclose(up, 2 * row + 3 * column, atol=1e-6)


def test_upsampling_across_a_step_invents_no_surface() -> None:
    index = np.zeros((4, 6), np.float32)
    index[:, 3:] = 50
    assert set(np.unique(upsample_index(index, 8, 12))) == {0.0, 50.0}


@pytest.mark.parametrize("shape", [(8, 2, 5), (3, 1, 5)])
def test_mean_of_four_is_the_mean(shape: tuple[int, int, int]) -> None:
    values = np.random.default_rng(0).normal(size=(*shape, 4)).astype(np.float32)
    out = np.empty(shape, np.float32)
    mean_of_four(values, out=out)
    assert np.allclose(out, values.mean(axis=-1), atol=1e-6)


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("block_bytes", [0, 40_000, 10**9])
@pytest.mark.parametrize("slanted", [False, True])
def test_with_known_weights_the_volume_is_what_the_definition_says(
    threads: int, block_bytes: int, slanted: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fsinfer.depth.cost_volume.BLOCK_BYTES", block_bytes)
    maps, projections, planes = small_scene()
    # A pixel's hypotheses are its own, or those of all.
    tilt = np.linspace(1, 1.5, 37, dtype=np.float32)[:, None] if slanted else np.ones((37, 1), np.float32)
    inverse = np.broadcast_to(planes * tilt, (16, 37, 41))
    hwc = [m.transpose(1, 2, 0) for m in maps]
    expected, weights = correlation_volume_reference(hwc[0], hwc[1:], projections, inverse)
    views = [Features.from_chw(m) for m in maps]
    found = weighted_correlation_volume(
        views[0], views[1:], projections, len(planes), lambda rows: inverse[:, rows], weights, threads=threads
    )
    np.testing.assert_allclose(found, expected, atol=2e-5)


def test_feature_maps_in_groups_are_those_that_were_cut() -> None:
    maps = np.random.default_rng(6).normal(size=(9, 12, 7)).astype(np.float32)
    for given in (maps[:8], maps[1:, :5], maps[:8, ::2, ::3]):
        groups = Features.from_chw(given)
        assert groups.shape == given.shape[1:]
        assert all(group.flags.c_contiguous for group in groups.groups)
        np.testing.assert_array_equal(groups.to_chw(), given)
