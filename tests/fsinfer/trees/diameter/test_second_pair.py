"""A second pair of sides: stems have one, a strip of bark or a shadow has none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fsinfer.trees.diameter.edge_set import Edges
from fsinfer.trees.diameter.second_pair import SecondPairSettings, second_pair
from fsinfer.trees.diameter.silhouette import fit_silhouette
from training.simulate.stem_edges import edges_from_rows

TAPER = -0.008


def edges_of(radius: float, directions_deg: list[float], *, rng: np.random.Generator, photo: int = 0) -> Edges:
    """Both edges of a round stem in three bands from each direction, and junk; photographs count from ``photo``."""
    rows = []
    for number, direction in enumerate(np.radians(directions_deg), start=photo):
        for side in (0, 1):
            for band in range(3):
                angle = direction + (np.pi / 2 if side else -np.pi / 2)
                height = -0.15 + 0.15 * band
                ray = (number * 2 + side) * 3 + band
                support = radius + TAPER * height + rng.normal(0, 0.001)
                rows.append((support, angle, height, rng.uniform(4, 12), 0.004, ray, number))
                rows.append((rng.uniform(0.01, 0.2), angle, height, rng.uniform(1.2, 4), 0.004, ray, number))
    return edges_from_rows(rows)


def together(one: Edges, other: Edges) -> Edges:
    return Edges(**{name: np.concatenate([getattr(one, name), getattr(other, name)]) for name in vars(one)})


def test_a_stem_has_the_same_size_from_two_directions() -> None:
    edges = edges_of(0.12, [0, 5, 10, 15, 70, 75, 80, 85], rng=np.random.default_rng(0))
    found = second_pair(edges, 0.13, taper=TAPER)
    assert found.agree
    assert found.radii_m == pytest.approx((0.12, 0.12), abs=0.002)
    assert found.apart_deg == pytest.approx(70.0, abs=2.0)


def test_one_direction_and_its_opposite_are_one_pair_of_sides() -> None:
    one_side = [0.0, 4.0, 8.0, 12.0, 180.0, 184.0, 188.0, 192.0]
    found = second_pair(edges_of(0.12, one_side, rng=np.random.default_rng(1)), 0.13, taper=TAPER)
    assert not found.agree
    assert found.apart_deg < 15.0


@pytest.mark.parametrize(("radius", "agree"), [(0.24, True), (0.06, False)])
def test_a_thick_stem_needs_less_of_an_angle(radius: float, agree: bool) -> None:
    """A stem of 47 cm, its parts 28 degrees apart, had no DBH: on its bark something false moves by 11 cm then."""
    edges = edges_of(radius, [0, 3, 6, 9, 20, 23, 26, 29], rng=np.random.default_rng(7))
    found = second_pair(edges, radius, taper=TAPER)
    assert found.apart_deg == pytest.approx(20.0, abs=1.0)
    assert found.agree == agree
    narrow = second_pair(
        edges_of(radius, [0, 3, 6, 9, 10, 12, 14, 18], rng=np.random.default_rng(7)), radius, taper=TAPER
    )
    assert narrow.apart_deg < 12.0
    assert not narrow.agree


@pytest.mark.parametrize(
    ("directions", "weak", "agree"),
    [
        ([0.0, 3.0, 6.0, 9.0, 24.0, 27.0, 30.0, 33.0], True, False),
        ([0.0, 3.0, 6.0, 9.0, 14.0, 17.0, 20.0, 23.0], False, False),
        ([0.0, 3.0, 6.0, 9.0, 70.0, 73.0, 76.0, 79.0], False, True),
    ],
)
def test_an_angle_that_is_almost_enough_is_half_a_support(directions: list[float], weak: bool, agree: bool) -> None:
    found = second_pair(edges_of(0.06, directions, rng=np.random.default_rng(0)), 0.06, taper=TAPER)
    assert (found.weak, found.agree) == (weak, agree)


@pytest.mark.parametrize(("each", "agree"), [(2, True), (1, False)])
def test_photographs_between_are_left_out_where_most_look_from_the_middle(each: int, agree: bool) -> None:
    """A stem of 9 cm, seen in 70 photographs from three quarters of its sides, had no DBH: its halves look 29 apart."""
    directions = [*np.linspace(0, 4, 5 * each), *np.linspace(25, 35, 12 * each), *np.linspace(56, 60, 5 * each)]
    edges = edges_of(0.045, directions, rng=np.random.default_rng(3))
    halves = second_pair(edges, 0.045, taper=TAPER, settings=SecondPairSettings(outer_shares=(0.5,)))
    assert halves.apart_deg == pytest.approx(28.0, abs=0.5)
    assert (halves.weak, halves.agree) == (True, False)
    strict = SecondPairSettings(min_outer_photos=12)
    found = second_pair(edges, 0.045, taper=TAPER, settings=strict)
    assert (found.weak, found.agree) == (not agree, agree)
    if agree:
        assert found.apart_deg == pytest.approx(40.5, abs=1.0)


def test_both_ends_of_evenly_spread_photographs_tell_no_more_than_halves() -> None:
    """A strip of 9 cm on a stem of 24 cm that faces the middle is as wide from both ends, and near its own place."""
    directions = np.linspace(0.0, 50.0, 40)
    edges = edges_of(0.045, directions.tolist(), rng=np.random.default_rng(3))
    turned = np.radians(25.0 - directions)[edges.photo]
    towards = np.radians(directions)[edges.photo]
    side = np.where(np.cos(edges.angle_rad - towards - np.pi / 2) > 0, 1.0, -1.0)
    strip = replace(edges, support_m=edges.support_m + 0.045 * (np.cos(turned) - 1.0) + side * 0.12 * np.sin(turned))
    found = second_pair(strip, 0.045, taper=TAPER)
    assert found.shares == pytest.approx((1.0, 1.0), abs=0.1)
    assert not found.agree


def test_two_sizes_are_not_even_that() -> None:
    rng = np.random.default_rng(4)
    one = edges_of(0.05, [0.0, 3.0, 6.0, 9.0], rng=rng)
    other = edges_of(0.08, [24.0, 27.0, 30.0, 33.0], rng=rng, photo=10)
    assert not second_pair(together(one, other), 0.062, taper=TAPER).weak


def test_a_strip_of_bark_on_a_thick_stem_has_moved_at_that_angle() -> None:
    """A strip of 20 cm on a stem of 50 cm, faced by the first photographs; the others see it 9 to 12 cm aside."""
    rng = np.random.default_rng(8)
    strip = edges_of(0.10, [0, 3, 6, 9, 20, 23, 26, 29], rng=rng)
    towards = np.repeat(np.radians([0, 3, 6, 9, 20, 23, 26, 29]), 12)
    side = np.where(np.cos(strip.angle_rad - towards - np.pi / 2) > 0, 1.0, -1.0)
    moved = replace(strip, support_m=strip.support_m + side * 0.25 * np.sin(np.radians(4.5) - towards))
    found = second_pair(moved, 0.10, taper=TAPER)
    assert found.radii_m[0] == pytest.approx(0.10, abs=0.01)
    assert found.apart_deg == pytest.approx(20.0, abs=1.0)
    assert not found.agree
    # It is the place that tells: the same strip on the axis itself would be a stem.
    assert second_pair(strip, 0.10, taper=TAPER, settings=SecondPairSettings(min_apart_deg=15.0)).agree


def test_two_sizes_are_none_although_one_fit_goes_through_most_edges() -> None:
    """A strip of bark of 6 cm from one direction, the stem's own sides from the other, farther than the vote looks."""
    rng = np.random.default_rng(2)
    strip = edges_of(0.03, [float(v) for v in range(0, 40, 3)], rng=rng)
    stem = edges_of(0.085, [80.0, 84.0, 88.0, 92.0], rng=rng, photo=50)
    mixed = together(strip, stem)
    fit = fit_silhouette(mixed, 0.03, taper=TAPER)
    assert fit is not None  # by itself it would be a measurement
    assert fit.radius_m == pytest.approx(0.03, abs=0.005)
    assert not second_pair(mixed, 0.03, taper=TAPER).agree


