"""The metre of stem about breast height: several stems at once, each as if it stood alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.trees.cylinder.axis import AxisFit
from fsinfer.trees.diameter.circle import LEAST_POINTS
from fsinfer.trees.diameter.dbh_settings import DbhSettings
from fsinfer.trees.diameter.tapered_fit import joint_fits
from tests.support.stem_clouds import wall

RADII = (0.08, 0.15, 0.27)


def fits(
    points: Sequence[NDArray[np.float64]],
    start: NDArray[np.float64],
    heights_m: NDArray[np.float64],
    sigmas_m: NDArray[np.float64],
) -> list[tuple[AxisFit, NDArray[np.float64] | None]]:
    """The fits with the windows of the DBH."""
    return joint_fits(points, start, heights_m, sigmas_m, half_windows_m=DbhSettings().half_windows_m)


def stem(
    radius: float, seed: int, *, spacing_m: float = 0.02, arc_deg: float = 360.0, lean: float = 0.02
) -> NDArray[np.float64]:
    rng = np.random.default_rng(seed)
    points = wall(rng, radius=radius, spacing_m=spacing_m, arc_deg=arc_deg, taper=-0.008, ovality=0.0)
    points[:, 0] += lean * (points[:, 2] - 1.3)
    return points + rng.normal(0.0, 0.004, points.shape)


def starts(radii: tuple[float, ...]) -> NDArray[np.float64]:
    """A search's idea of the stems: a centimetre beside them, and too thick."""
    return np.array([[0.01, -0.01, 0.0, 0.0, radius + 0.01, 0.0] for radius in radii])


def test_axes_and_radii_of_several_stems_are_found() -> None:
    points = [stem(radius, seed) for seed, radius in enumerate(RADII)]
    for radius, (fit, used) in zip(RADII, fits(points, starts(RADII), np.full(3, 1.3), np.full(3, 0.01)), strict=True):
        assert used is not None
        assert fit.radius_m == pytest.approx(radius, abs=0.002)
        np.testing.assert_allclose(fit.parameters[:4], [0.0, 0.0, 0.02, 0.0], atol=0.004)
        assert fit.sigma_m == pytest.approx(0.004, rel=0.3)
        # What it rests on is the first window only, 0.9 to 1.7 m.
        assert np.abs(used[:, 2] - 1.3).max() <= 0.4
        assert len(used) == len(fit.core)


def test_stems_do_not_know_of_each_other() -> None:
    points = [stem(radius, seed) for seed, radius in enumerate(RADII)]
    together = fits(points, starts(RADII), np.full(3, 1.3), np.full(3, 0.01))
    for k, radius in enumerate(RADII):
        ((alone, used),) = fits([points[k]], starts((radius,)), np.array([1.3]), np.array([0.01]))
        np.testing.assert_allclose(alone.parameters, together[k][0].parameters, atol=1e-6)
        np.testing.assert_array_equal(used, together[k][1])


def test_a_sparse_stem_is_looked_at_over_a_longer_stretch() -> None:
    sparse = stem(0.06, 3, spacing_m=0.08)
    # All in the highest and lowest part: within 0.4 m of breast height too little is left.
    sparse = sparse[np.abs(sparse[:, 2] - 1.3) > 0.3]
    ((fit, used),) = fits([sparse], starts((0.06,)), np.array([1.3]), np.array([0.01]))
    assert used is not None
    assert np.abs(used[:, 2] - 1.3).max() > 0.4
    assert fit.radius_m == pytest.approx(0.06, abs=0.006)


def test_hopeless_stems_stay_as_the_search_had_them() -> None:
    few = stem(0.15, 5)[::400]
    few = few[np.abs(few[:, 2] - 1.3) < 0.9][: LEAST_POINTS - 1]
    start = starts((0.15, 0.15))
    (empty, nothing), (fit, used) = fits([np.zeros((0, 3)), few], start, np.array([1.3, 1.4]), np.array([0.01, 0.02]))
    assert nothing is None
    assert used is None
    np.testing.assert_array_equal(empty.parameters, start[0])
    assert (fit.height_m, fit.sigma_m) == (1.4, 0.02)


def test_strays_on_the_side_that_nobody_saw_do_not_make_the_stem_thicker() -> None:
    radius = 0.15
    half = stem(radius, 6, arc_deg=170.0, lean=0.0)
    rng = np.random.default_rng(7)
    behind = np.column_stack([rng.uniform(-0.30, -0.20, 25), rng.uniform(-0.1, 0.1, 25), rng.uniform(0.9, 1.7, 25)])
    ((fit, used),) = fits([np.concatenate([half, behind])], starts((radius,)), np.array([1.3]), np.array([0.01]))
    assert used is not None
    assert fit.radius_m == pytest.approx(radius, abs=0.006)
    assert used[:, 0].min() > -0.19


def test_a_wall_with_flanks_to_both_sides_and_a_short_tail_is_not_taken_for_its_inside() -> None:
    """As depth maps of cameras that are some millimetres off have it: a tail of a centimetre would eat the outside."""
    errors_mm = []
    for seed in range(5):
        rng = np.random.default_rng(seed)
        angle, height, kind = rng.uniform(-np.pi, np.pi, 3000), rng.uniform(0.8, 1.8, 3000), rng.random(3000)
        core, flanks, tail = rng.normal(0, 0.0015, 3000), rng.laplace(0, 0.008, 3000), rng.exponential(0.012, 3000)
        radius = 0.1 - 0.006 * (height - 1.3) + np.select([kind < 0.45, kind < 0.85], [core, flanks], tail)
        points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])
        start = np.array([[0.0, 0.0, 0.0, 0.0, 0.1, -0.006]])
        ((fit, _),) = joint_fits([points], start, np.array([1.3]), np.array([0.006]), half_windows_m=(0.5,))
        errors_mm.append(1000 * (fit.radius_m - 0.1))
    # -0.32 with a tail of 1 cm
    assert -0.1 < np.mean(errors_mm) < 0.3
