"""The area that figures a hectare refer to: that of the ground that was seen, whatever its size and density."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from fsinfer.trees.stand import seen_cells, stand_of_diameters

NO_STEMS = np.zeros((0, 2))


def disc(radius_m: float, per_m2: float, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    count = int(np.pi * radius_m**2 * per_m2)
    radius, turn = radius_m * np.sqrt(rng.random(count)), 2 * np.pi * rng.random(count)
    return np.column_stack([radius * np.cos(turn), radius * np.sin(turn)]) + rng.random(2)


@pytest.mark.parametrize(
    ("radius_m", "per_m2"),
    [*product([5.64, 12.62, 40.0], [25.0, 150.0, 600.0]), (4.0, 12.0), (5.64, 12.0)],
)
def test_a_clipped_circle_has_its_own_area(radius_m: float, per_m2: float) -> None:
    area = np.mean([seen_cells(disc(radius_m, per_m2, seed)).area(NO_STEMS) for seed in range(3)])
    assert area == pytest.approx(np.pi * radius_m**2, rel=0.02)


def test_gaps_of_two_metres_are_closed_and_wider_ones_are_not() -> None:
    ground = disc(10.0, 200.0)
    middle = ground.mean(axis=0)
    apart = np.abs(ground - middle).max(axis=1)
    whole = seen_cells(ground).area(NO_STEMS)
    assert seen_cells(ground[apart > 0.85]).area(NO_STEMS) == pytest.approx(whole, rel=0.001)
    assert seen_cells(ground[apart > 1.6]).area(NO_STEMS) == pytest.approx(whole - 3.2**2, abs=0.8)
    assert not seen_cells(ground[apart > 1.6]).at(middle[None])[0]


@pytest.mark.parametrize("way", [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0), (-0.6, 0.8)])
def test_ground_that_another_part_of_the_walk_saw_joins_wherever_it_lies(way: tuple[float, float]) -> None:
    ground = disc(8.0, 60.0)
    middle = ground.mean(axis=0)
    # The two parts lie half a metre apart.
    along = (ground - middle) @ way
    one, other = ground[along < -0.25], ground[along > 0.25]
    both = seen_cells(one).with_places(other)
    assert both.area(NO_STEMS) == pytest.approx(seen_cells(ground).area(NO_STEMS), rel=0.02)
    assert both.at(np.concatenate([one, other])).mean() > 0.999  # the first of all lies on the border of its cell
    assert both.at(middle + np.array([[0.0, 0.0], [5.0, 0.0], [0.0, 5.0]])).all()
    beyond = middle + 8.5 * np.array([way, (-way[0], -way[1])])
    assert not both.at(beyond).any()


@pytest.mark.parametrize(("on_it", "told"), [(4, False), (6, True)])
def test_ground_on_which_fewer_than_half_of_the_stems_stand_is_no_plot(on_it: int, told: bool) -> None:
    ground = disc(6.0, 100.0)
    stems = ground.mean(axis=0) + np.column_stack([np.where(np.arange(10) < on_it, 0.0, 50.0), np.arange(10) / 5])
    assert (seen_cells(ground).area(stems) > 0.0) == told


def test_a_single_measured_stem_stands_for_itself_and_for_no_other() -> None:
    alone = stand_of_diameters([40.0], 100.0)
    assert alone.basal_area_m2_per_ha == pytest.approx(100 * np.pi / 4 * 0.4**2)
    assert stand_of_diameters([40.0, None], 100.0).basal_area_m2_per_ha is None
    # Of the other something is known, or it stands elsewhere.
    rough = stand_of_diameters([40.0, None], 100.0, rough_cm=[None, 20.0])
    assert rough.basal_area_m2_per_ha == pytest.approx(100 * np.pi / 4 * (0.4**2 + 0.2**2))
    aside = stand_of_diameters([40.0, None], 100.0, on_area=np.array([True, False]))
    assert aside.basal_area_m2_per_ha == alone.basal_area_m2_per_ha


def test_a_stray_a_kilometre_away_costs_neither_memory_nor_area() -> None:
    far = np.vstack([disc(10.0, 50.0), [[3000.0, 3000.0]]])
    seen = seen_cells(far)
    assert seen.seen.size < 4e7
    assert seen.area(NO_STEMS) == pytest.approx(np.pi * 100, rel=0.1)


def test_a_plot_without_stems_has_no_basal_area_and_not_an_unknown_one() -> None:
    """It was empty beside 0 stems a hectare: a mean over plots left it out, and came out too large."""
    stand = stand_of_diameters([], 200.0)
    assert (stand.stems_per_ha, stand.basal_area_m2_per_ha, stand.quadratic_mean_dbh_cm) == (0.0, 0.0, None)
    assert stand_of_diameters([None], 200.0).basal_area_m2_per_ha is None
    assert stand_of_diameters([], 0.0).basal_area_m2_per_ha is None


def test_means_are_of_the_stems_that_count_to_the_hectare() -> None:
    on = np.array([True, True, False, True])
    stand = stand_of_diameters([20.0, 30.0, 50.0, None], 200.0, on_area=on)
    assert (stand.stems, stand.measured, stand.stems_on_area) == (4, 3, 3)
    assert stand.mean_dbh_cm == pytest.approx(25.0)
    assert stand.quadratic_mean_dbh_cm == pytest.approx(np.sqrt(650.0))
    # Without an area nothing is on it, and all are told of.
    assert stand_of_diameters([20.0, 30.0, 50.0], 0.0).mean_dbh_cm == pytest.approx(100 / 3)
