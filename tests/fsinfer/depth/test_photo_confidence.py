"""How sure a depth is by the photographs: the quantities, the curves, and what the depth stage makes of them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsinfer.depth.photo_confidence import (
    QUANTITIES,
    ConfidenceCurves,
    LastStep,
    probability,
    quantities,
)
from training.photo_confidence import fit_curves

SHAPE = (12, 16)


def flat(value: float) -> np.ndarray:
    return np.full(SHAPE, value, np.float32)


def last_step(
    *,
    sources: float = 2.0,
    misfit: float = 0.1,
    variance: float = 1.0,
    texture: float = 1.0,
    shift_px: float = 0.1,
    px_per_percent: float = 1.0,
) -> LastStep:
    return LastStep(
        sources=flat(sources),
        misfit=flat(misfit),
        variance=flat(variance),
        texture=flat(texture),
        shift_px=flat(shift_px),
        px_per_percent=flat(px_per_percent),
    )


def test_every_quantity_is_a_map() -> None:
    found = quantities(flat(0.5), last_step())
    assert tuple(found) == QUANTITIES
    assert all(values.shape == SHAPE and np.isfinite(values).all() for values in found.values())


def test_half_the_baseline_knows_a_quarter_and_steps_twice_as_far() -> None:
    wide, narrow = (quantities(flat(0.5), last_step(px_per_percent=moves)) for moves in (2.0, 1.0))
    assert wide["information"] - narrow["information"] == pytest.approx(np.log(4.0), abs=1e-4)
    assert wide["shift"] - narrow["shift"] == pytest.approx(-np.log(2.0), abs=0.02)


def test_a_flat_place_is_asked_to_fit_better() -> None:
    """The same difference of grey values is more of what little there is to see."""
    flat_place, rough = (quantities(flat(0.5), last_step(variance=value)) for value in (0.25, 1.0))
    assert flat_place["misfit"] - rough["misfit"] == pytest.approx(np.log(4.0), abs=0.05)


def test_where_nothing_is_known_nothing_breaks() -> None:
    found = quantities(flat(0.0), last_step(sources=0.0, variance=0.0, texture=0.0, shift_px=0.0, px_per_percent=0.0))
    assert all(np.isfinite(values).all() for values in found.values())


def curves(**adds: float) -> ConfidenceCurves:
    """Lines from 0 at 0 to so much at 1."""
    at = np.array([0, 1], np.float32)
    values = {name: np.array([0, adds.get(name, 0.0)], np.float32) for name in QUANTITIES}
    return ConfidenceCurves(places=dict.fromkeys(QUANTITIES, at), values=values, constant=-1.0)


@given(st.floats(-5, 5), st.floats(0, 1))
def test_the_probability_is_the_logistic_of_the_sum(adds: float, network: float) -> None:
    found = dict.fromkeys(QUANTITIES, flat(1.0)) | {"network": flat(network)}
    sure = probability(found, curves(network=adds, information=0.5))
    assert sure == pytest.approx(1 / (1 + np.exp(1.0 - 0.5 - adds * network)), abs=1e-5)
    assert sure.dtype == np.float32


def test_the_fit_finds_what_tells_and_how_much() -> None:
    """Pixels drawn with known odds: the probabilities come back, and what tells nothing adds nothing."""
    rng = np.random.default_rng(7)
    n = 60_000
    found = {name: rng.uniform(0, 1, n).astype(np.float32) for name in QUANTITIES}
    logit = -1 + 4 * found["network"] - 3 * (found["information"] - 0.5) ** 2 * 4
    truth = 1 / (1 + np.exp(-logit))
    fitted = fit_curves(found, rng.random(n) < truth)
    sure = probability({name: values[None] for name, values in found.items()}, fitted)[0]
    assert np.abs(sure - truth).mean() < 0.015
    assert np.ptp(fitted.values["shift"]) < 0.2
    assert np.ptp(fitted.values["network"]) == pytest.approx(4, abs=0.4)
    assert np.ptp(fitted.values["information"]) == pytest.approx(3, abs=0.5)


def test_a_quantity_that_is_always_the_same_is_no_trouble() -> None:
    rng = np.random.default_rng(8)
    found = {name: rng.uniform(0, 1, 2000).astype(np.float32) for name in QUANTITIES}
    found["sources"] = np.full(2000, 4, np.float32)
    fitted = fit_curves(found, rng.random(2000) < found["network"])
    assert len(fitted.places["sources"]) >= 2
    assert (np.diff(fitted.places["sources"]) > 0).all()
