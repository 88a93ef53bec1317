from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from fsinfer.notices.notice import notice
from fsinfer.notices.stems import StemCode
from fsinfer.trees import PlotResult, TreeSettings, analyse_plot
from fsinfer.trees.diameter.dbh import measure_together
from fsinfer.trees.diameter.dbh_settings import DbhSettings
from fsinfer.trees.search.find import find_stems
from fsinfer.trees.tree import Tree
from tests.support.stem_clouds import StemPlot, stem_plot, wall


def _compare(plot: StemPlot, result: PlotResult) -> tuple[NDArray[np.float64], NDArray[np.float64], int, int]:
    """Errors (cm), half widths of the intervals (cm), trees found, false trees."""
    xy = np.array([[tree.x_m, tree.y_m] for tree in result.trees])
    distance = np.linalg.norm(xy[:, None] - plot.xy[None], axis=2)
    i, j = linear_sum_assignment(distance)
    near = distance[i, j] < 0.3
    pairs = [(result.trees[a], plot.dbh_cm[b]) for a, b in zip(i[near], j[near], strict=True)]
    error = np.array([tree.dbh_cm - truth for tree, truth in pairs if tree.dbh_cm is not None])
    half = np.array([interval_cm(tree) / 2 for tree, _ in pairs if tree.dbh_cm is not None])
    return error, half, int(near.sum()), int(len(xy) - near.sum())


def interval_cm(tree: Tree) -> float:
    """Width of the interval."""
    assert tree.dbh_lo95_cm is not None
    assert tree.dbh_hi95_cm is not None
    return tree.dbh_hi95_cm - tree.dbh_lo95_cm


def test_lidar_like_plot() -> None:
    plot = stem_plot(seed=0, trees=25, spacing_m=0.02, sigma_m=0.003, slope=0.1, top_m=3.0)
    error, half, found, false = _compare(plot, analyse_plot(plot.points))
    assert (found, false, len(error)) == (25, 0, 25)
    assert np.sqrt(np.mean(error**2)) <= 0.4
    assert abs(error.mean()) <= 0.2
    assert np.mean(np.abs(error) <= half) >= 0.9


@pytest.mark.parametrize(("sigma_m", "seed"), [(0.010, 1), (0.015, 2)])
def test_photogrammetric_plot(sigma_m: float, seed: int) -> None:
    plot = stem_plot(
        seed=seed,
        trees=25,
        spacing_m=0.018,
        sigma_m=sigma_m,
        outliers=0.1,
        hidden=1 / 3,
        shrubs=10,
        flyers=1000,
        top_m=3.0,
    )
    error, half, found, false = _compare(plot, analyse_plot(plot.points))
    assert found >= 24
    assert false == 0
    assert np.sqrt(np.mean(error**2)) <= 1.0
    assert abs(error.mean()) <= 0.4
    assert np.mean(np.abs(error) <= half) >= 0.88
    assert half.mean() < 1.5


