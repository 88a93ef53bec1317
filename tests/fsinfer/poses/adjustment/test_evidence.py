"""Unknowns of each photo's own are kept where points held out are predicted better, and only there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fsinfer.poses.adjustment.evidence import Trial, confirmed, split, tried_in_turn
from fsinfer.poses.adjustment.fit import Weighting, fit
from fsinfer.poses.adjustment.problem import Group, Unknowns
from fsinfer.poses.adjustment.projection import LENS, PRINCIPAL
from fsinfer.poses.adjustment.reduced_system import Structure
from fsinfer.poses.adjustment.settings import AdjustmentSettings
from tests.support.phone_walk import PHONE, disturbed, phone_walk

FREE = np.zeros((LENS, 2))
FREE[:2, 0] = FREE[4, 1] = 1
NOISE_PX = 0.2


def trials_of(
    effects: np.ndarray | None, outliers: float = 0.0, seed: int = 1, larger: float = 1.0
) -> dict[Group, Trial]:
    """Of photos that are ``larger`` so many times, in each direction."""
    seen, truth = phone_walk(effects=effects, noise_px=NOISE_PX, outliers=outliers, seed=seed)
    own_std = np.tile(PHONE, (len(truth.rotations), 1))
    seen, truth = replace(seen, xy=larger * seen.xy), replace(truth, lenses=truth.lenses.copy(), own=truth.own.copy())
    for pixels in (truth.lenses[:, :4], truth.own[:, PRINCIPAL], own_std[:, PRINCIPAL]):
        pixels *= larger
    weighting = Weighting(
        loss_px=larger,
        noise_px=larger * NOISE_PX,
        own_std=own_std,
        mean_std=np.full_like(own_std, np.inf),
        lens_free=[FREE],
    )
    start: Unknowns = fit(Structure(seen, len(truth.points)), disturbed(truth), (), weighting)
    in_turn = tried_in_turn(seen, start, weighting, AdjustmentSettings())
    assert in_turn is not None
    found = confirmed(in_turn, AdjustmentSettings())
    assert {trial.group for trial in found.trials if trial.kept} == set(found.groups)
    # Its cameras have what was kept and nothing else.
    had = {group for group in Group if np.abs(found.cameras.own[:, group.value]).max() > 0}
    assert had == set(found.groups)
    return {trial.group: trial for trial in found.trials}


def kept(effects: np.ndarray | None, outliers: float = 0.0) -> set[Group]:
    return {group for group, trial in trials_of(effects, outliers).items() if trial.kept}


@pytest.mark.parametrize("outliers", [0.0, 0.05], ids=["clean", "with wrong matches"])
def test_of_a_camera_that_stood_still_nothing_is_kept(outliers: float) -> None:
    assert kept(None, outliers) == set()


@pytest.mark.parametrize("outliers", [0.0, 0.05], ids=["clean", "with wrong matches"])
def test_of_a_phone_turning_and_focal_length_are_kept(outliers: float) -> None:
    assert kept(PHONE, outliers) >= {Group.turn, Group.focal}


def test_a_gain_and_its_surety_are_the_same_in_larger_photos() -> None:
    given, larger = (trials_of(PHONE, 0.05, larger=times) for times in (1.0, 4.0))
    for group, trial in given.items():
        assert larger[group].kept == trial.kept
        assert larger[group].gain == pytest.approx(trial.gain, abs=0.01)
        assert larger[group].surety == pytest.approx(trial.surety, abs=0.3)


def test_the_surety_is_that_of_points_counted_one_by_one() -> None:
    # What is not there falls and rises by chance, and as each number more follows the noise a little.
    surety = [trial.surety for seed in (1, 2) for trial in trials_of(None, seed=seed).values()]
    assert min(surety) > -6.0
    assert max(surety) < 3.0
    # What is there is sure to some standard errors, not to hundreds.
    assert 5.0 < trials_of(PHONE)[Group.turn].surety < 20.0


def test_only_what_there_is_is_kept() -> None:
    assert kept(PHONE * [0, 0, 0, 1, 1, 1, 0, 0, 0]) == {Group.turn}
    assert kept(PHONE * [2, 0, 0, 0, 0, 0, 0, 0, 0]) == {Group.focal}


def test_wrong_matches_do_not_hide_what_a_group_gains() -> None:
    turning = PHONE * [0, 0, 0, 1, 1, 1, 0, 0, 0]
    clean, spoilt = (trials_of(turning, outliers)[Group.turn].gain for outliers in (0.0, 0.05))
    assert clean > 0.3
    assert spoilt > 0.6 * clean


def test_points_held_out_are_not_fitted_and_every_photo_has_enough() -> None:
    seen, truth = phone_walk()
    settings = replace(AdjustmentSettings(), decide_with=60)
    held, fitted = split(seen, len(truth.points), settings)
    assert not (held & fitted).any()
    lengths = np.bincount(seen.point)
    assert lengths[held].min() >= 3
    assert held.sum() == (lengths >= 3).sum() // settings.held_out
    learned, _ = seen.of_points(fitted)
    counts = np.bincount(learned.photo)
    assert counts.min() >= 60
    assert len(learned.photo) < 0.5 * len(seen.photo)
