import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from fsinfer.trees import find_stems
from fsinfer.trees.cylinder.axis import Axis, axis_coordinates, fit_axis
from fsinfer.trees.height import axis_path
from fsinfer.trees.points.cells import PlanIndex
from fsinfer.trees.search.find import _in_order, _resolve_overlaps
from fsinfer.trees.search.giants import find_giants
from fsinfer.trees.search.stem import Stem, StemSettings
from tests.support.stem_clouds import board, post, stem_plot
from tests.support.time_limit import within


def test_every_stem_is_found_between_shrubs() -> None:
    plot = stem_plot(
        seed=3, trees=16, spacing_m=0.018, top_m=3.0, sigma_m=0.01, outliers=0.1, hidden=0.3, shrubs=20, ground=False
    )
    found = find_stems(plot.points).stems
    centers = np.array([stem.axis.center_at(1.3) for stem in found])
    distance = np.linalg.norm(plot.xy[:, None] - centers[None], axis=2)
    assert len(found) == 16
    assert distance.min(axis=1).max() < 0.03


def test_looking_ahead_finds_the_stems_of_one_round_after_the_other(monkeypatch: pytest.MonkeyPatch) -> None:
    plot = stem_plot(seed=3, trees=20, sigma_m=0.012, shrubs=12, outliers=0.1, hidden=0.3)
    ahead = find_stems(plot.points)
    monkeypatch.setattr("fsinfer.trees.search.find.TOGETHER", 1)
    in_turn = find_stems(plot.points)
    assert len(ahead.stems) == len(in_turn.stems) > 15
    assert ahead.rejected == in_turn.rejected
    for stem, same in zip(ahead.stems, in_turn.stems, strict=True):
        np.testing.assert_allclose(stem.axis.parameters, same.axis.parameters, atol=1e-6)


def test_a_walk_along_a_road_asks_for_no_memory_of_the_land_beside_it() -> None:
    """The box of a walk of 280 m holds two hundred million cells, of which a few thousand are occupied."""
    plot = stem_plot(seed=5, trees=1, spacing_m=0.012, sigma_m=0.004, ground=False)
    ends = [plot.points, plot.points + np.array([200.0, 200.0, 0.0])]
    tracemalloc.start()
    try:
        found = find_stems(np.concatenate(ends)).stems
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    centers = np.array([stem.axis.center_at(1.3) for stem in found])
    np.testing.assert_allclose(centers, [plot.xy[0], plot.xy[0] + 200.0], atol=0.01)
    assert most < 6e8


@pytest.mark.parametrize("cells", [0, 10**9])
def test_stems_do_not_hang_on_how_cells_are_counted(monkeypatch: pytest.MonkeyPatch, cells: int) -> None:
    plot = stem_plot(seed=3, trees=16, sigma_m=0.012, shrubs=12, hidden=0.3)
    usual = find_stems(plot.points)
    monkeypatch.setattr("fsinfer.trees.search.hough.MAX_TABLE", cells)
    other = find_stems(plot.points)
    assert len(usual.stems) > 12
    assert (other.candidates, other.rejected) == (usual.candidates, usual.rejected)
    for stem, same in zip(usual.stems, other.stems, strict=True):
        np.testing.assert_array_equal(stem.axis.parameters, same.axis.parameters)


def test_leaning_stem_keeps_its_axis() -> None:
    plot = stem_plot(seed=5, trees=1, spacing_m=0.012, sigma_m=0.004, lean_deg=12.0, ground=False)
    (stem,) = find_stems(plot.points).stems
    np.testing.assert_allclose(stem.axis.center_at(1.3), plot.xy[0], atol=0.01)


def test_shrubs_alone_are_no_stems() -> None:
    rng = np.random.default_rng(0)
    blobs = [rng.normal(0, 1, (2500, 3)) * [0.3, 0.3, 0.5] + [*rng.uniform(0, 8, 2), 1.0] for _ in range(8)]
    assert find_stems(np.concatenate(blobs)).stems == ()