def test_two_parts_that_each_find_another_size_do_not_agree() -> None:
    rng = np.random.default_rng(4)
    one = edges_of(0.05, [0.0, 4.0, 8.0, 12.0], rng=rng)
    other = edges_of(0.08, [80.0, 84.0, 88.0, 92.0], rng=rng, photo=10)
    found = second_pair(together(one, other), 0.062, taper=TAPER)
    assert found.radii_m == pytest.approx((0.05, 0.08), abs=0.004)
    assert not found.agree


@pytest.mark.parametrize(("aside_m", "agree"), [(0.03, True), (0.08, False)])
def test_the_place_that_one_part_cannot_see_is_not_asked_for(aside_m: float, agree: bool) -> None:
    """Cameras of the second part stand aside: both sides of the stem are moved by the same, as far as poses may err."""
    rng = np.random.default_rng(5)
    # Too few to find a size by themselves; they are asked for the one that the first part found.
    other = edges_of(0.12, [80.0, 84.0, 88.0], rng=rng, photo=10)
    moved = replace(other, support_m=other.support_m + aside_m * np.sign(np.cos(other.angle_rad - np.radians(170.0))))
    edges = together(edges_of(0.12, [0.0, 4.0, 8.0, 12.0], rng=rng), moved)
    assert second_pair(edges, 0.12, taper=TAPER, settings=SecondPairSettings(both_share=0.7)).agree == agree


