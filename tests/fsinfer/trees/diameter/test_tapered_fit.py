"""The metre of stem about breast height: several stems at once, each as if it stood alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.trees.cylinder.axis import AxisFit
from fsinfer.trees.diameter.circle import LEAST_POINTS
from fsinfer.trees.diameter.dbh_settings import DbhSettings
from fsinfer.trees.diameter.tapered_fit import joint_fits, wall_coverage
from fsinfer.trees.points.errors import NORMAL, PointErrors
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


def with_errors(points: NDArray[np.float64], std_m: NDArray[np.float64] | float) -> NDArray[np.float64]:
    """Points of a stem about the z axis with their errors and the normals of its bark, (N, 7)."""
    normals = points / np.linalg.norm(points[:, :2], axis=1, keepdims=True)
    return PointErrors(std_m=np.broadcast_to(std_m, len(points)), normals=normals).beside(points)


def seen_from_near_and_far(seed: int) -> NDArray[np.float64]:
    """A stem seen all round from near, and three times as often from far: those points hang a centimetre outside."""
    rng = np.random.default_rng(seed)
    near = wall(rng, radius=0.15, spacing_m=0.02, ovality=0.0)
    far = wall(rng, radius=0.15, spacing_m=0.0115, ovality=0.0)
    near[:, :2] *= 1.0 + rng.normal(0.0, 0.003, (len(near), 1)) / 0.15
    far[:, :2] *= 1.0 + rng.normal(0.01, 0.015, (len(far), 1)) / 0.15
    return with_errors(np.concatenate([near, far]), np.r_[np.full(len(near), 0.001), np.full(len(far), 0.02)])


def errors_and_without(points: Sequence[NDArray[np.float64]]) -> tuple[list[float], list[float]]:
    """How far the radii of stems of 15 cm are off, by points that tell their errors and by the same without."""
    where = np.repeat(starts((0.15,)), len(points), axis=0), np.full(len(points), 1.3), np.full(len(points), 0.01)
    told, untold = fits(points, *where), fits([own[:, :3] for own in points], *where)
    error, without = ([abs(fit.radius_m - 0.15) for fit, _ in found] for found in (told, untold))
    return error, without


def test_points_count_by_their_own_noise() -> None:
    error, without = errors_and_without([seen_from_near_and_far(seed) for seed in range(6)])
    assert max(error) < 0.0015
    assert min(without) > 0.003


def test_a_haze_that_errs_together_does_not_outvote_what_a_section_looks_like() -> None:
    """Half of the bark from near, the other half from far: thousands of points three centimetres within."""

    def seen_half_from_far(seed: int) -> NDArray[np.float64]:
        rng = np.random.default_rng(seed)
        near = wall(rng, radius=0.15, spacing_m=0.02, arc_deg=190.0, ovality=0.0)
        near[:, :2] *= 1.0 + rng.normal(0.0, 0.002, (len(near), 1)) / 0.15
        far = wall(rng, radius=0.15, spacing_m=0.008, arc_deg=190.0, ovality=0.0)
        far[:, :2] *= -(1.0 + rng.normal(-0.03, 0.016, (len(far), 1)) / 0.15)
        return with_errors(np.concatenate([near, far]), np.r_[np.full(len(near), 0.001), np.full(len(far), 0.016)])

    error, without = errors_and_without([seen_half_from_far(seed) for seed in range(6)])
    # 13 to 15 mm where they are taken for independent.
    assert max(error) < 0.011
    assert min(without) > 0.014


def test_the_fringe_beside_a_stem_that_is_seen_from_one_side_does_not_make_it_thick() -> None:
    """Depth maps go on beside an edge: three centimetres that face the camera, which looks along -x."""

    def seen_from_one_side(seed: int) -> NDArray[np.float64]:
        rng = np.random.default_rng(seed)
        bark = wall(rng, radius=0.15, arc_deg=170.0, spacing_m=0.012, ovality=0.0)
        bark[:, :2] *= 1.0 + rng.normal(0.0, 0.002, (len(bark), 1)) / 0.15
        count = len(bark) // 6
        side = np.where(rng.random(count) < 0.5, -1.0, 1.0)
        beyond = rng.uniform(0.0, 0.03, count)
        height = rng.uniform(0.0, 4.0, count)
        fringe = np.column_stack([0.02 + rng.normal(0.0, 0.003, count), side * (0.149 + beyond), height])
        points = with_errors(np.concatenate([bark, fringe]), 0.002)
        points[len(bark) :, NORMAL:] = 1.0, 0.0
        return points

    error, without = errors_and_without([seen_from_one_side(seed) for seed in range(6)])
    assert max(error) < 0.004
    assert np.mean(without) > 3.0 * np.mean(error)


def test_a_hazy_side_is_not_seen_all_the_same() -> None:
    """The near half is seen; what far photographs made of the other half is no more than a hint."""
    rng = np.random.default_rng(0)
    near = wall(rng, radius=0.15, arc_deg=180.0, spacing_m=0.015, ovality=0.0)
    far = wall(rng, radius=0.15, arc_deg=180.0, middle=np.pi, spacing_m=0.015, ovality=0.0)
    points = np.concatenate([near, far]) + rng.normal(0.0, 0.002, (len(near) + len(far), 3))
    noise = np.r_[np.full(len(near), 0.001), np.full(len(far), 0.02)]
    for column, seen in ((noise, 0.5), (np.full(len(points), 0.001), 1.0)):
        told = with_errors(points, column)
        ((fit, used),) = fits([told], starts((0.15,)), np.array([1.3]), np.array([0.01]))
        assert used is not None
        assert wall_coverage(fit, used) == pytest.approx(seen, abs=0.06)


def test_errors_that_are_the_same_everywhere_tell_nothing() -> None:
    points = [stem(radius, seed, lean=0.0) for seed, radius in enumerate(RADII)]
    alike = [with_errors(own, 0.02) for own in points]
    args = starts(RADII), np.full(3, 1.3), np.full(3, 0.01)
    for (fit, _), (other, _) in zip(fits(points, *args), fits(alike, *args), strict=True):
        np.testing.assert_allclose(fit.parameters, other.parameters, atol=2e-4)
