"""The ground at the foot of each stem: seen and agreeing with the surface, or not."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from fsinfer.notices.stems import StemCode
from fsinfer.trees import analyse_plot, find_ground
from fsinfer.trees.ground.at_stems import is_layer, level_std, shows_ground
from tests.support.relief import DBH_M, FEET, gentle, mound, relief_plot
from tests.support.stem_clouds import wall

RADII = np.full(len(FEET), DBH_M / 2)


def test_stems_without_ground_are_doubtful_and_have_no_area() -> None:
    rng = np.random.default_rng(4)
    stems = []
    for x in (-6.0, 0.0, 6.0):
        bark = wall(rng, radius=0.15, spacing_m=0.015, taper=-0.01, top_m=6.0)
        stems.append(bark[bark[:, 2] > 1.0] + [x, x / 2, 0.0])
    points = np.concatenate(stems)
    result = analyse_plot(points + rng.normal(0.0, 0.003, points.shape))
    assert len(result.trees) == 3
    assert {tree.status for tree in result.trees} == {"doubtful"}
    assert all(StemCode.ground_unsure in {why.code for why in tree.reasons} for tree in result.trees)
    assert result.stand.stems_per_ha is None
    assert StemCode.little_ground in {warning.code for warning in result.warnings}


@pytest.mark.parametrize(("share", "told"), [(0.2, True), (0.5, False)])
def test_ground_seen_in_less_than_a_third_of_the_plot_is_told_to_be_little(share: float, told: bool) -> None:
    rng = np.random.default_rng(4)
    corners = np.array([[x, y, 0.0] for x, y in product((-5.8, 5.8), repeat=2)])
    stems = [wall(rng, radius=0.15, spacing_m=0.015, taper=-0.01, top_m=4.0) + corner for corner in corners]
    ground = np.column_stack([rng.uniform(-6.0, 6.0, (20_000, 2)), np.zeros(20_000)])
    ground = ground[ground[:, 0] < -6.0 + 12.0 * share]
    points = np.concatenate([ground, *stems])
    result = analyse_plot(points + rng.normal(0.0, 0.003, points.shape))
    assert (StemCode.little_ground in {warning.code for warning in result.warnings}) == told


def test_trees_seen_from_afar_do_not_make_the_ground_little() -> None:
    """An open wood: the walk's ground is seen, and beyond it stems alone."""
    rng = np.random.default_rng(7)
    places = [*product((-3.0, 0.0, 3.0), repeat=2), *product((-30.0, 30.0), repeat=2)]
    stems = [wall(rng, radius=0.15, spacing_m=0.015, taper=-0.01, top_m=4.0) + np.array([*at, 0.0]) for at in places]
    far = [stem[::4] for stem in stems[9:]]
    ground = np.column_stack([rng.uniform(-5.0, 5.0, (30_000, 2)), np.zeros(30_000)])
    points = np.concatenate([ground, *stems[:9], *far])
    result = analyse_plot(points + rng.normal(0.0, 0.003, points.shape))
    assert len(result.trees) >= 9
    assert StemCode.little_ground not in {warning.code for warning in result.warnings}


@pytest.mark.parametrize("cut", [True, False])
def test_branches_of_a_cloud_that_was_cut_are_no_ground(cut: bool) -> None:
    rng = np.random.default_rng(5)
    feet = [(x, y) for x in (-4.0, 0.0, 4.0) for y in (-4.0, 0.0, 4.0)]
    stems = [wall(rng, radius=0.12, spacing_m=0.015, taper=-0.01, top_m=4.0) + np.array([*foot, 0.0]) for foot in feet]
    branches = rng.uniform([-6.0, -6.0, 0.5], [6.0, 6.0, 4.0], (60_000, 3))
    ground = np.column_stack([rng.uniform(-6.0, 6.0, (30_000, 2)), np.zeros(30_000)])
    points = np.concatenate([ground, branches, *stems])
    points = points[points[:, 2] > 0.5] if cut else points
    result = analyse_plot(points + rng.normal(0.0, 0.003, points.shape))
    assert (StemCode.little_ground in {warning.code for warning in result.warnings}) == cut
    assert len(result.trees) == len(feet)
    unsure = [StemCode.ground_unsure in {why.code for why in tree.reasons} for tree in result.trees]
    assert unsure == [cut] * len(feet)


@pytest.mark.parametrize(("low_m", "high_m"), [(0.0, 0.45), (0.3, 1.5)])
def test_herbs_or_shrubs_that_hide_most_of_the_ground_leave_it_a_layer(low_m: float, high_m: float) -> None:
    rng = np.random.default_rng(6)
    ground = np.column_stack([rng.uniform(-6.0, 6.0, (9_000, 2)), rng.normal(0.0, 0.01, 9_000)])
    plants = rng.uniform([-6.0, -6.0, low_m], [6.0, 6.0, high_m], (60_000, 3))
    nobody = np.zeros((0, 2))
    assert is_layer(np.concatenate([ground, plants]), nobody, np.zeros(0))


def test_ground_that_is_seen_and_followed_is_sure() -> None:
    plot = relief_plot(gentle, patches=20)
    assert level_std(find_ground(plot.points), FEET, RADII).max() < 0.1


def test_a_mound_that_is_not_followed_leaves_its_own_stem_unsure() -> None:
    plot = relief_plot(mound(1.0))
    ground = find_ground(plot.points)
    on_it = np.hypot(*FEET.T) < 0.1
    off, std = np.abs(ground.height_at(FEET) - plot.ground_m), level_std(ground, FEET, RADII)
    assert off[on_it].max() > 0.3
    assert std[on_it].min() > 0.1
    assert std[~on_it].max() < 0.05


def test_the_farther_the_ground_the_less_sure_the_level() -> None:
    plot = relief_plot(gentle)
    ground = find_ground(plot.points)
    near, far, farther = level_std(ground, np.array([[0.0, 3.0], [14.0, 0.0], [18.0, 0.0]]), np.full(3, 0.15))
    assert near < 0.05 < far < farther


def test_low_places_of_a_thick_stem_beside_a_thin_one_are_its_own() -> None:
    feet, radii = np.array([[0.0, 0.0], [0.7, 0.0]]), np.array([0.5, 0.05])
    places = np.array([[0.45, 0.0], [0.45, 0.8], [0.75, 0.0], [1.2, 0.0]])
    assert shows_ground(places, feet, radii).tolist() == [False, True, False, True]
    assert shows_ground(places, np.zeros((0, 2)), np.zeros(0)).all()
    assert shows_ground(np.zeros((0, 2)), feet, radii).tolist() == []
