"""From a cloud to the stand table: frames, units, and one sentence on why there is nothing where there is nothing."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.errors import CloudError
from fsinfer.notices.notice import notice
from fsinfer.notices.sentences import sentence
from fsinfer.notices.stems import StemCode
from fsinfer.trees import PlotResult, TreeSettings, analyse_plot, measure_trees
from fsinfer.trees.measure import near_plot, trees_found
from tests.support.stem_clouds import StemPlot, stem_plot


@pytest.fixture(scope="module")
def plot() -> StemPlot:
    return stem_plot(seed=3, trees=2, spacing_m=0.03, top_m=3.0, slope=0.1, bumps_m=0.3)


@pytest.fixture(scope="module")
def result(plot: StemPlot) -> PlotResult:
    return analyse_plot(plot.points)


def ground(seed: int = 0, count: int = 8000) -> NDArray[np.float64]:
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(0, 8, (count, 2)), rng.normal(0, 0.01, count)])


def test_trees_stand_where_they_are_on_their_own_ground(plot: StemPlot, result: PlotResult) -> None:
    assert result.diagnosis == notice(StemCode.trees_found, trees=2, measured=2) == trees_found(result.trees)
    assert result.ground is not None
    assert result.ground.method == "plane + raster"
    assert len(result.sections) == 2
    for tree in result.trees:
        nearest = plot.stem_at(tree.x_m, tree.y_m)
        assert tree.dbh_cm == pytest.approx(plot.dbh_cm[nearest], abs=0.5)
        assert np.hypot(*(plot.xy[nearest] - [tree.x_m, tree.y_m])) < 0.02
        assert tree.z_ground_m == pytest.approx(plot.z_ground[nearest], abs=0.02)
    assert measure_trees(plot.points) == list(result.trees)


def test_a_cloud_too_thin_to_show_every_stem_is_told(plot: StemPlot, result: PlotResult) -> None:
    assert StemCode.far_apart not in {warning.code for warning in result.warnings}
    few = plot.points[np.random.default_rng(2).uniform(size=len(plot.points)) < 0.12]
    found = analyse_plot(few, turned=True)
    assert found.spacing_m > 0.032
    (warning,) = (item for item in found.warnings if item.code == StemCode.far_apart)
    assert f"lie {100 * found.spacing_m:.1f} cm apart" in sentence(warning)
    assert "thinned less" in sentence(warning)


def test_the_grid_of_a_country_moves_everything_and_changes_nothing_else(plot: StemPlot, result: PlotResult) -> None:
    shift = np.array([600_000.0, 5_400_000.0, 0.0])
    moved = analyse_plot(plot.points + shift)
    for before, after in zip(result.trees, moved.trees, strict=True):
        assert (after.x_m, after.y_m) == pytest.approx((before.x_m + shift[0], before.y_m + shift[1]), abs=0.002)
        assert after.dbh_cm == pytest.approx(before.dbh_cm, abs=0.02)
        assert after.z_ground_m == pytest.approx(before.z_ground_m, abs=0.01)
    np.testing.assert_allclose(moved.extent_m, np.array(result.extent_m) + np.tile(shift[:2], 2), atol=0.01)
    assert moved.plot_area_m2 == pytest.approx(result.plot_area_m2, rel=0.05)


def test_without_a_scale_there_are_places_but_no_sizes(plot: StemPlot, result: PlotResult) -> None:
    units = analyse_plot(plot.points / 4, metric=False, units_per_m_hint=0.25)
    assert units.units_per_m == 0.25
    assert units.plot_area_m2 == 0.0
    assert units.warnings[-1].code == StemCode.model_units
    for tree, metric in zip(units.trees, result.trees, strict=True):
        assert (tree.dbh_cm, tree.height_m, tree.residual_cm, tree.status) == (None, None, None, "unmeasured")
        assert tree.z_ground_m == pytest.approx(metric.z_ground_m / 4, abs=0.005)
        assert (tree.x_m, tree.y_m) == pytest.approx((metric.x_m / 4, metric.y_m / 4), abs=0.005)


@pytest.mark.parametrize("hint", [0.0, -1.0, float("nan"), float("inf")])
def test_a_guess_of_the_scale_that_is_no_length_is_refused(hint: float) -> None:
    with pytest.raises(CloudError, match="units_per_m_hint"):
        analyse_plot(ground(), metric=False, units_per_m_hint=hint)


def test_an_unknown_rule_of_breast_height_is_refused() -> None:
    with pytest.raises(CloudError, match="'midpoint' or 'uphill', got 'downhill'"):
        analyse_plot(ground(), settings=TreeSettings(bh_rule="downhill"))


@pytest.mark.parametrize("bh_m", [130.0, 4.5, 0.0, -1.0, float("nan")])
def test_a_breast_height_in_other_units_is_refused(bh_m: float) -> None:
    with pytest.raises(CloudError, match="give breast height in metres"):
        analyse_plot(ground(), settings=TreeSettings(bh_m=bh_m))


@pytest.mark.parametrize("scale_rel_std", [-0.01, float("nan"), float("inf")])
def test_an_error_of_the_scale_that_is_none_is_refused(scale_rel_std: float) -> None:
    with pytest.raises(CloudError, match="scale_rel_std"):
        analyse_plot(ground(), scale_rel_std=scale_rel_std)


def test_the_diagnosis_says_what_the_cloud_lacks() -> None:
    rng = np.random.default_rng(1)
    # Known to stand upright, so that nobody looks at it from its other sides.
    bare = analyse_plot(ground(), turned=True)
    assert bare.trees == ()
    assert "hardly a point lies 0.5-2.5 m above the ground (the cloud reaches 0.0" in sentence(bare.diagnosis)
    floating = np.column_stack([rng.uniform(0, 8, (2000, 2)), rng.uniform(0.5, 2.5, 2000)])
    leaves = analyse_plot(np.concatenate([ground(), floating]), turned=True)
    assert leaves.trees == ()
    assert sentence(leaves.diagnosis).startswith("no trees found: ")
    assert "hardly a point" not in sentence(leaves.diagnosis)
    # A roof of leaves with nothing below it.
    roof = np.column_stack([rng.uniform(0, 8, (2000, 2)), rng.uniform(6.0, 9.0, 2000)])
    assert "hardly a point lies 0.5-2.5 m above the ground" in sentence(
        analyse_plot(np.concatenate([ground(), roof]), turned=True).diagnosis
    )


def test_thin_stems_are_left_to_the_undergrowth(plot: StemPlot, result: PlotResult) -> None:
    sizes = sorted(tree.dbh_cm for tree in result.trees if tree.dbh_cm is not None)
    limit = replace(TreeSettings(), min_dbh_cm=sum(sizes) / 2)
    (kept,) = analyse_plot(plot.points, settings=limit).trees
    assert kept.dbh_cm == pytest.approx(sizes[1])
    assert kept.tree_id == 1


@pytest.mark.parametrize("points", ["plot.laz", [[1.0, 2.0, "high"]], [[1.0, 2.0], [3.0]], None])
@pytest.mark.parametrize("metric", [True, False])
def test_what_is_no_array_of_numbers_is_refused(points: Any, metric: bool) -> None:
    with pytest.raises(CloudError, match=r"\(N, 3\)"):
        measure_trees(points, metric=metric)


@pytest.mark.parametrize("shape", [(6000,), (2000, 2), (2000, 4), (20, 100, 3)])
def test_an_array_of_another_shape_is_no_cloud(shape: tuple[int, ...]) -> None:
    points = np.random.default_rng(0).uniform(0.0, 10.0, shape)
    with pytest.raises(CloudError, match=r"array of shape \(N, 3\)"):
        measure_trees(points)


@pytest.mark.parametrize("moved", [(0.0, 0.0, 0.0), (4.5e5, 5.4e6, 800.0)])
def test_strays_are_told_wherever_the_plot_lies_and_whichever_point_comes_first(
    moved: tuple[float, float, float],
) -> None:
    # A strip of 10 m by 2 m; as far beside it as half its length and two metres more may be crowns of its trees.
    box = np.array([[0.0, 0.0], [10.0, 2.0]])
    strays = np.array([[5.0, 1.0, 3e4], [5.0, 10.0, 0.0], [-8.0, 1.0, 0.0], [900.0, 1.0, 0.0]])
    beside = np.array([[5.0, 8.5, 0.0], [-6.5, 1.0, 5.0]])
    inside = np.random.default_rng(0).uniform([0.0, 0.0, 0.0], [10.0, 2.0, 20.0], (500, 3))
    points = np.concatenate([strays, beside, inside]) + moved
    near = near_plot(points, box + moved[:2])
    assert near.tolist() == [False] * 4 + [True] * 502
