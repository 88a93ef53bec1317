"""Stems whose walls are blurred in the cloud: found, not seen where there are none, and no ghosts of others."""

from __future__ import annotations

import numpy as np
import pytest

from fsinfer.trees import StemSettings, Tree, TreeSettings, analyse_plot
from tests.support.stem_clouds import Floats, stem_plot, wall

AT = np.array([14.0, 3.0])
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
    # Its points give no diameter; the photographs' edges have to.
    assert stem.dbh_cm is None
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
