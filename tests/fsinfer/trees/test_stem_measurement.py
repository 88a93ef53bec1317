"""From sections to rows of the table: units, intervals, doubts, and whose points are whose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from fsinfer.notices.notice import notice
from fsinfer.notices.stems import StemCode
from fsinfer.trees.cylinder.axis import Axis
from fsinfer.trees.diameter.budget import factor95
from fsinfer.trees.diameter.outline import Outline
from fsinfer.trees.diameter.section import Section, unmeasured_section
from fsinfer.trees.ground.ground import Ground
from fsinfer.trees.measure import PlotResult
from fsinfer.trees.search.find import StemSearch
from fsinfer.trees.search.stem import Stem
from fsinfer.trees.settings import TreeSettings
from fsinfer.trees.stem_curve import stem_curves
from fsinfer.trees.stem_measurement import doubt_the_rough, measure_stems, tree_of
from fsinfer.trees.tree import Tree
from tests.support.stem_clouds import wall
from tests.support.time_limit import within

WALL = notice(StemCode.double_wall, gap_cm=3.0)
NONE = unmeasured_section(np.array([2.0, 3.0]), 1.3, (WALL,), radius_m=0.1)
OVAL = Outline(curve_m=np.zeros((0, 2)), girth_diameter_m=0.301, min_diameter_m=0.28, max_diameter_m=0.32)


def section_of(dbh_m: float, sd_m: float, residual_m: float = 0.004) -> Section:
    return replace(
        NONE,
        dbh_m=dbh_m,
        sd_m=sd_m,
        residual_m=residual_m,
        outline=OVAL,
        status="ok",
        reasons=(),
        coverage=0.9,
        points=50,
    )


@given(dbh_m=st.floats(0.04, 2.0), sd_m=st.floats(0.0, 1.5))
def test_the_interval_is_95_per_cent_in_centimetres_and_never_below_nothing(dbh_m: float, sd_m: float) -> None:
    tree = tree_of(section_of(dbh_m, sd_m), 0.0, None, np.zeros(3))
    assert tree.dbh_cm == pytest.approx(100 * dbh_m)
    assert tree.dbh_hi95_cm == pytest.approx(100 * (dbh_m + 1.96 * sd_m))
    assert tree.dbh_lo95_cm == pytest.approx(max(100 * (dbh_m - 1.96 * sd_m), 0.0))
    assert (tree.dbh_perimeter_cm, tree.dbh_min_cm, tree.dbh_max_cm) == pytest.approx((30.1, 28, 32))


@given(dof=st.floats(1.0, 50.0))
def test_few_blocks_of_bark_make_it_student_s_interval(dof: float) -> None:
    tree = tree_of(replace(section_of(0.3, 0.005), dof=dof), 0.0, None, np.zeros(3))
    assert tree.dbh_hi95_cm is not None
    assert tree.dbh_hi95_cm == pytest.approx(30.0 + 0.5 * factor95(dof))
    assert tree.dbh_hi95_cm > 30.0 + 0.5 * 1.96


def test_without_a_diameter_every_size_is_empty_and_the_reason_stays() -> None:
    tree = tree_of(replace(NONE, outline=OVAL), 0.0, None, np.zeros(3))
    sizes = (tree.dbh_cm, tree.dbh_lo95_cm, tree.dbh_hi95_cm, tree.dbh_perimeter_cm, tree.dbh_min_cm, tree.dbh_max_cm)
    assert set(sizes) == {None}
    assert (tree.status, tree.reasons) == ("unmeasured", (WALL,))


def test_a_row_is_in_the_frame_of_the_cloud() -> None:
    tree = tree_of(section_of(0.3, 0.01), 12.5, 21.0, np.array([500_000.0, 5_000_000.0, 0.0]))
    assert (tree.x_m, tree.y_m, tree.z_ground_m, tree.height_m) == (500_002.0, 5_000_003.0, 12.5, 21.0)
    assert tree.residual_cm == pytest.approx(0.4)
    assert (tree.points, tree.arc_coverage, tree.bh_m) == (50, 0.9, 1.3)
    assert tree_of(NONE, 0.0, None, np.zeros(3)).residual_cm is None


def pairs_of(residuals_cm: list[float | None]) -> list[tuple[Tree, Section]]:
    sections = [NONE if r is None else section_of(0.3, 0.01, r / 100) for r in residuals_cm]
    return [(tree_of(section, 0.0, None, np.zeros(3)), section) for section in sections]


def test_a_stem_much_rougher_than_the_others_is_doubted() -> None:
    # The median is 0.5 and the limit 1.7 * 0.5 + 0.3 = 1.15 cm.
    pairs = doubt_the_rough(pairs_of([0.5, 0.4, 0.5, 0.4, 1.1, 1.2, 0.5, None]))
    assert [tree.status for tree, _ in pairs] == ["ok"] * 5 + ["doubtful", "ok", "unmeasured"]
    tree, section = pairs[5]
    assert "residual 1.2 cm" in tree.reason
    assert (section.status, section.reasons) == (tree.status, tree.reasons)
    assert tree.dbh_cm == pytest.approx(30.0)
    # The others may have been asked before.
    late = doubt_the_rough(pairs_of([1.1, 1.2]), beside=[pairs[i][0] for i in (0, 1, 2, 3, 6)])
    assert [tree.status for tree, _ in late] == ["ok", "doubtful"]
    # An earlier reason is kept.
    before = pairs_of([0.5, 0.5, 0.5, 0.5, 1.2])
    before[4] = (replace(before[4][0], reasons=(WALL,)), before[4][1])
    codes = [reason.code for reason in doubt_the_rough(before)[4][0].reasons]
    assert codes == [StemCode.double_wall, StemCode.rougher_than_others]


def test_few_stems_say_nothing_about_what_is_usual() -> None:
    pairs = pairs_of([0.5, 0.5, 0.5, 9.0, None, None])
    assert doubt_the_rough(pairs) == pairs


def slope(per_m: float) -> Ground:
    """Ground that rises along x."""
    return Ground(
        method="plane", plane=np.array([per_m, 0.0, 0.0]), raster_m=None, origin=np.zeros(2), cell_m=0.4, noise_m=0.005,
        tolerance_m=0.02, share=1.0, plane_share=1.0, points=1000,
    )  # fmt: skip


def stem_at(x: float, radius: float) -> Stem:
    axis = Axis(parameters=np.array([x, 0.0, 0.0, 0.0, radius, -0.005]), height_m=1.3, sigma_m=0.004)
    return Stem(axis=axis, bottom_m=0.5, top_m=2.5, length_m=2.0, arc_coverage=1.0, quality=1.0)


def measured(
    stems: dict[float, float], points: NDArray[np.float64], *, ground: Ground | None = None, **options: float | str
) -> list[tuple[Tree, Section]]:
    search = StemSearch(
        stems=tuple(stem_at(x, radius) for x, radius in stems.items()),
        candidates=len(stems),
        rejected={},
        spacing_m=0.01,
    )
    settings = replace(TreeSettings(), **options)  # type: ignore[arg-type]  # mypy checks no fields behind **
    return measure_stems(points, search, ground or slope(0.0), settings, 0.0, np.array([100.0, 200.0, 0.0]))


def stem_points(x: float, radius: float, seed: int = 0, *, taper: float = -0.005) -> NDArray[np.float64]:
    rng = np.random.default_rng(seed)
    points = wall(rng, radius=radius, spacing_m=0.015, taper=taper, top_m=3.0)
    return points + rng.normal(0, 0.003, points.shape) + [x, 0.0, 0.0]


def test_two_stems_that_nearly_touch_keep_their_own_points() -> None:
    points = np.concatenate([stem_points(0.0, 0.15), stem_points(0.32, 0.12, 1)])
    (first, one), (second, other) = measured({0.0: 0.15, 0.32: 0.12}, points)
    assert first.dbh_cm == pytest.approx(30.0, abs=0.4)
    assert second.dbh_cm == pytest.approx(24.0, abs=0.4)
    # Half of the 5 cm between their surfaces, and the noise: beyond, all points are the other's.
    for section, radius in ((one, 0.15), (other, 0.12)):
        assert np.linalg.norm(section.offsets_m, axis=1).max() < radius + 0.03
    assert (first.x_m, first.y_m) == pytest.approx((100.0, 200.0), abs=0.005)
    assert (second.x_m, second.y_m) == pytest.approx((100.32, 200.0), abs=0.005)


@pytest.mark.parametrize(("along_x", "along_y", "per_m"), [(0.3, 0.1, 0.0), (0.1, 0.3, 0.0), (0.6, 0.0, 0.6)])
def test_two_stems_that_lean_beside_each_other_keep_their_own_points(
    along_x: float, along_y: float, per_m: float
) -> None:
    """On a slope the place at breast height above the ground there is another one than above the foot."""
    ground, feet, radii = slope(per_m), (0.0, 0.32), (0.15, 0.12)
    stands, stems = [], []
    for seed, (foot, radius) in enumerate(zip(feet, radii, strict=True)):
        points = stem_points(foot, radius, seed)
        points[:, :2] += np.outer(points[:, 2], [along_x, along_y])
        points[:, 2] += per_m * foot
        stands.append(points - np.column_stack([np.zeros((len(points), 2)), ground.height_at(points[:, :2])]))
        # What the search sees stands on ground made level, which leans more.
        lean = np.array([along_x, along_y]) / (1 - along_x * per_m)
        at = np.array([foot, 0.0]) + 1.3 * lean
        axis = Axis(parameters=np.array([*at, *lean, radius, -0.005]), height_m=1.3, sigma_m=0.004)
        stems.append(replace(stem_at(foot, radius), axis=axis))
    search = StemSearch(stems=tuple(stems), candidates=2, rejected={}, spacing_m=0.01)
    pairs = measure_stems(np.concatenate(stands), search, ground, TreeSettings(), 0.0, np.zeros(3))
    # Circles at every height are an oval across the stem, as much thinner one way as it leans.
    across = 0.5 * (1 + 1 / np.sqrt(1 + along_x**2 + along_y**2))
    for (tree, section), foot, radius in zip(pairs, feet, radii, strict=True):
        assert tree.dbh_cm == pytest.approx(200 * radius * across, abs=0.4)
        assert (tree.x_m, tree.y_m) == pytest.approx((foot + 1.3 * along_x, 1.3 * along_y), abs=0.01)
        assert np.linalg.norm(section.offsets_m, axis=1).max() < radius + 0.03


def test_thin_stems_are_no_trees_but_unmeasured_ones_stay() -> None:
    points = np.concatenate([stem_points(0.0, 0.10), stem_points(3.0, 0.15, 1)])
    pairs = measured({0.0: 0.10, 3.0: 0.15, 6.0: 0.15}, points, min_dbh_cm=25.0)
    assert [round(tree.x_m) for tree, _ in pairs] == [103, 106]
    assert pairs[1][0].dbh_cm is None


def test_on_a_slope_breast_height_counts_from_the_middle_or_from_uphill() -> None:
    # Heights above a ground of 40 % at a stem of 15 cm radius: the uphill side of its foot is 6 cm higher.
    points = stem_points(0.0, 0.15, taper=-0.1)
    points[:, 2] -= 0.4 * points[:, 0]
    ((middle, _),) = measured({0.0: 0.15}, points, ground=slope(0.4))
    ((uphill, _),) = measured({0.0: 0.15}, points, ground=slope(0.4), bh_rule="uphill")
    assert middle.dbh_cm == pytest.approx(30.0, abs=0.4)
    assert uphill.dbh_cm == pytest.approx(30.0 - 2 * 10.0 * 0.4 * 0.15, abs=0.4)


@pytest.mark.parametrize("rule", ["midpoint", "uphill"])
@pytest.mark.parametrize("lean", [0.0, 0.15])
def test_section_place_and_curve_of_a_stem_on_a_slope_count_from_one_level(rule: str, lean: float) -> None:
    """30 degrees, a stem of 50 cm: the highest ground at its foot is 14 cm up, that below a leaning centre 11 cm."""
    per_m, taper = float(np.tan(np.radians(30.0))), -0.02
    points = stem_points(0.0, 0.25, taper=taper)
    points[:, 0] += lean * points[:, 2]
    ground = slope(per_m)
    stand = points - np.column_stack([np.zeros((len(points), 2)), ground.height_at(points[:, :2])])
    # What the search sees stands on ground made level, which leans more.
    stem = stem_at(0.0, 0.25)
    seen = lean / (1 - lean * per_m)
    axis = replace(stem.axis, parameters=np.array([1.3 * seen, 0.0, seen, 0.0, 0.25, taper]))
    search = StemSearch(stems=(replace(stem, axis=axis),), candidates=1, rejected={}, spacing_m=0.01)
    settings = replace(TreeSettings(), bh_rule=rule)
    ((tree, section),) = measure_stems(stand, search, ground, settings, 0.0, np.zeros(3))
    level = per_m * 0.25 if rule == "uphill" else 0.0
    assert tree.z_ground_m == pytest.approx(level, abs=1e-9)
    # The row's own height is where the stem has the row's place and diameter.
    z = tree.z_ground_m + tree.bh_m
    assert tree.x_m == pytest.approx(lean * z, abs=0.004)
    assert tree.dbh_cm == pytest.approx(200 * (0.25 + taper * (z - 1.3)), abs=0.4)
    tree = replace(tree, tree_id=1)
    plot = PlotResult(
        trees=(tree,), sections=(section,), ground=ground, diagnosis=WALL, warnings=(), extent_m=(-1, -1, 1, 1),
        spacing_m=0.01,
    )  # fmt: skip
    two = next(point for point in stem_curves(points, plot)[1] if point.height_m == 2.0)
    assert two.diameter_cm == pytest.approx(200 * (0.25 + taper * (tree.z_ground_m + 2.0 - 1.3)), abs=0.4)


@pytest.mark.parametrize("rule", ["midpoint", "uphill"])
@pytest.mark.parametrize("lean", [-0.1, 0.0, 0.1])
def test_a_tree_that_leans_over_a_slope_is_as_high_as_it_stands_above_its_foot(lean: float, rule: str) -> None:
    per_m, rng = float(np.tan(np.radians(30.0))), np.random.default_rng(4)
    share, angle = np.sqrt(rng.uniform(0, 1, 6000)), rng.uniform(0, 2 * np.pi, 6000)
    reach = 1.2 * share * np.sqrt(rng.uniform(0, 1, 6000))
    crown = np.column_stack([reach * np.cos(angle), reach * np.sin(angle), 19.8 - 10.0 * share])
    tip = np.column_stack([np.zeros((6, 2)), 19.8 - 0.01 * np.arange(6)])
    trunk = wall(rng, radius=0.15, spacing_m=0.03, taper=-0.005, top_m=11.0)
    points = np.concatenate([trunk, crown, tip])
    points[:, 0] += np.where(points[:, 2] < 3.0, lean * points[:, 2], 3.0 * lean + 0.5 * lean * (points[:, 2] - 3.0))
    ground = slope(per_m)
    stand = points - np.column_stack([np.zeros((len(points), 2)), ground.height_at(points[:, :2])])
    seen = lean / (1 - lean * per_m)
    stem = stem_at(0.0, 0.15)
    axis = replace(stem.axis, parameters=np.array([1.3 * seen, 0.0, seen, 0.0, 0.15, -0.005]))
    search = StemSearch(stems=(replace(stem, axis=axis),), candidates=1, rejected={}, spacing_m=0.03)
    settings = replace(TreeSettings(), bh_rule=rule)
    ((tree, _),) = measure_stems(stand, search, ground, settings, 0.0, np.zeros(3))
    assert tree.height_m == pytest.approx(19.8 - tree.z_ground_m, abs=0.06)


def test_thousands_of_stems_are_asked_for_their_neighbours_in_seconds() -> None:
    with within(20):
        found = measured({3.0 * number: 0.1 for number in range(2500)}, stem_points(3.0, 0.1))
    ((tree, _),) = [pair for pair in found if pair[1].dbh_m is not None]
    assert tree.x_m == pytest.approx(103.0, abs=0.01)