@pytest.mark.parametrize(("bent", "agree"), [(0.3, True), (0.7, False)])
def test_two_parts_that_find_the_same_size_need_fewer_of_each_others_edges(bent: float, agree: bool) -> None:
    """Of the rays of both a share is lost to bark, twigs or a fit that is bent; the sizes are the same."""
    rng = np.random.default_rng(6)
    edges = edges_of(0.06, [float(v) for v in (*range(0, 24, 2), *range(70, 94, 2))], rng=rng)
    lost = rng.random(int(edges.ray.max()) + 1)[edges.ray] < bent
    edges = replace(
        edges, support_m=np.where(lost, edges.support_m + rng.uniform(0.03, 0.1, len(lost)), edges.support_m)
    )
    found = second_pair(edges, 0.06, taper=TAPER)
    assert found.agree == agree
    strict = second_pair(edges, 0.06, taper=TAPER, settings=SecondPairSettings(both_share=0.7))
    assert not strict.agree


def test_one_photograph_and_no_edges_agree_with_nothing() -> None:
    edges = edges_of(0.12, [0.0], rng=np.random.default_rng(3))
    assert not second_pair(edges, 0.12, taper=TAPER).agree
    none = replace(edges, **{name: getattr(edges, name)[:0] for name in vars(edges)})
    assert not second_pair(none, 0.12, taper=TAPER).agree


@pytest.mark.parametrize(("kept", "weak", "agree"), [(1.0, False, True), (0.65, True, False), (0.45, False, False)])
def test_two_thirds_of_the_rays_from_far_enough_apart_are_half_a_support(kept: float, weak: bool, agree: bool) -> None:
    """Of the second part that share of the rays has the stem's edge, the others have theirs anywhere."""
    rng = np.random.default_rng(20)
    one = edges_of(0.06, [0.0, 3.0, 6.0, 9.0, 12.0, 15.0], rng=rng)
    other = edges_of(0.06, [70.0, 73.0, 76.0, 79.0, 82.0, 85.0], rng=rng, photo=10)
    lost = np.isin(other.ray, rng.permutation(np.unique(other.ray))[round(kept * 36) :])
    support = np.where(lost, rng.uniform(0.10, 0.14, len(lost)), other.support_m)
    # Two thirds are enough where both parts find the stem: not here.
    found = second_pair(
        together(one, replace(other, support_m=support)), 0.06, taper=TAPER, settings=SecondPairSettings(both_share=0.7)
    )
    assert (found.weak, found.agree) == (weak, agree)
