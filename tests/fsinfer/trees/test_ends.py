"""Stumps, posts and what hangs in the air are no sure trees; trees and what is hidden in part stay as they are."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.notices.notice import notice
from fsinfer.notices.stems import StemCode
from fsinfer.trees import PlotResult, analyse_plot
from fsinfer.trees.cylinder.axis import Axis
from fsinfer.trees.diameter.section import unmeasured_section
from fsinfer.trees.ends import Ends, ends_of, with_ends
from fsinfer.trees.search.stem import Stem, StemSettings
from tests.support.stem_clouds import wall

Floats = NDArray[np.float64]
AT = np.array([3.0, 1.0])


def tube(rng: np.random.Generator, radius: float, low: float, high: float, arc_deg: float = 360.0) -> Floats:
    points = wall(rng, radius=radius, spacing_m=0.012, taper=0.0, top_m=high, arc_deg=arc_deg)
    return points[points[:, 2] >= low]


def measured(*things: Floats, top_m: float = 5.0) -> PlotResult:
    """Three trees, and ``things`` about (0, 0) put at ``AT``, on level ground."""
    rng = np.random.default_rng(3)
    ground = np.column_stack([rng.uniform(-6.0, 6.0, (30_000, 2)), rng.normal(0.0, 0.005, 30_000)])
    trees = [tube(rng, 0.15, 0.0, top_m) + np.array([x, y, 0.0]) for x, y in ((-4.0, -4.0), (-4.0, 3.0), (0.0, -3.0))]
    others = [thing + np.array([*AT, 0.0]) for thing in things]
    points = np.concatenate([ground, *trees, *others])
    return analyse_plot(points + rng.normal(0.0, 0.003, points.shape), turned=True)


def here(result: PlotResult) -> list[tuple[str, list[str]]]:
    """Status and reasons of what was found at ``AT``."""
    return [
        (tree.status, [str(reason.code) for reason in tree.reasons])
        for tree in result.trees
        if np.hypot(tree.x_m - AT[0], tree.y_m - AT[1]) < 0.5
    ]


@pytest.mark.parametrize("radius", [0.05, 0.2])
def test_what_ends_below_breast_height_is_no_tree(radius: float) -> None:
    result = measured(tube(np.random.default_rng(1), radius, 0.0, 1.15))
    assert here(result) == []
    (warning,) = (item for item in result.warnings if item.code == "stumps_left_out")
    assert dict(warning.items)["places"] == ("(3.0, 1.0)",)
    assert len(result.trees) == 3


@pytest.mark.parametrize("high", [1.5, 1.8])
def test_a_top_seen_above_breast_height_is_told(high: float) -> None:
    ((status, reasons),) = here(measured(tube(np.random.default_rng(1), 0.1, 0.0, high)))
    assert (status, reasons) == ("doubtful", ["top_seen"])


def test_a_head_upon_shoulders_is_the_top() -> None:
    rng = np.random.default_rng(4)
    legs = [tube(rng, 0.08, 0.0, 0.85) + np.array([x, 0.0, 0.0]) for x in (-0.1, 0.1)]
    round_head = rng.normal(size=(900, 3))
    head = np.array([0.0, 0.0, 1.63]) + 0.11 * round_head / np.linalg.norm(round_head, axis=1)[:, None]
    result = measured(*legs, tube(rng, 0.17, 0.85, 1.45), head)
    assert here(result) == [("doubtful", ["top_seen"])]
    (person,) = (tree for tree in result.trees if np.hypot(tree.x_m - AT[0], tree.y_m - AT[1]) < 0.5)
    assert dict(person.reasons[0].items)["top_m"] == pytest.approx(1.72, abs=0.04)


def test_of_what_a_few_points_tell_higher_up_no_top_is_told() -> None:
    rng = np.random.default_rng(5)
    seen = np.concatenate([lid(rng, 0.12, z, points=12) for z in np.arange(1.6, 1.95, 0.01)])
    (found,) = here(measured(tube(rng, 0.15, 0.0, 1.6), seen))
    assert "top_seen" not in found[1]


def lid(rng: np.random.Generator, radius: float, high: float, *, points: int = 2000) -> Floats:
    square = rng.uniform(-radius, radius, (points, 2))
    disc = square[np.hypot(*square.T) < radius]
    return np.column_stack([disc, np.full(len(disc), high)])


@pytest.mark.parametrize(("high", "arc_deg"), [(1.6, 140.0), (2.2, 360.0)])
def test_what_is_closed_at_its_top_is_no_sure_tree(high: float, arc_deg: float) -> None:
    rng = np.random.default_rng(7)
    open_one = tube(rng, 0.2, 0.0, high, arc_deg=arc_deg)
    assert "top_seen" not in here(measured(open_one))[0][1]
    ((status, reasons),) = here(measured(open_one, lid(rng, 0.2, high)))
    assert status != "ok"
    assert "top_seen" in reasons


def test_a_stem_that_a_noisy_cloud_fills_has_no_lid() -> None:
    rng = np.random.default_rng(8)
    inside = np.concatenate([lid(rng, 0.11, z, points=8) for z in np.arange(0.0, 1.6, 0.01)])
    (found,) = here(measured(tube(rng, 0.15, 0.0, 1.6, arc_deg=140.0), inside))
    assert "top_seen" not in found[1]


@pytest.mark.parametrize("side", [0.2, 0.4])
def test_a_square_post_is_no_sure_tree(side: float) -> None:
    rng = np.random.default_rng(6)
    along, across = rng.uniform(-side / 2, side / 2, 8000), rng.choice([-side / 2, side / 2], 8000)
    turned = rng.uniform(size=8000) < 0.5
    faces = np.column_stack([np.where(turned, along, across), np.where(turned, across, along)])
    ((status, reasons),) = here(measured(np.column_stack([faces, rng.uniform(0.0, 2.6, 8000)])))
    assert status != "ok"
    assert "far_from_round" in reasons


def test_what_could_not_be_measured_has_its_ends_told_as_well() -> None:
    """Photographs may give it a diameter by its edges, and they do not know that it is a post."""
    refused = notice(StemCode.too_rough, residual_cm=3.0)
    section = unmeasured_section(np.zeros(2), 1.3, (refused,), radius_m=0.1)
    told = with_ends(section, Ends(top_m=1.62), 1.3)
    assert (told.status, told.reasons) == ("unmeasured", (refused, notice(StemCode.top_seen, top_m=1.62)))


def test_what_hangs_in_the_air_is_told() -> None:
    ((status, reasons),) = here(measured(tube(np.random.default_rng(1), 0.06, 0.9, 3.5)))
    assert (status, reasons) == ("doubtful", ["hangs"])


@pytest.mark.parametrize("lean_deg", [28.0, 40.0])
@pytest.mark.parametrize("radius", [0.05, 0.12])
def test_a_stem_that_leans_ends_where_it_does(radius: float, lean_deg: float) -> None:
    """Its foot and its upper part lie aside of its place at breast height."""

    def leaning(low: float, high: float) -> Floats:
        points = tube(np.random.default_rng(1), radius, 0.0, 8.0)
        cosine, sine = np.cos(np.radians(lean_deg)), np.sin(np.radians(lean_deg))
        x, z = points[:, 0].copy(), points[:, 2] - 3.0
        points[:, 0], points[:, 2] = cosine * x + sine * z, 1.3 - sine * x + cosine * z
        return points[(points[:, 2] >= low) & (points[:, 2] <= high)]

    assert here(measured(leaning(0.0, 5.0))) == [("ok", [])]
    ((status, reasons),) = here(measured(leaning(0.9, 5.0)))
    assert (status, reasons) == ("doubtful", ["hangs"])


def ended(
    radius: float, bottom_m: float, top_m: float, *more: Floats, arc_deg: float = 360.0, slab_m: tuple[float, float]
) -> Ends:
    """Of a wall of 2,000 points a metre all round, as much of it as is seen, and ``more`` points within it."""
    rng = np.random.default_rng(9)
    angle = np.radians(arc_deg) * rng.random(int(2000 * (top_m - bottom_m) * arc_deg / 360.0))
    wall_of_it = np.column_stack([np.cos(angle), np.sin(angle), rng.uniform(bottom_m, top_m, len(angle))])
    axis = Axis(parameters=np.array([0.0, 0.0, 0.0, 0.0, radius, 0.0]), height_m=1.3, sigma_m=0.003)
    stem = Stem(
        axis=axis, bottom_m=bottom_m, top_m=top_m, length_m=top_m - bottom_m, arc_coverage=arc_deg / 360.0, quality=1.0
    )
    points = np.concatenate([wall_of_it * [radius, radius, 1.0], *more])
    return ends_of(points, stem, cloud_top_m=6.0, slab_m=slab_m, s=StemSettings())


def filling(radius: float, low: float, high: float, count: int, seed: int = 10) -> Floats:
    """Points evenly spread within a stem."""
    rng = np.random.default_rng(seed)
    reach, angle = radius * np.sqrt(rng.random(count)), rng.uniform(0.0, 2.0 * np.pi, count)
    return np.column_stack([reach * np.cos(angle), reach * np.sin(angle), rng.uniform(low, high, count)])


@pytest.mark.parametrize(("of_the_wall", "closed"), [(0.25, False), (1.0, True)])
def test_a_lid_is_about_as_dense_as_the_part_of_the_wall_that_is_seen(of_the_wall: float, closed: bool) -> None:
    radius, arc_deg = 0.3, 140.0
    # 2,000 points a metre of the whole wall: so many of them on a square metre.
    count = int(of_the_wall * 2000 / (2.0 * np.pi * radius) * np.pi * radius**2)
    lid_of_it = filling(radius, 1.58, 1.6, count)
    found = ended(radius, 0.3, 1.6, lid_of_it, arc_deg=arc_deg, slab_m=(0.2, 3.0))
    assert (found.top_m is not None) == closed


@pytest.mark.parametrize(("times", "closed"), [(2.0, False), (4.5, True)])
def test_a_lid_is_clearly_denser_than_what_fills_the_stem_below_it(times: float, closed: bool) -> None:
    haze = filling(0.3, 0.3, 1.45, int(1.15 * 400), seed=11)  # 120 in as much height as ends are told to
    found = ended(0.3, 0.3, 1.6, haze, filling(0.3, 1.58, 1.6, int(times * 120)), arc_deg=140.0, slab_m=(0.2, 3.0))
    assert (found.top_m is not None) == closed


@pytest.mark.parametrize(("radius", "closed"), [(0.08, False), (0.12, True)])
def test_of_a_thin_stem_no_lid_is_told_from_noise(radius: float, closed: bool) -> None:
    found = ended(radius, 0.3, 1.6, filling(radius, 1.5, 1.6, 600), arc_deg=140.0, slab_m=(0.2, 3.0))
    assert (found.top_m is not None) == closed


def test_what_hangs_above_herbs_hangs() -> None:
    herbs = filling(0.1, 0.3, 0.4, 100)
    assert ended(0.1, 1.0, 4.0, herbs, slab_m=(0.3, 4.0)).bottom_m == 1.0
    bush = filling(0.1, 0.3, 0.7, 400)
    assert ended(0.1, 1.0, 4.0, bush, slab_m=(0.3, 4.0)).bottom_m is None


def test_trees_have_no_ends() -> None:
    result = measured(tube(np.random.default_rng(1), 0.2, 0.0, 5.0))
    assert [tree.status for tree in result.trees] == ["ok"] * 4


def test_a_cloud_cut_off_low_has_no_tops() -> None:
    result = measured(tube(np.random.default_rng(1), 0.2, 0.0, 1.8), top_m=1.8)
    assert [tree.status for tree in result.trees] == ["ok"] * 4


def test_a_foot_in_the_grass_and_a_top_among_leaves_are_hidden() -> None:
    rng = np.random.default_rng(2)
    leaves = rng.uniform([-0.3, -0.3, 1.7], [0.3, 0.3, 3.0], (3000, 3))
    grass = rng.uniform([-0.5, -0.5, 0.0], [0.5, 0.5, 0.5], (4000, 3))
    (found,) = here(measured(tube(rng, 0.12, 0.6, 1.7), leaves, grass))
    assert not {"top_seen", "hangs", "ends_low"} & set(found[1])


def test_of_what_is_seen_from_one_side_nothing_is_told() -> None:
    (found,) = here(measured(tube(np.random.default_rng(1), 0.2, 0.0, 1.6, arc_deg=140.0)))
    assert not {"top_seen", "ends_low"} & set(found[1])
