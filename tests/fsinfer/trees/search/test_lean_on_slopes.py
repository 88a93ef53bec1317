"""How far a stem may lean, and that it does not depend on the slope that it stands on."""

from __future__ import annotations

import numpy as np
import pytest

from fsinfer.trees import analyse_plot
from tests.support.stem_clouds import wall


@pytest.mark.parametrize("radius", [0.15, 0.8])
@pytest.mark.parametrize(("lean_deg", "found"), [(20.0, 4), (-20.0, 4), (52.0, 0), (-52.0, 0)])
def test_stems_may_lean_as_far_uphill_as_downhill(lean_deg: float, found: int, radius: float) -> None:
    rng = np.random.default_rng(5)
    rise = np.tan(np.radians(35.0))
    ground = np.column_stack([rng.uniform(-6.0, 6.0, (30_000, 2)), rng.normal(0.0, 0.01, 30_000)])
    ground[:, 2] += rise * ground[:, 1]
    parts = [ground]
    for x, y in ((-4.0, -3.0), (-4.0, 1.0), (4.0, -3.0), (4.0, 1.0)):
        stem = wall(rng, radius=radius, spacing_m=0.08 * radius)
        stem[:, 1] += np.tan(np.radians(lean_deg)) * stem[:, 2]
        parts.append(stem + rng.normal(0.0, 0.003, stem.shape) + [x, y, rise * y])
    trees = analyse_plot(np.concatenate(parts), turned=True).trees
    assert len(trees) == found


@pytest.mark.parametrize("lean_deg", [30.0, 40.0])
def test_stems_that_lean_much_are_measured(lean_deg: float) -> None:
    rng = np.random.default_rng(7)
    ground = np.column_stack([rng.uniform(-6.0, 6.0, (30_000, 2)), rng.normal(0.0, 0.01, 30_000)])
    parts = [ground]
    cos, sin = np.cos(np.radians(lean_deg)), np.sin(np.radians(lean_deg))
    for (x, y), radius in zip(
        ((-4.0, -3.0), (-4.0, 1.0), (4.0, -3.0), (4.0, 1.0)), (0.08, 0.12, 0.18, 0.25), strict=True
    ):
        stem = wall(rng, radius=radius, spacing_m=0.012, taper=0.0)
        stem[:, 1:] @= np.array([[cos, -sin], [sin, cos]])
        stem += rng.normal(0.0, 0.003, stem.shape) + np.array([x, y, 0.0])
        parts.append(stem[stem[:, 2] > 0.0])
    trees = analyse_plot(np.concatenate(parts)).trees
    assert sorted(round(tree.dbh_cm or 0.0) for tree in trees) == [16, 24, 36, 50]
    for tree in trees:
        assert tree.lean_deg == pytest.approx(lean_deg, abs=1.0)


@pytest.mark.parametrize("lean_deg", [-24.0, -15.0, 15.0, 24.0])
@pytest.mark.parametrize("slope_deg", [15.0, 30.0])
@pytest.mark.parametrize("along", [False, True], ids=["with or against the slope", "along it"])
def test_stems_that_lean_on_a_slope_are_measured(slope_deg: float, lean_deg: float, along: bool) -> None:
    """Heights above sloping ground shear what leans with or against it: its section is no circle there."""
    rng = np.random.default_rng(11)
    rise = np.tan(np.radians(slope_deg))
    ground = np.column_stack([rng.uniform(-6.0, 6.0, (40_000, 2)), rng.normal(0.0, 0.01, 40_000)])
    ground[:, 2] += rise * ground[:, 0]
    parts = [ground]
    cos, sin = np.cos(np.radians(lean_deg)), np.sin(np.radians(lean_deg))
    feet = np.array([(-4.0, -3.0), (-4.0, 2.0), (3.0, -3.0), (3.0, 2.0)])
    radii = (0.08, 0.12, 0.18, 0.25)
    axes = [1, 2] if along else [0, 2]
    for (x, y), radius in zip(feet, radii, strict=True):
        stem = wall(rng, radius=radius, spacing_m=0.012, taper=0.0)
        stem[:, axes] = stem[:, axes] @ np.array([[cos, -sin], [sin, cos]])
        stem += rng.normal(0.0, 0.003, stem.shape) + np.array([x, y, rise * x])
        parts.append(stem[stem[:, 2] > rise * stem[:, 0]])
    trees = sorted(analyse_plot(np.concatenate(parts), turned=True).trees, key=lambda tree: tree.dbh_cm or 0.0)
    assert [tree.dbh_cm for tree in trees] == pytest.approx([200 * radius for radius in radii], abs=0.4)
    places = feet.copy()
    places[:, axes[0]] += 1.3 * np.tan(np.radians(lean_deg))
    np.testing.assert_allclose([(tree.x_m, tree.y_m) for tree in trees], places, atol=0.03)
    assert [tree.lean_deg for tree in trees] == pytest.approx([abs(lean_deg)] * 4, abs=0.7)
