"""Circles through saplings are no trees; stems of which branches hide stripes are."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.trees import PlotResult, analyse_plot
from fsinfer.trees.diameter.pieces import pieces_of
from tests.support.stem_clouds import wall

Floats = NDArray[np.float64]
AT = np.array([3.0, 1.0])


def rods(rng: np.random.Generator, circle_m: float, number: int) -> Floats:
    """Saplings of 2 cm that stand on a circle."""
    parts = []
    for angle in np.linspace(0.0, 2.0 * np.pi, number, endpoint=False) + rng.normal(0.0, 0.1, number):
        rod = wall(rng, radius=0.01, spacing_m=0.01, taper=0.0, top_m=3.0)
        place = (circle_m + rng.normal(0.0, 0.006)) * np.array([np.cos(angle), np.sin(angle)])
        parts.append(rod[:, :3] * [0.4, 0.4, 1.0] + [*place, 0.0])
    return np.concatenate(parts)


def striped(rng: np.random.Generator, radius: float, stripes: int) -> Floats:
    """A stem of which so many stripes, a fifth of the girth in all, are hidden all the way up."""
    points = wall(rng, radius=radius, spacing_m=0.012, top_m=4.0)
    turn = np.arctan2(points[:, 1], points[:, 0]) / (2.0 * np.pi) * stripes
    return points[turn % 1.0 > 0.2]


def measured(thing: Floats) -> PlotResult:
    """Three trees, and a ``thing`` about (0, 0) put at ``AT``, on level ground."""
    rng = np.random.default_rng(3)
    ground = np.column_stack([rng.uniform(-6.0, 6.0, (30_000, 2)), rng.normal(0.0, 0.005, 30_000)])
    trees = [
        wall(rng, radius=0.15, spacing_m=0.012, top_m=4.0) + np.array([x, y, 0.0])
        for x, y in ((-4.0, -4.0), (-4.0, 3.0), (0.0, -3.0))
    ]
    points = np.concatenate([ground, *trees, thing + np.array([*AT, 0.0])])
    return analyse_plot(points + rng.normal(0.0, 0.003, points.shape), turned=True)


@pytest.mark.parametrize(("circle_m", "number"), [(0.2, 7), (0.25, 8)])
def test_saplings_in_a_circle_are_no_tree(circle_m: float, number: int) -> None:
    result = measured(rods(np.random.default_rng(1), circle_m, number))
    assert len(result.trees) == 3
    assert all(np.hypot(tree.x_m - AT[0], tree.y_m - AT[1]) > 0.5 for tree in result.trees)
    (warning,) = (item for item in result.warnings if item.code == "thickets_left_out")
    assert dict(warning.items)["places"] == ("(3.0, 1.0)",)


@pytest.mark.parametrize("radius", [0.1, 0.2])
def test_a_stem_behind_branches_stays_a_tree(radius: float) -> None:
    result = measured(striped(np.random.default_rng(1), radius, 5))
    (tree,) = (t for t in result.trees if np.hypot(t.x_m - AT[0], t.y_m - AT[1]) < 0.1)
    assert tree.dbh_cm == pytest.approx(200.0 * radius, abs=1.0)
    assert "thickets_left_out" not in {item.code for item in result.warnings}


def test_a_thin_stem_of_a_rough_scan_stays_one_behind_narrow_stripes() -> None:
    """Its pieces are hardly wider than they scatter, as those of saplings are."""
    points = striped(np.random.default_rng(1), 0.1, 5)[:, :2]
    pieces = pieces_of(points * (1.0 + np.random.default_rng(2).normal(0.0, 0.1, (len(points), 1))), 0.1)
    assert pieces is not None
    assert pieces.number == 5
    assert not pieces.stand_apart(0.01)


def test_pieces_are_counted_across_the_beginning_of_the_circle() -> None:
    angle = np.concatenate([np.linspace(np.pi - 0.4, np.pi + 0.4, 300), np.linspace(-0.2, 0.2, 300)])
    away = np.random.default_rng(4).normal(0.2, 0.008, len(angle))
    pieces = pieces_of(away[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]), 0.2)
    assert pieces is not None
    assert pieces.number == 2
    assert pieces.width_m == pytest.approx((0.16**2 + 0.08**2) / 0.24, abs=0.02)


@pytest.mark.parametrize("step_m", [0.02, 0.029])
@pytest.mark.parametrize("radius", [0.05, 0.1, 0.2])
def test_columns_of_voxels_are_no_pieces(step_m: float, radius: float) -> None:
    points = wall(np.random.default_rng(2), radius=radius, top_m=1.0, taper=0.0, spacing_m=0.005)[:, :2]
    voxels = np.floor(points / step_m) * step_m + 0.5 * step_m
    pieces = pieces_of(voxels, radius)
    assert pieces is None or not pieces.stand_apart(0.3 * step_m)
