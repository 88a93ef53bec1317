"""The adjustment on walks whose effects are known: they come back, wrong matches or not."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fsinfer.poses.adjustment import fit as fit_module
from fsinfer.poses.adjustment import problem as problem_module
from fsinfer.poses.adjustment.adjust import shutter_px
from fsinfer.poses.adjustment.fit import Weighting, fit, noise_of, normal_equations, with_points_fitted
from fsinfer.poses.adjustment.last_fit import like
from fsinfer.poses.adjustment.problem import Group, Observations, Unknowns
from fsinfer.poses.adjustment.projection import FOCAL, LENS, OWN, TURN
from fsinfer.poses.adjustment.reduced_system import Blocks, Structure
from tests.support.phone_walk import PHONE, disturbed, phone_walk

NOISE_PX = 0.2
FREE = np.zeros((LENS, 2))
FREE[:2, 0] = FREE[4, 1] = 1


def weighting(photos: int) -> Weighting:
    return Weighting(
        loss_px=1.0,
        noise_px=NOISE_PX,
        own_std=np.tile(PHONE, (photos, 1)),
        mean_std=np.full((photos, 9), np.inf),
        lens_free=[FREE],
    )


def center_error(found: Unknowns, truth: Unknowns) -> float:
    distance = np.linalg.norm(like(found, truth).centers - truth.centers, axis=1)
    return float(np.sqrt((distance**2).mean()))


def fitted(seen: Observations, truth: Unknowns, *groups: Group) -> Unknowns:
    start = disturbed(truth)
    return fit(Structure(seen, len(start.points)), start, groups, weighting(len(start.rotations)), steps=25)


@pytest.mark.parametrize("outliers", [0.0, 0.05], ids=["clean", "with wrong matches"])
def test_turning_and_focal_length_come_back(outliers: float) -> None:
    effects = PHONE * [1, 0, 0, 1, 1, 1, 0, 0, 0]
    seen, truth = phone_walk(effects=effects, noise_px=NOISE_PX, outliers=outliers)
    without = fitted(seen, truth)
    found = fitted(seen, truth, Group.turn, Group.focal)
    wrong = found.own - truth.own
    # Against 1.5 mrad and 0.15 %.
    assert np.sqrt((wrong[:, TURN] ** 2).mean()) < 0.0005
    assert wrong[:, FOCAL].std() < 0.0005
    assert center_error(found, truth) < 0.4 * center_error(without, truth)
    assert noise_of(found.residuals(seen)) < 1.1 * NOISE_PX < 0.8 * noise_of(without.residuals(seen))
    # The lens is shared, and comes back, too.
    np.testing.assert_allclose(found.lenses[0, :2], truth.lenses[0, :2], rtol=2e-3)


def test_way_during_the_read_out_comes_back_where_depths_differ() -> None:
    seen, truth = phone_walk(effects=PHONE, noise_px=NOISE_PX)
    without = fitted(seen, truth)
    found = fitted(seen, truth, *Group)
    # Turning and way are much alike; what both do to the picture is what counts.
    assert np.sqrt(((shutter_px(seen, found) - shutter_px(seen, truth)) ** 2).mean()) < 0.4
    assert np.median(shutter_px(seen, truth)) > 1.5
    assert center_error(found, truth) < 0.6 * center_error(without, truth)


def test_the_mean_turning_about_the_rows_is_held_where_photos_are_level() -> None:
    seen, truth = phone_walk(effects=PHONE * [0, 0, 0, 1, 1, 1, 0, 0, 0], noise_px=NOISE_PX, roll_rad=0.0)
    own = truth.own - truth.own.mean(axis=0)
    start = disturbed(replace(truth, own=own))
    photos = len(start.rotations)
    held = np.full((photos, OWN), np.inf)
    held[:, TURN.start] = 1e-5
    found = [
        fit(Structure(seen, len(start.points)), start, (Group.turn,), weights, steps=25)
        for weights in (weighting(photos), replace(weighting(photos), mean_std=held))
    ]
    means = [abs(unknowns.own[:, TURN.start].mean()) for unknowns in found]
    assert means[1] < 1e-5 < 0.05 * means[0]


def test_a_photo_of_few_points_keeps_to_what_is_expected() -> None:
    seen, truth = phone_walk(effects=PHONE, noise_px=NOISE_PX)
    rows = np.flatnonzero(seen.photo == 5)[8:]
    mask = np.ones(len(seen.photo), dtype=bool)
    mask[rows] = False
    thinned = seen.of(mask)
    found = fitted(thinned, truth, *Group)
    assert (np.abs(found.own[5]) < 3 * PHONE).all()


def test_derivatives_are_those_of_the_weighted_errors() -> None:
    seen, truth = phone_walk(photos=9, points=80, effects=PHONE)
    seen = replace(seen, weight=np.random.default_rng(0).uniform(0.1, 1, len(seen.photo)))
    inside = truth.in_cameras(seen)
    residuals, by_point, by_own, by_lens = truth.derivatives(seen, inside)
    np.testing.assert_allclose(residuals, truth.residuals(seen), atol=1e-9)
    step = 1e-6
    moved = replace(truth, points=truth.points + np.array([step, 0, 0])).residuals(seen)
    along = (by_point @ truth.rotations[seen.photo][:, :, :1])[:, :, 0]
    np.testing.assert_allclose((moved - residuals) / step, along, rtol=1e-3, atol=1e-3)
    own = truth.own.copy()
    own[:, 0] += step
    np.testing.assert_allclose(
        (replace(truth, own=own).residuals(seen) - residuals) / step, by_own[:, :, 0], rtol=1e-3, atol=1e-2
    )
    lenses = truth.lenses.copy()
    lenses[:, 4] += step
    np.testing.assert_allclose(
        (replace(truth, lenses=lenses).residuals(seen) - residuals) / step, by_lens[:, :, 4], rtol=1e-3, atol=1e-2
    )


def test_points_alone_are_placed_where_known_photos_see_them() -> None:
    seen, truth = phone_walk(effects=PHONE, noise_px=0.0)
    rng = np.random.default_rng(0)
    off = replace(truth, points=truth.points + rng.normal(0, 0.05, truth.points.shape))
    found = with_points_fitted(seen, off, 1.0)
    # Two photos of neighbouring places see a point's depth badly, but what they see is met.
    assert np.abs(found.residuals(seen)).max() < 0.05
    np.testing.assert_array_equal(found.rotations, truth.rotations)


def test_priors_stand_in_the_equations_as_in_the_cost() -> None:
    seen, truth = phone_walk(photos=8, points=300, effects=PHONE)
    seen, numbers = seen.of_points(np.arange(len(truth.points)) < 40)
    at = replace(truth, points=truth.points[numbers])
    photos, size = len(at.rotations), 6 + 3
    means = np.full((photos, OWN), np.inf)
    means[:, TURN.start] = 1e-3
    # One photo's prior is wider: the mean counts radians, not standard deviations.
    own_std = np.tile(PHONE, (photos, 1))
    own_std[2] *= 3
    structure = Structure(seen, len(at.points))
    base, tight = (replace(weighting(photos), own_std=own_std, mean_std=std) for std in (means * np.inf, means))
    blocks = [normal_equations(structure, at, (Group.turn,), weights) for weights in (base, tight)]
    places = np.arange(photos) * size + 6
    slope = own_std[:, TURN.start] / 1e-3 / photos
    expected = np.zeros_like(blocks[0].cameras)
    expected[np.ix_(places, places)] = NOISE_PX**2 * np.outer(slope, slope)
    np.testing.assert_allclose(blocks[1].cameras - blocks[0].cameras, expected, atol=1e-6)
    for photo in (0, 2):
        step = np.zeros((photos, OWN))
        step[photo, TURN.start] = 1e-4 * own_std[photo, TURN.start]
        sides = [tight.cost(seen, replace(at, own=at.own + sign * step)) for sign in (1, -1)]
        slope_of_half_cost = (sides[0] - sides[1]) / 2e-4 / 2
        np.testing.assert_allclose(blocks[1].cameras_right[places[photo]], slope_of_half_cost, rtol=1e-4)


@pytest.mark.parametrize("groups", [(), (Group.turn, Group.focal)], ids=["shared", "own"])
def test_part_by_part_the_sums_are_those_of_all_at_once(
    groups: tuple[Group, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    seen, truth = phone_walk(photos=8, points=300, effects=PHONE, noise_px=NOISE_PX)
    at, weights = disturbed(truth), weighting(len(truth.rotations))
    structure = Structure(seen, len(at.points))
    told = []
    for together in (len(seen.photo), 97):
        monkeypatch.setattr(problem_module, "_TOGETHER", together)
        parts = [part for part, _ in seen.parts()]
        assert len(parts) == -(-len(seen.photo) // together)
        blocks = normal_equations(structure, at, groups, weights)
        told.append([at.residuals(seen), with_points_fitted(seen, at, 1.0).points, *vars(blocks).values()])
    for whole, in_parts in zip(*told, strict=True):
        np.testing.assert_array_equal(in_parts, whole)


def test_a_fit_that_foresees_the_next_step_s_gain_ends_before_it_and_loses_next_to_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    seen, truth = phone_walk(effects=PHONE * [1, 0, 0, 1, 1, 1, 0, 0, 0], noise_px=NOISE_PX)
    start, weights = disturbed(truth), weighting(len(truth.rotations))
    structure = Structure(seen, len(start.points))
    steps: list[Unknowns] = []

    def counted(*given: Any) -> Blocks:
        steps.append(given[1])
        return normal_equations(*given)

    monkeypatch.setattr(fit_module, "normal_equations", counted)

    def ended(foreseen: float) -> tuple[int, float]:
        steps.clear()
        found = fit(structure, start, (Group.turn, Group.focal), weights, steps=25, enough=1e-3, foreseen=foreseen)
        return len(steps), weights.cost(seen, found)

    plain, soon = ended(0.0), ended(1e-3)
    assert 1 < soon[0] < plain[0]
    assert plain[1] <= soon[1] < 1.002 * plain[1]
