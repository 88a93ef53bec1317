from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.fusion import voxels
from fsinfer.fusion.fuse import FusionSettings
from fsinfer.fusion.voxels import Samples, VoxelMerger, merge_voxels, much_worse_than_nearby, sum_within


def join(parts: list[Samples]) -> Samples:
    return Samples(**{name: np.concatenate([getattr(p, name) for p in parts]) for name in Samples.__dataclass_fields__})


def make_samples(
    xyz: list[list[float]] | NDArray[np.float64], weight: list[float] | NDArray[np.float64] | None = None
) -> Samples:
    count = len(xyz)
    return Samples(
        xyz=np.asarray(xyz, float),
        rgb=np.tile(np.array([10, 20, 30], np.float32), (count, 1)),
        normals=np.tile(np.array([0, 0, 1], np.float32), (count, 1)),
        weight=np.ones(count) if weight is None else np.asarray(weight, float),
        confidence=np.linspace(0, 1, count, dtype=np.float32),
        views=np.arange(count, dtype=np.int32),
        count=np.ones(count, np.int32),
    )


def test_points_of_a_voxel_become_their_weighted_mean() -> None:
    _, merged = merge_voxels(make_samples([[0.1, 0.1, 0.1], [0.9, 0.1, 0.1], [-0.1, 0.1, 0.1]], [1, 3, 5]), 1.0)
    order = np.argsort(merged.xyz[:, 0])
    np.testing.assert_allclose(merged.xyz[order], [[-0.1, 0.1, 0.1], [0.7, 0.1, 0.1]])
    assert merged.views[order].tolist() == [2, 1]
    assert merged.count[order].tolist() == [1, 2]
    np.testing.assert_allclose(merged.weight[order], [5, 4])
    np.testing.assert_allclose(merged.confidence[order], [1, 0.25])


def test_batches_give_the_same_as_all_at_once() -> None:
    rng = np.random.default_rng(0)
    parts = [make_samples(rng.normal(0, 3, (400, 3)), rng.uniform(0.1, 2, 400)) for _ in range(6)]
    parts = [replace(part, rgb=rng.uniform(0, 255, (400, 3)).astype(np.float32)) for part in parts]
    merger = VoxelMerger(0.7, max_points=10_000, batch_points=700)
    for part in parts:
        merger.add(part)
    (_, at_once), batched = merge_voxels(join(parts), 0.7), merger.result()
    assert batched is not None
    np.testing.assert_allclose(batched.xyz, at_once.xyz, atol=1e-12)
    np.testing.assert_allclose(batched.weight, at_once.weight, rtol=1e-12)
    np.testing.assert_allclose(batched.rgb, at_once.rgb, rtol=1e-5)
    np.testing.assert_allclose(batched.normals, at_once.normals, atol=1e-6)
    np.testing.assert_allclose(batched.confidence, at_once.confidence, rtol=1e-5)
    np.testing.assert_array_equal(batched.views, at_once.views)
    np.testing.assert_array_equal(batched.count, at_once.count)
    assert not merger._waiting  # what waited takes no memory any more
    # Voxels that were there, and such before, between and behind them.
    assert (batched.count > 1).any()
    assert np.diff(voxels.voxel_keys(batched.xyz, 0.7)).min() > 0


def test_how_many_are_merged_at_a_time_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(5)

    def merged() -> tuple[NDArray[np.int64], Samples]:
        merger = VoxelMerger(0.7, max_points=10_000, batch_points=900)
        for part in parts:
            merger.add(part)
        keys, first = merge_voxels(parts[0], 0.7)
        result = merger.result()
        assert result is not None
        return keys, join([first, result])

    parts = [make_samples(rng.normal(0, 2, (400, 3)), rng.uniform(0.1, 2, 400)) for _ in range(5)]
    parts = [replace(part, rgb=rng.uniform(0, 255, (400, 3)).astype(np.float32)) for part in parts]
    keys, whole = merged()
    assert (whole.count > 1).any()
    for at_once in (1, 7, 64):
        monkeypatch.setattr(voxels, "_AT_ONCE", at_once)
        own_keys, own = merged()
        np.testing.assert_array_equal(own_keys, keys)
        for name in Samples.__dataclass_fields__:
            np.testing.assert_array_equal(getattr(own, name), getattr(whole, name))


def test_normals_of_two_batches_are_averaged_as_positions_are() -> None:
    merger = VoxelMerger(1.0, max_points=10, batch_points=0)
    for normal, weight in (([0, 0, 1], 3.0), ([0, 1, 0], 4.0)):
        batch = make_samples([[0.5, 0.5, 0.5], [1.5, 0.5, 0.5]], [weight, weight])
        merger.add(replace(batch, normals=np.tile(np.array(normal, np.float32), (2, 1))))
    found = merger.result()
    assert found is not None
    np.testing.assert_allclose(found.normals, [[0, 0.8, 0.6]] * 2, atol=1e-6)
    assert found.weight.tolist() == [7, 7]


def test_batches_are_merged_when_enough_has_come_and_not_before(monkeypatch: pytest.MonkeyPatch) -> None:
    sizes: list[int] = []

    def merge(samples: Samples, voxel: float) -> tuple[NDArray[np.int64], Samples]:
        sizes.append(len(samples))
        return merge_voxels(samples, voxel)

    monkeypatch.setattr(voxels, "merge_voxels", merge)
    merger = VoxelMerger(1.0, max_points=100, batch_points=50)
    for _ in range(12):
        merger.add(make_samples([[0.5, 0.5, 0.5]] * 10))
    found = merger.result()
    assert sizes == [60, 60]
    assert found is not None
    assert found.count.tolist() == [120]