@pytest.mark.parametrize("sigma_m", [0.003, 0.008])
def test_post_and_board_are_no_trees(sigma_m: float) -> None:
    rng = np.random.default_rng(1)
    plot = stem_plot(seed=2, trees=4, spacing_m=0.018, top_m=3.0, sigma_m=sigma_m, ground=False)
    things = [
        post(rng, at=(6.0, 6.0), width_m=0.05, top_m=1.6, sigma_m=sigma_m),
        board(rng, at=(7.0, 2.0), sigma_m=sigma_m),
    ]
    assert len(find_stems(np.concatenate([plot.points, *things])).stems) == 4


def test_axis_coordinates_measure_the_distance_to_the_line() -> None:
    rng = np.random.default_rng(2)
    points = rng.normal(0, 1, (50, 3))
    parameters = np.array([0.1, -0.2, 0.2, -0.1, 0.15, 0.0])
    direction = np.array([0.2, -0.1, 1.0]) / np.linalg.norm([0.2, -0.1, 1.0])
    expected = np.linalg.norm(np.cross(points - [0.1, -0.2, 1.3], direction), axis=1)
    offsets, _ = axis_coordinates(points, parameters, 1.3)
    np.testing.assert_allclose(np.linalg.norm(offsets, axis=1), expected, atol=1e-12)


def test_outward_tail_does_not_pull_the_radius() -> None:
    rng = np.random.default_rng(3)
    angle, height = rng.uniform(0, 2 * np.pi, 3000), rng.uniform(0.9, 1.7, 3000)
    tail = np.where(rng.random(3000) < 0.2, rng.exponential(0.03, 3000), 0.0)
    rho = 0.15 + rng.normal(0, 0.008, 3000) + tail
    points = np.column_stack([rho * np.cos(angle), rho * np.sin(angle), height])
    fit = fit_axis(points, np.array([0.02, 0.0, 0.0, 0.0, 0.13, 0.0]), 1.3)
    assert abs(fit.radius_m - 0.15) < 0.001
    assert np.mean(rho) > 0.155  # what a plain mean would say


def _leaning(x_m: float, y_m: float, slope: float) -> Stem:
    axis = Axis(parameters=np.array([x_m, y_m, slope, 0.0, 0.15, 0.0]), height_m=1.3, sigma_m=0.004)
    return Stem(axis=axis, bottom_m=0.5, top_m=2.5, length_m=2.0, arc_coverage=1.0, quality=1.0)


def test_neighbours_and_crowns_follow_the_breast_height_that_was_asked_for() -> None:
    # Far apart, and leaning so that their order from west to east is another at 2 m than at 1.3 m.
    stems = [_leaning(0.0, 0.0, 0.3), _leaning(0.1, 9.0, -0.3)]
    nothing = PlanIndex(np.zeros((0, 3)), 0.5)
    for bh_m, order in ((1.3, [0.0, 9.0]), (2.0, [9.0, 0.0])):
        kept = _in_order(_resolve_overlaps(stems, nothing, 0.015, bh_m, StemSettings()), bh_m)
        assert [stem.axis.parameters[1] for stem in kept] == order
    # Touching at breast height or not: at 1.3 m these two stand apart, at 2.1 m on the same place.
    crossing = [_leaning(0.0, 0.0, 0.3), replace(_leaning(0.48, 0.0, -0.3), quality=0.9)]
    assert len(_resolve_overlaps(crossing, nothing, 0.015, 2.1, StemSettings())) == 1
    path = axis_path(stems[0], 11.3, bh_m=1.3)
    np.testing.assert_allclose(path[0], [-0.3 * 0.15, 0.0])
    np.testing.assert_allclose(axis_path(stems[0], 11.3, bh_m=2.0)[0], [0.7 * 0.3 - 1.0 * 0.15, 0.0])


def test_thousands_of_stems_are_told_apart_in_seconds() -> None:
    """Each against each, and each against all points, would be minutes of a few hectares."""
    stems = [_leaning(2.0 * (n % 50), 2.0 * (n // 50), 0.0) for n in range(4000)]
    rng = np.random.default_rng(2)
    points = np.column_stack([rng.uniform(0.0, 160.0, (400_000, 2)), rng.uniform(0.5, 2.5, 400_000)])
    with within(20):
        assert len(_resolve_overlaps(stems, PlanIndex(np.zeros((0, 3)), 0.5), 0.015, 1.3, StemSettings())) == 4000
        assert find_giants(points, stems, 0.1, StemSettings()) == ()
