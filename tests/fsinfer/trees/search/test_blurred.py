"""Stems whose walls are blurred in the cloud: found, not seen where there are none, and no ghosts of others."""

from __future__ import annotations

import numpy as np
import pytest

from fsinfer.trees import StemSettings, Tree, TreeSettings, analyse_plot
from fsinfer.trees.cylinder.axis import Axis
from fsinfer.trees.points.cells import thin
from fsinfer.trees.search.blurred import with_blurred
from fsinfer.trees.search.stem import Stem
from tests.support.stem_clouds import Floats, stem_plot, wall

AT = np.array([14.0, 3.0])
CELL_M = 0.02
ONLY_CLEAR = TreeSettings(stems=StemSettings(blurred_sigma_m=0.0))


def ground(rng: np.random.Generator) -> Floats:
    xy = rng.uniform(-2.5, 2.5, (12_000, 2)) + AT
    return np.column_stack([xy, rng.normal(0, 0.01, len(xy))])


def blurred(seed: int, *, radius: float, top_m: float = 4.0) -> Floats:
    """Points of a stem seen from one side, each 6 cm (standard deviation) before or behind it, and its ground."""
    rng = np.random.default_rng(seed)
    points = wall(rng, radius=radius, arc_deg=190.0, top_m=top_m, spacing_m=0.015)
    points += rng.normal(0, [0.06, 0.02, 0.01], points.shape)
    return np.concatenate([points + np.array([*AT, 0.0]), ground(rng)])


def near(trees: tuple[Tree, ...]) -> list[Tree]:
    return [tree for tree in trees if np.hypot(tree.x_m - AT[0], tree.y_m - AT[1]) < 1.5]


@pytest.mark.parametrize(("seed", "radius"), [(44000, 0.12), (44001, 0.2), (44002, 0.15)])
def test_a_blurred_wall_is_a_stem(seed: int, radius: float) -> None:
    others = stem_plot(seed=seed, trees=6, spacing_m=0.02, sigma_m=0.006).points
    points = np.concatenate([others, blurred(seed, radius=radius)])
    assert near(analyse_plot(points, settings=ONLY_CLEAR).trees) == []
    result = analyse_plot(points)
    (stem,) = near(result.trees)
    assert np.hypot(stem.x_m - AT[0], stem.y_m - AT[1]) < 0.13
    # Its points give no sure diameter; the photographs' edges have to.
    assert stem.status != "ok"
    assert stem.dbh_lo95_cm is None or stem.dbh_lo95_cm < 200 * radius < (stem.dbh_hi95_cm or 0.0)
    assert len(result.trees) == 7


def test_what_ends_below_a_stem_is_a_shrub() -> None:
    others = stem_plot(seed=44003, trees=6, spacing_m=0.02, sigma_m=0.006).points
    points = np.concatenate([others, blurred(44003, radius=0.15, top_m=2.0)])
    assert near(analyse_plot(points).trees) == []


def test_a_ghost_beside_a_stem_is_no_second_one() -> None:
    rng = np.random.default_rng(44004)
    others = stem_plot(seed=44004, trees=6, spacing_m=0.02, sigma_m=0.006).points
    clear = wall(rng, radius=0.15, spacing_m=0.01)
    clear[:, :2] += AT
    ghost = blurred(44004, radius=0.15) + np.array([0.3, 0.1, 0.0])
    result = analyse_plot(np.concatenate([others, clear + rng.normal(0, 0.004, clear.shape), ghost, ground(rng)]))
    (stem,) = near(result.trees)
    assert stem.dbh_cm == pytest.approx(30.0, abs=1.0)


def haze(seed: int, *, radius: float, sigma_m: float) -> Floats:
    """Points of a stem at the origin with so much noise, thinned as the search does."""
    rng = np.random.default_rng(seed)
    points = wall(rng, radius=radius, top_m=2.5, spacing_m=0.012)
    return thin(points + rng.normal(0, sigma_m, points.shape), CELL_M / 2)


def rough_stem(x: float, *, quality: float) -> Stem:
    axis = Axis(parameters=np.array([x, 0.0, 0.0, 0.0, 0.07, 0.0]), height_m=1.5, sigma_m=0.025)
    return Stem(axis=axis, bottom_m=0.5, top_m=2.5, length_m=2.0, arc_coverage=1.0, quality=quality)


def test_what_the_first_search_has_missed_is_found_however_blurred() -> None:
    """Its fits on few points may all end beside a stem that is rough, but not beyond its limit."""
    (stem,) = with_blurred(haze(44005, radius=0.12, sigma_m=0.02), [], CELL_M, StemSettings())
    assert stem.axis.sigma_m < StemSettings().max_sigma_m
    assert np.hypot(*stem.axis.center_at(1.3)) < 0.02
    assert stem.axis.radius_m == pytest.approx(0.12, abs=0.02)


def test_a_rough_stem_gives_way_to_a_better_one_in_its_place_only() -> None:
    points = haze(44006, radius=0.12, sigma_m=0.02)
    beside, better, elsewhere = (
        rough_stem(0.09, quality=0.1),
        rough_stem(0.09, quality=9.0),
        rough_stem(1.5, quality=0.1),
    )
    (stem, other) = with_blurred(points, [beside, elsewhere], CELL_M, StemSettings())
    assert np.hypot(*stem.axis.center_at(1.3)) < 0.02
    assert other is elsewhere
    assert with_blurred(points, [better], CELL_M, StemSettings()) == [better]


def test_two_rough_stems_are_not_made_one() -> None:
    points = haze(44007, radius=0.12, sigma_m=0.02)
    pair = [rough_stem(-0.08, quality=0.1), rough_stem(0.08, quality=0.1)]
    assert with_blurred(points, pair, CELL_M, StemSettings()) == pair


def test_beside_a_rough_stem_stands_no_second_one() -> None:
    points = haze(44008, radius=0.12, sigma_m=0.02)
    neighbour = rough_stem(0.3, quality=0.1)
    assert with_blurred(points, [neighbour], CELL_M, StemSettings()) == [neighbour]
