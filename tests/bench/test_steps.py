"""Seconds of the steps of a run, and the error of the remaining time, on a clock of our own."""

from __future__ import annotations

import pytest

from tests.bench.steps import StepClock


def test_each_step_has_its_seconds_and_the_remaining_time_its_error() -> None:
    now = [10.0]
    clock = StepClock(lambda: now[0])
    # Depth is a step of its own, whatever is said of it; what is no known step counts to the one before.
    for stage, what, seconds in (
        ("frames", "judging", 2.0),
        ("poses", "finding features", 30.0),
        ("poses", "matching photos", 20.0),
        ("poses", "something else", 1.0),
        ("poses", "finding features", 4.0),
        ("depth", "depth of a", 80.0),
        ("fuse", "joining", 3.0),
    ):
        for done in range(10):
            clock(stage)(done, 10, what)
            now[0] += seconds / 10
    figures = clock.figures()
    assert figures["step_poses_finding_features_s"] == pytest.approx(34)
    assert figures["step_poses_matching_photos_s"] == pytest.approx(21)
    assert figures["step_depth_s"] == pytest.approx(80)
    assert sum(value for name, value in figures.items() if name.startswith("step_")) == pytest.approx(140)
    assert 0 < figures["remaining_median_percent"] < figures["remaining_worst_percent"]


def test_a_remaining_time_that_is_always_double_is_off_by_100_percent(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr("tests.bench.steps.RemainingTime.seconds", lambda _self: 2 * (100 - now[0]))
    clock = StepClock(lambda: now[0])
    for done in range(100):
        clock("depth")(done, 100, "depth of a view")
        now[0] += 1
    figures = clock.figures()
    assert figures["remaining_median_percent"] == pytest.approx(100)
    assert figures["remaining_worst_percent"] == pytest.approx(100)
