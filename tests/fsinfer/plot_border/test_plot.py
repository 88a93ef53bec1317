"""Who is in, who is at the border, and how much of a plot was seen."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fsinfer.cli.tables import plot_rows
from fsinfer.notices.notice import notice
from fsinfer.notices.plots import PlotCode
from fsinfer.notices.sentences import sentence
from fsinfer.notices.stems import StemCode
from fsinfer.plot_border.border import Border
from fsinfer.plot_border.plot import Upright, plot_of, sort_trees, stem_circles
from fsinfer.plot_border.rows import figure_rows
from fsinfer.plot_border.sight import Cameras, SeenShare, plot_cells, seen_share, views_of
from fsinfer.scene import Scene
from fsinfer.trees import Ground, Tree
from fsinfer.trees.tree import OUTSIDE
from tests.support.walked_plot import STEMS, UNIT, make_plot

CIRCLE = Border(center=(0.0, 0.0), radius_m=10.0, origin="walk", moves_along=True)
ALL = SeenShare(share=1.0, method="all of it")
NOT = SeenShare(share=0.1, method="hardly")
TREE = Tree(
    tree_id=1, x_m=0.0, y_m=0.0, z_ground_m=0.0, dbh_cm=30.0, dbh_lo95_cm=29.6, dbh_hi95_cm=30.4,
    dbh_perimeter_cm=None, dbh_min_cm=None, dbh_max_cm=None, bh_m=1.3, arc_coverage=1.0, points=100, residual_cm=0.2,
    lean_deg=0.0, height_m=None, status="ok", reasons=(),
)  # fmt: skip


def at(x_m: float, number: int = 1, **more: object) -> Tree:
    return replace(TREE, tree_id=number, x_m=x_m, **more)  # type: ignore[arg-type]


def unmeasured(x_m: float, number: int) -> Tree:
    return at(x_m, number, dbh_cm=None, dbh_lo95_cm=None, dbh_hi95_cm=None, status="unmeasured")


def test_stems_are_in_by_their_centre() -> None:
    trees = sort_trees([at(9.9), at(10.1), at(9.8), at(0.0)], CIRCLE)
    assert [tree.in_plot for tree in trees] == [True, False, True, True]
    assert [tree.border_m for tree in trees] == pytest.approx([0.1, -0.1, 0.2, 10.0])
    # A stem of 15 cm radius that the border cuts.
    assert [tree.at_border for tree in trees] == [True, True, False, False]


def test_an_unsure_place_is_a_border_case_farther_off() -> None:
    wide = at(9.84, dbh_lo95_cm=0.0, dbh_hi95_cm=70.0)
    assert sort_trees([wide], CIRCLE)[0].at_border
    assert not sort_trees([at(9.84)], CIRCLE)[0].at_border
    assert not sort_trees([at(9.7)], CIRCLE)[0].at_border
    # With a scale that is 2 % off a stem 9.7 m from the centre may stand 9.3 to 10.1 m from it ...
    assert sort_trees([at(9.7)], CIRCLE, scale_rel_std=0.02)[0].at_border
    # ... and one that is as near to the border of a small circle round it may not.
    near = Border(center=(9.0, 0.0), radius_m=1.0, origin="walk", moves_along=True)
    assert not sort_trees([at(9.7)], near, scale_rel_std=0.02)[0].at_border
    # Unless that circle was placed by its coordinates.
    fixed = replace(near, moves_along=False)
    assert sort_trees([at(9.7)], fixed, scale_rel_std=0.02)[0].at_border
    assert not sort_trees([at(9.7)], fixed)[0].at_border


def test_the_place_of_a_stem_without_a_diameter_is_known_to_two_decimetres() -> None:
    trees = sort_trees([unmeasured(9.85, 1), unmeasured(10.15, 2), unmeasured(9.75, 3), at(9.83, 4)], CIRCLE)
    assert [tree.at_border for tree in trees] == [True, True, False, False]


def test_a_cloud_that_may_not_stand_upright_is_unsure_of_stems_high_on_a_slope() -> None:
    up = Upright(std_rad=float(np.radians(0.7)), z_m=100.0)
    # 8 m above the middle a stem may stand 1.96 * 0.0122 * 8 = 19 cm aside, as high as the middle it may not.
    high, level = at(9.83, z_ground_m=108.0), at(9.83, 2, z_ground_m=100.0)
    assert [tree.at_border for tree in sort_trees([high, level], CIRCLE, upright=up)] == [True, False]
    assert not sort_trees([high], CIRCLE)[0].at_border
    trees = [at(9.9, z_ground_m=108.0), *(at(0.5 * k, k + 2, z_ground_m=100.0) for k in range(16))]
    steep, flat, own = (
        plot_of(trees, CIRCLE, ALL, slope_deg=slope, upright=given).figures
        for slope, given in ((30.0, up), (0.0, up), (30.0, None))
    )
    for sure, unsure, known in (
        (flat.stems_per_ha, steep.stems_per_ha, own.stems_per_ha),
        (flat.basal_area_m2_per_ha, steep.basal_area_m2_per_ha, own.basal_area_m2_per_ha),
    ):
        assert sure is not None
        assert unsure is not None
        assert known is not None
        expected = 1.96 * np.tan(np.radians(30.0)) * np.radians(0.7) * unsure.value
        assert unsure.parts["which way is up"] == pytest.approx(expected, rel=1e-3)
        assert sure.parts["which way is up"] == known.parts["which way is up"] == 0.0
        # The chance of the stem near the border to be out is that of its place.
        assert unsure.parts["stems at the border"] > 0.0
        assert known.parts["stems at the border"] == pytest.approx(0.0, abs=1e-6)


def test_figures_count_who_is_in() -> None:
    doubtful = at(2.0, 3, status="doubtful", dbh_cm=40.0, dbh_lo95_cm=39.0, dbh_hi95_cm=41.0)
    trees = [at(0.0, 1), at(9.95, 2), doubtful, unmeasured(3.0, 4), at(15.0, 5), at(10.05, 6)]
    plot = plot_of(trees, CIRCLE, ALL, slope_deg=12.0)
    figures = plot.figures
    assert (figures.stems, figures.measured, figures.doubtful, figures.unmeasured) == (4, 3, 1, 1)
    assert (figures.outside, figures.border_cases, figures.slope_deg) == (2, (2, 6), 12.0)
    assert figures.stems_per_ha is not None
    assert figures.basal_area_m2_per_ha is not None
    # The horizontal area of a circle of 10 m, however steep it lies.
    hectares = np.pi * 100 / 10_000
    assert figures.stems_per_ha.value == pytest.approx(4 / hectares)
    assert figures.doubtful_stems_per_ha == pytest.approx(1 / hectares)
    sections = np.pi / 4 * np.array([0.09, 0.09, 0.16])
    assert figures.basal_area_m2_per_ha.value == pytest.approx((sections.sum() + sections.mean()) / hectares)
    assert figures.doubtful_basal_area_m2_per_ha == pytest.approx(sections[2] / hectares)
    assert figures.quadratic_mean_dbh_cm == pytest.approx(np.sqrt((900 + 900 + 1600) / 3))
    (told,) = plot.warnings
    assert sentence(told).endswith("tree 2 (0.05 m in), tree 6 (0.05 m out); measure in the forest whether they are in")
    # In a sheet every name is a row of its own.
    rows = dict(figure_rows(figures))
    assert len(rows) == len(figure_rows(figures))
    assert rows["stems_per_ha"] == figures.stems_per_ha.value
    assert rows["basal_area_m2_lo95_per_ha"] == figures.basal_area_m2_per_ha.lo95
    assert (rows["border_round"], rows["stems_doubtful"]) == ("walk", 1)


def test_the_shared_part_of_diameters_is_in_the_interval_of_basal_area() -> None:
    trees = [at(0.5 * k, k + 1) for k in range(16)]
    own, shared, half = (
        plot_of(trees, CIRCLE, ALL, slope_deg=0.0, shared_m=given).figures.basal_area_m2_per_ha
        for given in (None, np.full(16, 0.4 / 196.0), np.where(np.arange(16) < 8, 0.4 / 196.0, np.nan))
    )
    assert own is not None
    assert shared is not None
    assert half is not None
    assert shared.parts["diameters"] == pytest.approx(np.sqrt(16) * own.parts["diameters"], rel=1e-3)
    # Of stems that another part of the walk measured nobody knows: they are like the others.
    assert half.parts["diameters"] == pytest.approx(shared.parts["diameters"], rel=1e-3)


@pytest.mark.parametrize(
    ("share", "codes", "given"),
    [(0.95, [], True), (0.6, [PlotCode.plot_partly_seen], True), (0.2, [PlotCode.plot_hardly_seen], False)],
)
def test_what_was_not_seen_is_said(share: float, codes: list[PlotCode], given: bool) -> None:
    seen = SeenShare(share=share, method="some of it")
    plot = plot_of([at(0.0), at(1.0, 2, status="doubtful")], CIRCLE, seen, slope_deg=0.0)
    assert [told.code for told in plot.warnings] == codes
    figures = plot.figures
    assert (figures.stems_per_ha is not None) is (figures.basal_area_m2_per_ha is not None) is given
    if figures.stems_per_ha is not None:
        assert figures.stems_per_ha.value == pytest.approx(2 / share / (np.pi * 0.01))
        assert figures.stems_per_ha.hi95 > figures.stems_per_ha.value
        assert figures.doubtful_stems_per_ha == pytest.approx(figures.stems_per_ha.value / 2)


def test_a_border_beside_the_cloud_is_said_to_be_elsewhere() -> None:
    elsewhere = Border(center=(250.0, -3.0), radius_m=10.0, origin="coordinate", moves_along=False)
    plot = plot_of([at(0.0)], elsewhere, SeenShare(share=0.0, method="none of it", ground_share=0.0), slope_deg=0.0)
    (told,) = plot.warnings
    assert told.code == PlotCode.border_elsewhere
    assert "(250.0, -3.0)" in sentence(told)
    assert plot.figures.stems_per_ha is None
    # Ground that no two photographs see is no border elsewhere.
    (told,) = plot_of([at(0.0)], elsewhere, SeenShare(share=0.0, method="by sight"), slope_deg=0.0).warnings
    assert told.code == PlotCode.plot_hardly_seen


def test_stems_outside_of_the_walk_that_stand_in_the_plot_are_told() -> None:
    beyond = (notice(StemCode.outside_walk, nearest_m=9.0),)
    far = [replace(unmeasured(x_m, n), reasons=beyond, status=OUTSIDE) for x_m, n in ((5.0, 2), (30.0, 3))]
    plot = plot_of([at(0.0), *far], CIRCLE, ALL, slope_deg=0.0)
    (told,) = plot.warnings
    assert (told.code, told.values["trees"]) == (PlotCode.outside_walk_in_plot, ("2",))
    assert (plot.figures.stems, plot.figures.unmeasured) == (2, 1)


def test_those_that_were_measured_all_the_same_are_not_to_be_measured() -> None:
    """With --far-stems they count with their own section, and not, as was said, with the mean one of the others."""
    beyond = (notice(StemCode.outside_walk, nearest_m=9.0),)
    trees = [replace(at(0.0), reasons=beyond), at(5.0)]
    assert plot_of(trees, CIRCLE, ALL, slope_deg=0.0).warnings == ()


def test_an_empty_plot_has_figures() -> None:
    plot = plot_of([], CIRCLE, ALL, slope_deg=0.0)
    assert plot.trees == ()
    assert plot.figures.stems_per_ha is not None
    assert (plot.figures.stems_per_ha.value, plot.figures.basal_area_m2_per_ha) == (0.0, None)
    assert stem_circles([]).shape == (0, 3)
    # Nothing stands there, which a mean over plots must count; how thick it would be nobody can say.
    assert dict(figure_rows(plot.figures))["basal_area_m2_per_ha"] == 0.0
    assert plot_rows(plot.figures)[-1].strip() == "basal area m²/ha 0.0 (no stem)"
    for known in (plot_of([unmeasured(0.0, 1)], CIRCLE, ALL, slope_deg=0.0), plot_of([], CIRCLE, NOT, slope_deg=0.0)):
        assert dict(figure_rows(known.figures))["basal_area_m2_per_ha"] is None
        assert "basal area" not in "".join(plot_rows(known.figures))


FLAT = Ground(
    method="plane", plane=np.zeros(3), raster_m=None, origin=np.zeros(2), cell_m=0.4, noise_m=0.01, tolerance_m=0.02,
    share=1.0, plane_share=1.0, points=0,
)  # fmt: skip


def ground_points(low: float, high: float, *, step: float = 0.1) -> np.ndarray:
    x, y = np.meshgrid(np.arange(low, high, step), np.arange(-12, 12, step))
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])


def test_ground_in_the_cloud_is_what_was_seen_without_photos() -> None:
    none = np.zeros((0, 3))
    assert seen_share(CIRCLE, ground_points(-12, 12), FLAT, none).share == 1.0
    half = seen_share(CIRCLE, ground_points(-12, 0), FLAT, none)
    assert half.share == pytest.approx(0.5, abs=0.04)
    # Crowns above it are no ground.
    crowns = ground_points(-12, 12) + np.array([0.0, 0.0, 5.0])
    assert seen_share(CIRCLE, crowns, FLAT, none).share == 0.0
    # On a slope what counts is the height over the ground.
    tilted = replace(FLAT, plane=np.array([0.5, 0.0, 0.0]))
    slope = ground_points(-12, 12)
    slope[:, 2] = 0.5 * slope[:, 0]
    assert seen_share(CIRCLE, slope, tilted, none).share == 1.0


def test_stems_on_ground_that_was_not_seen_stand_for_no_others() -> None:
    # 30 stems, all found, on a plot of 500 m² whose ground is seen within 8 m of its middle only.
    border = replace(CIRCLE, radius_m=12.62)
    radius, angle = 12.5 * np.sqrt((np.arange(30) + 0.5) / 30), 2.4 * np.arange(30)
    trees = [
        replace(TREE, tree_id=k + 1, x_m=float(r * np.cos(a)), y_m=float(r * np.sin(a)))
        for k, (r, a) in enumerate(zip(radius, angle, strict=True))
    ]
    trees[29] = replace(trees[29], status="doubtful")
    ground = ground_points(-12, 12)
    seen = seen_share(border, ground[np.hypot(*ground[:, :2].T) < 8.0], FLAT, stem_circles(trees))
    assert seen.share == pytest.approx(0.41, abs=0.03)
    assert seen.stems is not None
    assert seen.stems[radius < 7.7].all()
    assert not seen.stems[radius > 8.5].any()
    figures = plot_of(trees, border, seen, slope_deg=0.0).figures
    assert (figures.stems, figures.on_unseen) == (30, int((~seen.stems).sum()))
    assert figures.stems_per_ha is not None
    assert figures.basal_area_m2_per_ha is not None
    assert figures.stems_per_ha.value == pytest.approx(600, rel=0.06)
    assert figures.stems_per_ha.lo95 >= 30 / border.area_m2 * 1e4 - 1
    assert figures.stems_per_ha.hi95 < 1000
    assert figures.basal_area_m2_per_ha.value == pytest.approx(600 * np.pi / 4 * 0.09, rel=0.06)
    # The doubtful one stands at the edge of the plot: for itself.
    assert figures.doubtful_stems_per_ha == pytest.approx(1e4 / border.area_m2)
    assert figures.doubtful_basal_area_m2_per_ha == pytest.approx(np.pi / 4 * 0.09 * 1e4 / border.area_m2)
    assert dict(figure_rows(figures))["stems_on_unseen_ground"] == figures.on_unseen


@pytest.fixture(scope="module")
def walked(tmp_path_factory: pytest.TempPathFactory) -> Cameras:
    scene, _ = make_plot(tmp_path_factory.mktemp("walked"), {})
    return Cameras(scene=scene, cloud_from_scene=np.diag([UNIT, UNIT, UNIT, 1.0]))


def test_cameras_stand_where_the_photos_were_taken(walked: Cameras) -> None:
    np.testing.assert_allclose(np.hypot(*walked.places[:, :2].T), 5.0)
    np.testing.assert_allclose(walked.places[:, 2], 1.5)


def one_view(walked: Cameras) -> Cameras:
    return replace(walked, scene=Scene(folder=Path(), views=walked.scene.views[:1]))


def test_a_stem_hides_what_is_behind_it(walked: Cameras) -> None:
    # The first camera stands at (5, 0) and looks at the middle.
    cells = np.array([[0.0, 0.0], [3.0, 0.0], [-2.0, 0.0], [-2.0, 1.0], [7.0, 0.0], [0.0, 4.9]])
    alone = views_of(cells, np.zeros(6), np.zeros((0, 3)), one_view(walked))
    assert alone.tolist() == [1, 1, 1, 1, 0, 0]  # what is behind it, or beside its picture, is not looked at
    stem = np.array([[1.0, 0.0, 0.3]])
    hidden = views_of(cells, np.zeros(6), stem, one_view(walked))
    assert hidden.tolist() == [0, 1, 0, 1, 0, 0]
    # Where it stands itself it was seen.
    own = np.array([[1.0, 0.0], [0.8, 0.0]])
    assert views_of(own, np.zeros(2), stem, one_view(walked)).tolist() == [1, 1]
    # Farther than the view looks for depth, there is none.
    far = replace(walked.scene.views[0], camera=replace(walked.scene.views[0].camera, depth_max=4.0 / UNIT))
    near_only = replace(walked, scene=Scene(folder=Path(), views=(far,)))
    assert views_of(cells, np.zeros(6), np.zeros((0, 3)), near_only).tolist() == [0, 1, 0, 0, 0, 0]


def test_what_many_stems_hide_is_what_lies_behind_one(walked: Cameras) -> None:
    rng = np.random.default_rng(4)
    cells, stems = (
        rng.uniform(-6, 6, (400, 2)),
        np.column_stack([rng.uniform(-6, 6, (60, 2)), rng.uniform(0.02, 1, 60)]),
    )
    stems[0] = [*walked.places[0, :2], 0.3]  # round the first camera, which sees nothing past it
    expected = np.zeros(400, np.int64)
    for view, eye in zip(walked.scene.views, walked.places[:, :2], strict=True):
        one = Cameras(scene=Scene(folder=Path(), views=(view,)), cloud_from_scene=walked.cloud_from_scene)
        seen = views_of(cells, np.zeros(400), np.zeros((0, 3)), one)
        for number, cell in enumerate(cells):
            way = (cell - eye) / np.hypot(*(cell - eye))
            along = (stems[:, :2] - eye) @ way
            across = np.abs((stems[:, :2] - eye) @ [-way[1], way[0]])
            behind = (along > 0) & (across < stems[:, 2]) & (along + stems[:, 2] < np.hypot(*(cell - eye)))
            expected[number] += seen[number] and not behind.any()
    assert expected.sum() > 0
    assert views_of(cells, np.zeros(400), stems, walked).tolist() == expected.tolist()


def test_a_hectare_of_stems_is_no_matter_of_gigabytes(walked: Cameras) -> None:
    rng = np.random.default_rng(5)
    cells, stems = (
        rng.uniform(-3, 3, (40_000, 2)),
        np.column_stack([rng.uniform(-50, 50, (3000, 2)), np.full(3000, 0.1)]),
    )
    tracemalloc.start()
    views_of(cells, np.zeros(len(cells)), stems, one_view(walked))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 100e6


def test_two_photos_must_look_at_a_place(walked: Cameras) -> None:
    points = ground_points(-12, 12)
    border = Border(center=(0.0, 0.0), radius_m=4.0, origin="walk", moves_along=True)
    stems = np.array(STEMS)
    assert seen_share(border, points, FLAT, stems, cameras=[one_view(walked)]).share == 0.0
    whole = seen_share(border, points, FLAT, stems, cameras=[walked])
    assert whole.share == 1.0
    assert "fewer than 2 photos" in whole.method
    # A stem does not hide itself; one that stands where one photo looks only is not on seen ground.
    assert whole.stems is not None
    assert whole.stems.tolist() == [True] * 5 + [False]  # the last one stands outside of the walk and the plot
    alone = seen_share(border, points, FLAT, stems, cameras=[one_view(walked)]).stems
    assert alone is not None
    assert not alone.any()
    # A walk along one side, and a thick stem in the middle.
    side = replace(walked, scene=Scene(folder=Path(), views=walked.scene.views[:3]))
    shadow = seen_share(border, points, FLAT, np.array([[1.0, 0.4, 0.8]]), cameras=[side]).share
    open_view = seen_share(border, points, FLAT, np.zeros((0, 3)), cameras=[side]).share
    assert 0.2 < shadow < open_view - 0.1


def test_cells_fill_the_border() -> None:
    for radius in (0.6, 12.62, 300.0):
        border = replace(CIRCLE, radius_m=radius)
        cells = plot_cells(border)
        assert 0 < len(cells) <= 42_000
        assert (border.inside_m(cells) > 0).all()
