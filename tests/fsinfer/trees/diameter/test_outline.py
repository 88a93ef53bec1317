"""The closed outline of a stem that is not round, against ellipses and lobes whose girth and widths are known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from fsinfer.trees.diameter.outline import OutlineSettings, fit_outline


def ring(
    radius: float, waves: int, depth: float, turn: float, *, sigma_m: float = 0.001, count: int = 1500
) -> NDArray[np.float64]:
    """Points (N, 2) on a section whose radius has ``waves`` waves of ``depth``, part of the radius."""
    rng = np.random.default_rng(1)
    angle = rng.uniform(-np.pi, np.pi, count)
    rho = radius * (1 + depth * np.cos(waves * (angle - turn))) + rng.normal(0, sigma_m, count)
    return np.column_stack([rho * np.cos(angle), rho * np.sin(angle)])


@settings(max_examples=20)
@given(radius=st.floats(0.06, 0.4), depth=st.floats(0.0, 0.05), turn=st.floats(0, 3.1))
def test_callipers_and_tape_on_an_oval_stem(radius: float, depth: float, turn: float) -> None:
    points = ring(radius, 2, depth, turn)
    outline = fit_outline(points, np.ones(len(points)), radius, 0.001)
    # So flat an oval is convex: its girth is that of the curve itself.
    assert outline.max_diameter_m == pytest.approx(2 * radius * (1 + depth), abs=0.001 + 0.004 * radius)
    assert outline.min_diameter_m == pytest.approx(2 * radius * (1 - depth), abs=0.001 + 0.004 * radius)
    exact = np.linspace(0, 2 * np.pi, 5001)
    rho = radius * (1 + depth * np.cos(2 * exact))
    girth = np.hypot(np.diff(rho * np.cos(exact)), np.diff(rho * np.sin(exact))).sum()
    assert outline.girth_diameter_m == pytest.approx(girth / np.pi, abs=0.0005 + 0.001 * radius)
    reach = np.linalg.norm(outline.curve_m, axis=1)
    angle = np.arctan2(outline.curve_m[:, 1], outline.curve_m[:, 0])
    np.testing.assert_allclose(reach, radius * (1 + depth * np.cos(2 * (angle - turn))), atol=0.001 + 0.004 * radius)


def test_a_tape_spans_the_hollows_of_a_lobed_stem() -> None:
    points = ring(0.3, 4, 0.15, 0.0)
    outline = fit_outline(points, np.ones(len(points)), 0.3, 0.001, settings=OutlineSettings(prior_of_radius=1.0))
    bark = np.linalg.norm(outline.curve_m - np.roll(outline.curve_m, 1, axis=0), axis=1).sum() / np.pi
    tape = ConvexHull(outline.curve_m).area / np.pi  # the "area" of a hull in the plane is its girth
    assert outline.girth_diameter_m == pytest.approx(tape, rel=1e-3)
    assert tape < 0.995 * bark
    assert outline.max_diameter_m == pytest.approx(2 * 0.3 * 1.15, abs=0.005)


def test_noise_makes_no_waves_and_points_without_weight_do_not_count() -> None:
    points = ring(0.15, 2, 0.0, 0.0, sigma_m=0.01, count=300)
    outline = fit_outline(points, np.ones(len(points)), 0.15, 0.01)
    assert outline.max_diameter_m - outline.min_diameter_m < 0.012
    oval = ring(0.15, 2, 0.2, 0.0)
    both = np.concatenate([ring(0.15, 2, 0.0, 0.0), oval])
    weights = np.concatenate([np.ones(1500), np.zeros(len(oval))])
    round_it = fit_outline(both, weights, 0.15, 0.001)
    assert round_it.max_diameter_m - round_it.min_diameter_m < 0.002


def test_the_side_that_nobody_saw_goes_on_round() -> None:
    points = ring(0.15, 2, 0.0, 0.0, sigma_m=0.005, count=400)
    seen = points[points[:, 0] > 0]
    outline = fit_outline(seen, np.ones(len(seen)), 0.15, 0.005)
    assert outline.max_diameter_m - outline.min_diameter_m < 0.005
    assert outline.girth_diameter_m == pytest.approx(0.30, abs=0.001)


def test_strays_far_from_the_stem_do_not_count() -> None:
    points = ring(0.15, 2, 0.03, 0.5)
    strays = np.random.default_rng(2).uniform([0.25, -0.1], [0.45, 0.1], (400, 2))
    clean = fit_outline(points, np.ones(len(points)), 0.15, 0.002)
    dirty = fit_outline(np.concatenate([points, strays]), np.ones(len(points) + 400), 0.15, 0.002)
    np.testing.assert_allclose(dirty.curve_m, clean.curve_m, atol=1e-9)
