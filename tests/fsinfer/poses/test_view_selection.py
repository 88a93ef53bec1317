"""Sources are views with shared points at good angles, and depth ranges hold what is seen."""

from __future__ import annotations

import time

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.poses.sparse import SparseModel
from fsinfer.poses.view_selection import SelectionSettings, choose_sources, depth_range, score_pairs


def cameras_on_a_line(angles_deg: list[float], distance: float) -> NDArray[np.float64]:
    return np.array([[distance * np.tan(np.radians(angle)), 0, 0] for angle in angles_deg])


def test_score_follows_the_formula() -> None:
    # One point straight ahead of the first camera, so that the angle between the rays is the one given.
    for angle_deg, sigma_deg in ((3.0, 1.0), (5.0, 1.0), (12.0, 10.0), (40.0, 10.0)):
        centers = cameras_on_a_line([0.0, angle_deg], 4.0)
        point = np.array([[0.0, 0.0, 4.0]])
        scores = score_pairs(point, centers, [np.array([0]), np.array([0])])
        expected = max(1e-6, np.exp(-((angle_deg - 5) ** 2) / (2 * sigma_deg**2)))
        assert scores[0, 1] == pytest.approx(expected, rel=1e-6)
        assert scores[1, 0] == scores[0, 1]


def test_best_source_has_angle_and_shared_points() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform([-1, -1, 4], [1, 1, 5], (300, 3))
    everything = np.arange(300)
    # The second stands beside the first, the third at a good angle, the fourth too but sees a tenth.
    centers = cameras_on_a_line([0.0, 0.3, 8.0, 8.0], 4.5)
    sources = choose_sources(score_pairs(points, centers, [everything] * 3 + [everything[:30]]), 10)
    assert [source for source, _ in sources[0]] == [2, 3, 1]
    assert [score for _, score in sources[0]] == sorted((score for _, score in sources[0]), reverse=True)


def test_views_that_share_nothing_are_no_sources() -> None:
    points = np.random.default_rng(1).uniform(-1, 1, (20, 3)) + np.array([0, 0, 5])
    seen = [np.arange(10), np.arange(10), np.arange(10, 20)]
    sources = choose_sources(score_pairs(points, cameras_on_a_line([0, 5, 10], 5.0), seen), 10)
    assert [[source for source, _ in sources[view]] for view in range(3)] == [[1], [0], []]


def test_many_views_score_as_each_pair_alone_does() -> None:
    rng = np.random.default_rng(3)
    points, centers = rng.uniform(0, 9, (5000, 3)), rng.uniform(0, 9, (30, 3))
    # So much in common that a view's partners are not all looked at together, and a view that sees nothing.
    seen = [np.sort(rng.choice(5000, count, replace=False)) for count in rng.integers(1, 5000, 29)]
    seen.insert(7, np.zeros(0, np.int64))
    scores = score_pairs(points, centers, seen)
    for i in range(30):
        for j in range(i):
            alone = score_pairs(points, centers[[j, i]], [seen[j], seen[i]])
            assert scores[i, j] == scores[j, i] == alone[0, 1]
    assert not scores.diagonal().any()


def test_views_far_apart_take_no_time() -> None:
    # Each of 1,500 views along a path shares its points with a few of those beside it.
    points = np.column_stack([np.arange(376_000) * 0.002, np.zeros(376_000), np.full(376_000, 5.0)])
    centers = points[:375_000:250] * [1, 1, 0]
    began = time.process_time()
    scores = score_pairs(points, centers, [np.arange(250 * view, 250 * view + 1000) for view in range(1500)])
    # Each pair by itself takes a quarter of a minute.
    assert time.process_time() - began < 5
    assert np.count_nonzero(scores) == 2 * (1499 + 1498 + 1497)


def test_number_of_sources_is_limited() -> None:
    scores = np.random.default_rng(2).uniform(1, 2, (14, 14))
    np.fill_diagonal(scores, 0)
    assert all(len(found) == 10 and view not in dict(found) for view, found in choose_sources(scores, 10).items())


def model(points: NDArray[np.float64], tracks: NDArray[np.int64] | None = None) -> SparseModel:
    count = len(points)
    tracks = np.full(count, 4, np.int64) if tracks is None else tracks
    return SparseModel(points=points, errors_px=np.full(count, 0.3), track_lengths=tracks, observations={})


K = np.array([[400.0, 0, 319.5], [0, 400, 239.5], [0, 0, 1]])


def in_view(depths: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack([0.1 * depths, 0.1 * depths, depths], axis=1)


def range_of(sparse: SparseModel, seen: NDArray[np.int64]) -> tuple[float, float]:
    found = depth_range(sparse, seen, K, np.eye(4), (640, 480))
    assert found is not None
    return found


def test_depth_range_holds_the_points_with_margins_and_without_outliers() -> None:
    depths = np.linspace(4, 10, 1000)
    depths[0], depths[-1] = 0.01, 1e6
    near, far = range_of(model(in_view(depths)), np.arange(1000))
    assert near == pytest.approx(0.75 * 4.03, rel=0.02)
    assert far == pytest.approx(1.5 * 9.95, rel=0.02)


def test_near_ground_seen_by_others_pulls_the_near_end_in() -> None:
    own = in_view(np.linspace(4, 10, 300))
    ground = in_view(np.linspace(2.4, 3.9, 60))
    points = np.concatenate([own, ground])
    seen = np.arange(300)
    near = range_of(model(points), seen)[0]
    assert 0.75 * 2.3 < near < 0.75 * 2.6
    # Behind the camera or beside the picture they do not count.
    for moved in (points * np.array([1, 1, -1]), points + np.array([100.0, 0, 0])):
        there = np.concatenate([own, moved[300:]])
        assert range_of(model(there), seen)[0] == pytest.approx(0.75 * 4.06, rel=0.01)


def test_weak_points_count_only_when_there_are_no_others() -> None:
    depths = np.concatenate([np.linspace(4, 10, 100), np.full(20, 40.0)])
    tracks = np.concatenate([np.full(100, 3), np.full(20, 2)])
    seen = np.arange(120)
    far = range_of(model(in_view(depths), tracks), seen)[1]
    assert far < 16
    far = range_of(model(in_view(depths), np.full(120, 2)), seen)[1]
    assert far == pytest.approx(60)


def test_far_end_is_limited_and_an_empty_view_has_none() -> None:
    depths = np.concatenate([np.full(50, 2.0), np.full(50, 1000.0)])
    near, far = range_of(model(in_view(depths)), np.arange(100))
    assert far == pytest.approx(SelectionSettings().max_ratio * near)
    behind = in_view(np.full(10, -3.0))
    assert depth_range(model(behind), np.arange(10), K, np.eye(4), (640, 480)) is None
    flat = range_of(model(in_view(np.full(100, 5.0))), np.arange(100))
    assert 0 < flat[0] < 5 < flat[1]