def _single(
    seed: int = 0,
    *,
    extra: Callable[[np.random.Generator], NDArray[np.float64]] | None = None,
    radius: float = 0.15,
    sigma_m: float = 0.004,
    **kwargs: float,
) -> NDArray[np.float64]:
    """One stem in the middle of flat ground."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-3.0, 3.0, (20000, 2))
    ground = np.column_stack([xy, rng.normal(0.0, 0.005, len(xy))])
    stem = wall(rng, radius=radius, **kwargs)
    parts = [ground, stem + rng.normal(0.0, sigma_m, stem.shape)]
    if extra is not None:
        parts.append(extra(rng))
    return np.concatenate(parts)


def test_a_sliver_is_found_but_not_measured() -> None:
    (tree,) = analyse_plot(_single(arc_deg=50.0)).trees
    assert tree.dbh_cm is None
    assert tree.dbh_lo95_cm is None
    assert tree.status == "unmeasured"
    assert [why.code for why in tree.reasons] == [StemCode.too_little_seen]
    assert tree.reasons[0].values["seen_deg"] == pytest.approx(50.0, abs=15.0)


def test_a_stem_that_cannot_be_measured_shows_what_points_there_are() -> None:
    cloud = _single()
    (stem,) = find_stems(cloud).stems
    there = cloud[np.abs(cloud[:, 2] - 1.3) < 0.08][:7]
    above = cloud[np.abs(cloud[:, 2] - 1.5) < 0.05][:4]
    (section,) = measure_together([np.concatenate([there, above])], [stem])
    assert section.dbh_m is None
    assert section.reasons == (notice(StemCode.too_few_at_breast_height, least=12),)
    np.testing.assert_allclose(section.offsets_m + section.center, there[:, :2], atol=1e-9)
    assert not section.kept.any()
    assert len(section.kept) == len(there)


def test_without_a_scale_positions_and_extent_are_in_the_clouds_units() -> None:
    cloud = _single()
    metric = analyse_plot(cloud)
    units = analyse_plot(cloud * 0.2, metric=False, units_per_m_hint=0.2)
    assert metric.units_per_m is None
    assert units.units_per_m == 0.2
    np.testing.assert_allclose(units.extent_m, 0.2 * np.array(metric.extent_m), rtol=1e-6)
    assert units.trees[0].x_m == pytest.approx(0.2 * metric.trees[0].x_m, abs=1e-3)


def test_half_a_stem_is_measured_with_a_wider_interval() -> None:
    (half,) = analyse_plot(_single(arc_deg=150.0)).trees
    (whole,) = analyse_plot(_single()).trees
    assert half.dbh_cm == pytest.approx(30.0, abs=1.0)
    assert whole.dbh_cm == pytest.approx(30.0, abs=0.3)
    assert interval_cm(half) > 1.5 * interval_cm(whole)
    assert half.arc_coverage == pytest.approx(150 / 360, abs=0.06)
    assert half.dbh_perimeter_cm is None


def test_bark_unseen_sides_and_noise_are_in_the_budget() -> None:
    """Each a share of what it comes from; unseen sides are the most of a stem seen from one side."""
    (whole,), (half,) = (analyse_plot(_single(arc_deg=arc)).sections for arc in (360.0, 150.0))
    for section in (whole, half):
        radius = float(section.circle_m[2])
        assert section.parts_m["bark"] == pytest.approx(0.005 * radius)
        assert section.parts_m["hidden"] == pytest.approx(0.042 * (1.0 - section.coverage) * radius)
        assert section.parts_m["noise"] == pytest.approx(0.1 * section.residual_m)
        assert section.sd_m == pytest.approx(2.0 * np.sqrt(sum(part**2 for part in section.parts_m.values())))
        assert section.dof > 3.0
        # What all stems of a plot err by together: not what the fit, the slice and the shape leave open, nor the scale.
        alone = 2.0 * np.linalg.norm([section.parts_m[name] for name in ("fit", "local", "oval", "shape")])
        assert section.shared_sd_m == pytest.approx(np.sqrt(section.sd_m**2 - alone**2))
    assert half.parts_m["hidden"] > 0.003 > whole.parts_m["hidden"]


def test_double_wall_is_refused() -> None:
    def second(rng: np.random.Generator) -> NDArray[np.float64]:
        copy = wall(rng, radius=0.18)
        return copy + rng.normal(0.0, 0.004, copy.shape)

    (tree,) = analyse_plot(_single(extra=second)).trees
    assert tree.dbh_cm is None
    assert [why.code for why in tree.reasons] == [StemCode.double_wall]
    assert tree.reasons[0].values["gap_cm"] == pytest.approx(3.0, abs=0.5)


def two_scans(shift_m: float, *, arc_deg: float = 360.0, dbh_m: float = 0.30) -> NDArray[np.float64]:
    """A stem that was scanned twice, the second time ``shift_m`` along x; of each an arc."""

    def second(rng: np.random.Generator) -> NDArray[np.float64]:
        copy = wall(rng, radius=dbh_m / 2, arc_deg=arc_deg)
        return copy + rng.normal(0.0, 0.004, copy.shape) + [shift_m, 0.0, 0.0]

    return _single(radius=dbh_m / 2, arc_deg=arc_deg, extra=second)


@pytest.mark.parametrize("shift_cm", [2.5, 3.0, 4.5])
def test_a_stem_scanned_twice_a_shift_apart_has_a_doubtful_diameter(shift_cm: float) -> None:
    (tree,) = analyse_plot(two_scans(shift_cm / 100.0)).trees
    assert tree.status == "doubtful"
    assert StemCode.double_wall in {why.code for why in tree.reasons}
    assert tree.dbh_cm == pytest.approx(30.0, abs=0.3)
    assert 0.5 * shift_cm < interval_cm(tree) < shift_cm
    assert (tree.dbh_min_cm, tree.dbh_max_cm) == (None, None)


def test_of_halves_a_shift_apart_less_is_known() -> None:
    (half,) = analyse_plot(two_scans(0.03, arc_deg=230.0)).trees
    assert half.status == "doubtful"
    assert half.dbh_cm == pytest.approx(30.0, abs=2.0)
    assert interval_cm(half) > 1.7 * 3.0


@pytest.mark.parametrize("arc_deg", [180.0, 230.0, 270.0, 300.0, 360.0])
def test_bark_that_stands_off_is_no_second_scan(arc_deg: float) -> None:
    def second(rng: np.random.Generator) -> NDArray[np.float64]:
        copy = wall(rng, radius=0.18, arc_deg=arc_deg)
        return copy + rng.normal(0.0, 0.004, copy.shape)

    (tree,) = analyse_plot(_single(extra=second)).trees
    assert (tree.dbh_cm, tree.status) == (None, "unmeasured")
    assert tree.reasons[0].code == StemCode.double_wall


def test_of_a_thin_stem_two_scans_tell_less() -> None:
    (thin,) = analyse_plot(two_scans(0.03, dbh_m=0.12)).trees
    assert thin.status == "doubtful"
    assert thin.dbh_cm == pytest.approx(12.0, abs=0.5)
    assert interval_cm(thin) > 1.7 * 2.0


@pytest.mark.parametrize("settings", [TreeSettings(dbh=DbhSettings(most_walls_m=0.0)), None])
def test_walls_farther_apart_than_asked_are_refused(settings: TreeSettings | None) -> None:
    (tree,) = analyse_plot(two_scans(0.03 if settings else 0.075, dbh_m=0.40), settings=settings).trees
    assert tree.dbh_cm is None
    assert [why.code for why in tree.reasons] == [StemCode.double_wall]


def test_outline_of_an_oval_stem() -> None:
    (tree,) = analyse_plot(_single(ovality=0.08)).trees
    assert tree.dbh_min_cm == pytest.approx(30.0 * 0.92, abs=0.5)
    assert tree.dbh_max_cm == pytest.approx(30.0 * 1.08, abs=0.5)
    assert tree.dbh_perimeter_cm == pytest.approx(30.0, abs=0.4)


def test_the_points_to_be_drawn_lie_on_the_outline_of_an_oval_stem() -> None:
    (section,) = analyse_plot(_single(ovality=0.08)).sections
    assert section.outline is not None
    seen, curve = section.offsets_m[section.kept], section.outline.curve_m
    away = np.linalg.norm(seen[:, None] - curve, axis=2).min(axis=1)
    assert np.sqrt(np.mean(away**2)) < 1.3 * 0.004
    # Not on a circle, which is as far from them as the stem is from round.
    assert np.linalg.norm(seen, axis=1).std() > 0.006


def test_scale_uncertainty_widens_the_interval() -> None:
    points = _single()
    (sure,) = analyse_plot(points).trees
    (unsure,) = analyse_plot(points, scale_rel_std=0.05).trees
    assert unsure.dbh_cm == sure.dbh_cm
    assert unsure.dbh_cm is not None
    assert unsure.dbh_hi95_cm is not None
    assert unsure.dbh_hi95_cm - unsure.dbh_cm == pytest.approx(1.96 * 0.05 * 30.0, rel=0.1)


def test_breast_height_follows_the_setting() -> None:
    points = _single(taper=-0.02)
    (low,) = analyse_plot(points).trees
    (high,) = analyse_plot(points, settings=TreeSettings(bh_m=1.6)).trees
    assert high.bh_m == pytest.approx(1.6)
    assert low.dbh_cm is not None
    assert high.dbh_cm is not None
    assert low.dbh_cm - high.dbh_cm == pytest.approx(1.2, abs=0.4)


def test_a_hidden_foot_moves_breast_height_up_and_says_so() -> None:
    points = _single()
    near = np.hypot(points[:, 0], points[:, 1]) < 0.4
    points = points[~(near & (points[:, 2] > 0.1) & (points[:, 2] < 1.5))]
    (tree,) = analyse_plot(points).trees
    assert tree.bh_m > 1.5
    assert tree.status == "doubtful"
    assert tree.reasons[0].code == StemCode.above_breast_height
    assert tree.reasons[0].values["off_cm"] == pytest.approx(100.0 * (tree.bh_m - 1.3))


def test_uphill_rule_measures_higher_on_a_slope() -> None:
    plot = stem_plot(seed=4, trees=4, spacing_m=0.02, sigma_m=0.003, slope=0.4, top_m=3.0, dbh_cm=(35.0, 45.0))
    middle = analyse_plot(plot.points)
    uphill = analyse_plot(plot.points, settings=TreeSettings(bh_rule="uphill"))
    assert len(middle.trees) == len(uphill.trees) == 4
    smaller = [
        a.dbh_cm - b.dbh_cm
        for a, b in zip(middle.trees, uphill.trees, strict=True)
        if a.dbh_cm is not None and b.dbh_cm is not None
    ]
    assert len(smaller) == 4
    assert 0.02 < np.mean(smaller) < 0.4


def test_a_blurred_double_wall_is_doubted() -> None:
    plot = stem_plot(seed=6, trees=9, spacing_m=0.02, sigma_m=0.004, top_m=3.0, dbh_cm=(25.0, 35.0))
    # Two poses 3 cm apart, each noisy, leave one thick wall about the first stem.
    rng = np.random.default_rng(0)
    at = plot.xy[0]
    near = (np.hypot(*(plot.points[:, :2] - at).T) < 0.4) & (plot.points[:, 2] > 0.1)
    blurred = plot.points.copy()
    shift = np.where(rng.random(near.sum()) < 0.5, 0.015, -0.015)
    blurred[near, 0] += shift + rng.normal(0.0, 0.008, near.sum())
    trees = analyse_plot(blurred).trees
    first = min(trees, key=lambda tree: np.hypot(tree.x_m - at[0], tree.y_m - at[1]))
    assert first.status in {"doubtful", "unmeasured"}
    assert {StemCode.double_wall, StemCode.rougher_than_others} & {why.code for why in first.reasons}
    assert sum(tree.status == "ok" for tree in trees) == 8