def test_voxels_beside_each_other_stay_apart_on_both_sides_of_the_origin() -> None:
    places = np.stack(np.meshgrid(*[[-1.5, -0.5, 0.5, 1.5]] * 3), axis=-1).reshape(-1, 3)
    _, merged = merge_voxels(make_samples(np.concatenate([places, places + 0.1])), 1.0)
    assert len(merged) == 64
    assert set(merged.count.tolist()) == {2}


def test_size_stays_bounded_and_nothing_is_nothing() -> None:
    rng = np.random.default_rng(0)
    merger = VoxelMerger(1e-3, max_points=500, batch_points=1000)
    assert merger.result() is None
    for _ in range(5):
        merger.add(make_samples(rng.uniform(0, 1, (900, 3)) * [1, 1, 0]))
    result = merger.result()
    assert result is not None
    assert 250 < len(result) <= 500
    assert result.count.sum() == 4500
    assert merger.voxel > 0.02


def test_lone_specks_have_few_neighbours() -> None:
    rng = np.random.default_rng(0)
    xyz = np.concatenate([rng.uniform(0, 1, (500, 3)), [[9.0, -7, 2]], [[9.2, -7, 2]]])
    near = sum_within(xyz, 0.5, np.ones(len(xyz), np.int32))
    assert near[-2:].tolist() == [2, 2]
    assert near[:500].min() > 50
    # Cells on both sides of the origin are neighbours too.
    assert sum_within(np.array([[-0.01, 0, 0], [0.01, 0, 0]]), 0.5, np.array([3, 4], np.int32)).tolist() == [
        7,
        7,
    ]


@pytest.mark.parametrize(("times", "goes"), [(2.2, False), (4.2, True)])
def test_what_is_three_times_less_sure_than_its_surroundings_is_halo(times: float, goes: bool) -> None:
    xyz = np.random.default_rng(2).uniform(0, 0.05, (600, 3)) * [1, 1, 0]
    few = np.arange(600) < 10
    samples = make_samples(xyz, np.where(few, times**-2.0, 1.0))
    ratio = FusionSettings().halo_ratio
    assert ratio is not None
    worse = much_worse_than_nearby(samples, 0.02, ratio)
    assert worse[few].all() if goes else not worse[few].any()
    assert not worse[~few].any()


def test_sums_are_over_the_cell_and_its_neighbours_on_every_side() -> None:
    # One point in the middle of each of 5 x 5 x 5 cells, on both sides of the origin.
    cells = np.stack(np.meshgrid(*[np.arange(-2.0, 3)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    values = np.arange(125) + 1
    xyz: NDArray[np.float64] = 0.3 * (cells + 0.5)
    found = sum_within(xyz, 0.3, values)
    near = (np.abs(cells[:, None] - cells[None]) <= 1).all(axis=2)
    np.testing.assert_array_equal(found, near @ values)
    bins = (values % 2).astype(np.int64)
    apart = sum_within(xyz, 0.3, values, bins)
    np.testing.assert_array_equal(apart, (near & (bins[:, None] == bins[None])) @ values)


def test_colours_and_normals_are_averaged_as_positions_are() -> None:
    samples = make_samples([[0.1, 0.1, 0.1], [0.9, 0.1, 0.1]], [1, 3])
    samples = replace(
        samples,
        rgb=np.array([[0, 100, 200], [40, 20, 200]], np.float32),
        normals=np.array([[1, 0, 0], [0, 0.6, 0.8]], np.float32),
    )
    _, merged = merge_voxels(samples, 1.0)
    np.testing.assert_allclose(merged.rgb, [[30, 40, 200]])
    mean = np.array([0.25, 0.45, 0.6])
    np.testing.assert_allclose(merged.normals, [mean / np.linalg.norm(mean)], rtol=1e-6)


def test_the_halo_of_far_views_goes_and_a_side_seen_only_from_far_stays() -> None:
    rng = np.random.default_rng(1)

    def wall(count: int, normal: tuple[float, float, float], sigma: float, y: float) -> Samples:
        xyz = np.stack([rng.uniform(0, 1, count), y + rng.normal(0, sigma, count), rng.uniform(0, 1, count)], axis=1)
        ones = np.ones(count)
        return Samples(
            xyz=xyz,
            rgb=np.zeros((count, 3), np.float32),
            normals=np.tile(np.array(normal, np.float32), (count, 1)),
            weight=ones / sigma**2,
            confidence=ones.astype(np.float32),
            views=ones.astype(np.int32),
            count=ones.astype(np.int32),
        )

    near, far = wall(3000, (0, -1, 0), 0.003, 0.0), wall(3000, (0, -1, 0), 0.02, 0.0)
    back = wall(3000, (0, 1, 0), 0.02, 0.1)
    worse = much_worse_than_nearby(join([near, far, back]), 0.05, 2.0)
    assert not worse[:3000].any()
    assert worse[3000:6000].mean() > 0.9  # a point far out in the halo may have no near neighbour
    assert not worse[6000:].any()
