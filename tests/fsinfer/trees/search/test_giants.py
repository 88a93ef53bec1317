"""Stems of more than 1.2 m: found, measured, and not seen where there are none."""

from __future__ import annotations

import numpy as np
import pytest

from fsinfer.trees import StemSettings, Tree, TreeSettings, analyse_plot
from fsinfer.trees.cylinder.axis import Axis
from fsinfer.trees.ground.ground import find_ground
from fsinfer.trees.search.find import StemSearch
from fsinfer.trees.search.stem import Stem
from fsinfer.trees.stem_measurement import measure_stems
from tests.support.stem_clouds import Floats, stem_plot, wall

AT = np.array([12.0, 3.0])


def giant(seed: int, *, dbh_m: float, arc_deg: float = 360.0, sigma_m: float = 0.008) -> Floats:
    """Points of one thick stem with a little lean on ground of its own, seen over ``arc_deg``."""
    rng = np.random.default_rng(seed)
    points = wall(rng, radius=dbh_m / 2, arc_deg=arc_deg, spacing_m=0.02, ovality=0.02, taper=-0.01)
    points[:, :2] += AT + points[:, 2:3] * [0.02, -0.03]
    points += rng.normal(0, sigma_m, points.shape)
    ground = rng.uniform(-3.0, 3.0, (15_000, 2)) + AT
    ground = ground[np.hypot(*(ground - AT).T) > dbh_m / 2]
    return np.concatenate([points, np.column_stack([ground, rng.normal(0, 0.01, len(ground))])])


def near(trees: tuple[Tree, ...]) -> list[Tree]:
    return [tree for tree in trees if np.hypot(tree.x_m - AT[0], tree.y_m - AT[1]) < 1.5]


@pytest.mark.parametrize(
    ("seed", "dbh_m", "arc_deg", "off_cm"),
    [
        (43000, 2.2, 360.0, 1.0),
        (43001, 1.3, 360.0, 1.0),
        (43002, 1.6, 200.0, 3.0),
        (43003, 2.4, 150.0, 6.0),
        (43005, 2.5, 360.0, 1.0),
    ],
)
def test_thick_stems_are_found_and_measured_beside_others(
    seed: int, dbh_m: float, arc_deg: float, off_cm: float
) -> None:
    others = stem_plot(seed=seed, trees=6, spacing_m=0.02, sigma_m=0.006)
    result = analyse_plot(np.concatenate([others.points, giant(seed, dbh_m=dbh_m, arc_deg=arc_deg)]))
    assert len(result.trees) == 7
    (thick,) = near(result.trees)
    assert thick.dbh_cm == pytest.approx(100 * dbh_m, abs=off_cm)
    assert thick.dbh_lo95_cm is not None
    assert thick.dbh_hi95_cm is not None
    assert thick.dbh_lo95_cm - 0.5 <= 100 * dbh_m <= thick.dbh_hi95_cm + 0.5
    # The others are what they are without it.
    alone = analyse_plot(others.points)
    assert [t.dbh_cm for t in result.trees if t is not thick] == pytest.approx([t.dbh_cm for t in alone.trees], abs=0.3)


def test_without_the_second_search_it_vanishes() -> None:
    only_thin = TreeSettings(stems=StemSettings(giant_radius_m=0.6))
    points = np.concatenate([stem_plot(seed=43000, trees=4, spacing_m=0.02).points, giant(43000, dbh_m=2.2)])
    assert near(analyse_plot(points, settings=only_thin).trees) == []
    assert len(near(analyse_plot(points).trees)) == 1


def test_what_is_no_giant_is_not_taken_for_one() -> None:
    rng = np.random.default_rng(43004)
    plot = stem_plot(seed=43004, trees=16, spacing_m=0.02, sigma_m=0.015, outliers=0.1, hidden=0.5, shrubs=8)
    # A hedge in an arc of 1 m radius, a wall, and a ring of poles.
    turn = rng.uniform(0, np.pi, 8000)
    hedge = np.column_stack([15 + np.cos(turn), np.sin(turn), rng.uniform(0, 2.0, 8000)]) + rng.normal(
        0, 0.12, (8000, 3)
    )
    side = np.column_stack([rng.uniform(14, 18, 20_000), np.full(20_000, 6.0), rng.uniform(0, 3, 20_000)])
    poles = [
        wall(rng, radius=0.05, spacing_m=0.02) + np.array([16 + np.cos(angle), 10 + np.sin(angle), 0.0])
        for angle in np.arange(8) * np.pi / 4
    ]
    ground = np.column_stack([rng.uniform(12, 19, 30_000), rng.uniform(-2, 13, 30_000), rng.normal(0, 0.01, 30_000)])
    points = np.concatenate([plot.points, hedge, side + rng.normal(0, 0.01, side.shape), *poles, ground])
    found = analyse_plot(points)
    assert [tree for tree in found.trees if tree.dbh_cm is not None and tree.dbh_cm > 60] == []
    assert sum(tree.x_m < 10 for tree in found.trees) == 16
    # Of the ring each pole is a stem.
    assert sum(abs(np.hypot(tree.x_m - 16, tree.y_m - 10) - 1) < 0.1 for tree in found.trees) == 8


@pytest.mark.parametrize(("dbh_m", "length_m", "entries"), [(1.8, 2.0, 0), (0.8, 2.0, 1), (0.8, 1.0, 0), (0.5, 1.0, 1)])
def test_of_a_giant_more_than_a_sliver_is_seen_at_breast_height(dbh_m: float, length_m: float, entries: int) -> None:
    """A shrub that passed for a part of a large circle shows 12 degrees of it, and that no better than a shrub does."""
    rng = np.random.default_rng(43006)
    sliver = wall(rng, radius=dbh_m / 2, arc_deg=12.0, spacing_m=0.01)
    sliver[:, :2] += AT
    sliver += rng.normal(0, 0.012, sliver.shape)
    ground = np.column_stack([rng.uniform(-3.0, 3.0, (15_000, 2)) + AT, rng.normal(0, 0.01, 15_000)])
    points = np.concatenate([sliver, ground])
    axis = Axis(parameters=np.array([*AT, 0.0, 0.0, dbh_m / 2, 0.0]), height_m=1.3, sigma_m=0.012)
    stem = Stem(axis=axis, bottom_m=0.5, top_m=2.5, length_m=length_m, arc_coverage=0.3, quality=1.0)
    search = StemSearch(stems=(stem,), candidates=1, rejected={}, spacing_m=0.01)
    found = measure_stems(points, search, find_ground(points), TreeSettings(), 0.0, np.zeros(3))
    assert [tree.dbh_cm for tree, _ in found] == [None] * entries
